"""The recursions of `groups_kernels` softened: sums over all paths, and over the places that each step may take."""

import numpy as np

from sapopt.dynamics.copies.hard import charge
from sapopt.kernels.jit import njit


@njit(cache=True, borrows=True, nogil=True)
def _weigh(k, g, groups, prices, temperature, places, pairs):
    """Fill the weights of places without benefit ``places`` (most,) and those of pairs in sight at step k.

    ``pairs[0]`` is for who keeps a task, ``pairs[1]`` for who pays, both (entries, most). Returned is the logarithm
    that all of them have been divided by.
    """
    size, members, indptr, indices, data, real, R, shared, cost, forfeit, idle_free, sight, start = groups
    m, G, most = len(real), len(size), size[g]
    lo, hi = indptr[k * G + g], indptr[k * G + g + 1]
    cheapest = np.inf
    for r in range(most):
        cheapest = min(cheapest, prices[k, m + members[g, r]])
    top = -cheapest / temperature
    for e in range(lo, hi):
        for r in range(most):
            worth = data[e, r] - prices[k, m + members[g, r]] - prices[k, indices[e]]
            top = max(top, worth / temperature)
    for r in range(most):
        places[r] = np.exp(-prices[k, m + members[g, r]] / temperature - top)
    for e in range(lo, hi):
        free = most > 1 and shared[indices[e]]
        for r in range(most):
            worth = data[e, r] - prices[k, m + members[g, r]] - prices[k, indices[e]]
            pays = 0.0 if free else charge(data[e, r], cost, forfeit, idle_free)
            pairs[0, e, r] = np.exp(worth / temperature - top)
            pairs[1, e, r] = pairs[0, e, r] * np.exp(-pays / temperature)
    return top


@njit(cache=True, nogil=True)
def soft_paths(begin, end, parts, groups, prices, weight, temperature, pairs, values, usages):
    """Soft values (n,) of all copies, and their usage, which is added to ``usages`` (parts, T, m + n).

    The groups are cut into `parts`, of which those from `begin` to ``end - 1`` are done. ``weight`` (T, m) is
    ``exp(-price / temperature)`` of the tasks, ``pairs`` (2, entries, most) is for work. Partition sums are kept
    relative to the largest one of their step, weights of a step to those of its best pair. What is not in sight has the
    same weight for every task but for the price, so nothing there asks for an exponential.
    """
    size, members, indptr, indices, data, real, R, shared, cost, forfeit, idle_free, sight, start = groups
    T, m, G, width = prices.shape[0], len(real), len(size), data.shape[1]
    part = np.empty((T + 1, R + 2))
    scale = np.empty(T)
    places = np.empty((T, width))
    follows = np.empty(len(data))  # weight of what follows a pair in sight
    counts = np.empty(len(data), np.bool_)  # whether it counts as held
    row = np.empty(m)
    fee = np.empty(m)  # what a move without benefit multiplies a weight with
    chance = np.empty(R + 2)
    after = np.empty(R + 2)
    ratio = np.empty(R + 2)
    usual = 1.0 if idle_free else np.exp(-cost / temperature)
    for block in range(begin, end):
        for g in range(block * G // parts, (block + 1) * G // parts):
            most = size[g]
            for j in range(m):
                fee[j] = 1.0 if most > 1 and shared[j] else usual
            log_z = 0.0
            part[T, :] = 1.0
            for k in range(T - 1, -1, -1):
                lo, hi = indptr[k * G + g], indptr[k * G + g + 1]
                log_z += _weigh(k, g, groups, prices, temperature, places[k], pairs)
                blind = 0.0
                for r in range(most):
                    blind += places[k, r]
                for j in range(m):
                    row[j] = weight[k, j] * blind * part[k + 1, R if sight else real[j]]
                for e in range(lo, hi):
                    row[indices[e]] = 0.0
                moved, free = 0.0, 0.0
                for j in range(m):
                    free += row[j]
                    moved += fee[j] * row[j]
                for e in range(lo, hi):
                    counts[e] = not sight
                    for r in range(most):
                        counts[e] = counts[e] or data[e, r] > 0.0
                    follows[e] = part[k + 1, real[indices[e]] if counts[e] else R]
                    for r in range(most):
                        free += pairs[0, e, r] * follows[e]
                        moved += pairs[1, e, r] * follows[e]
                for s in range(R + 1):
                    part[k, s] = moved
                for j in range(m):
                    part[k, real[j]] += (1.0 - fee[j]) * row[j]
                for e in range(lo, hi):
                    for r in range(most):
                        part[k, real[indices[e]]] += (pairs[0, e, r] - pairs[1, e, r]) * follows[e]
                part[k, R + 1] = free
                largest = free
                for s in range(R + 1):
                    largest = max(largest, part[k, s])
                if not largest > 0.0:  # nothing that is allowed has a weight in the range of floats
                    values[members[g, 0]] = np.nan
                    return
                for s in range(R + 2):
                    part[k, s] /= largest
                scale[k] = largest
                log_z += np.log(largest)
            chance[:] = 0.0
            for copy in range(most):
                i = members[g, copy]
                if not part[0, start[i]] > 0.0:
                    values[i] = np.nan
                    return
                values[i] = temperature * (log_z + np.log(part[0, start[i]]))
                chance[start[i]] += 1.0
            for k in range(T):
                lo, hi = indptr[k * G + g], indptr[k * G + g + 1]
                together = 0.0
                for s in range(R + 1):
                    ratio[s] = chance[s] / part[k, s] / scale[k] if chance[s] > 0.0 else 0.0
                    together += ratio[s]
                free = chance[R + 1] / part[k, R + 1] / scale[k] if k == 0 else 0.0
                blind, unseen = 0.0, 0.0
                for r in range(most):
                    blind += places[k, r]
                for j in range(m):
                    row[j] = weight[k, j] * part[k + 1, R if sight else real[j]]
                for e in range(lo, hi):
                    row[indices[e]] = 0.0
                after[:] = 0.0
                for j in range(m):
                    own = ratio[real[j]]
                    used = row[j] * (fee[j] * (together - own) + own + free)
                    usages[block, k, j] += blind * used
                    after[R if sight else real[j]] += blind * used
                    unseen += used
                for r in range(most):
                    usages[block, k, m + members[g, r]] += unseen * places[k, r]
                for e in range(lo, hi):
                    own = ratio[real[indices[e]]]
                    for r in range(most):
                        used = follows[e] * (
                            pairs[1, e, r] * (together - own) + pairs[0, e, r] * (own + free)
                        )
                        usages[block, k, indices[e]] += used
                        usages[block, k, m + members[g, r]] += used
                        after[real[indices[e]] if counts[e] else R] += used
                chance, after = after, chance
