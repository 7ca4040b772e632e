"""The recursions of `hard` where only tasks in sight matter: O(R + tasks in sight) a step and agent.

For ``needs_sight`` where tasks of no benefit are free (no cost, or idling is free): all tasks that are not stored are
then alike but for their prices, lead to the state "none", and cost the same from every state.
"""

import numpy as np

from sapopt.kernels.jit import njit

_CANCELLED = 1e-9
"""Share of all weights below which a difference of theirs is not to be trusted."""


@njit(cache=True, nogil=True, inline="always")
def _charge(value, cost, forfeit):
    return cost + forfeit * value if value > 0.0 else 0.0


@njit(cache=True, borrows=True, nogil=True)
def _cheapest(order, mark, stamp):
    """First task of the order that is not marked, -1 if all are."""
    for position in range(len(order)):
        if mark[order[position]] != stamp:
            return order[position]
    return -1


@njit(cache=True, borrows=True, nogil=True)
def _to_go(i, first, window, prices, order, mark, stamps, best, move):
    """Value to go ``best`` (T + 1, R + 1) and the best task ``move`` (T,) of who pays, from step `first` on."""
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T = prices.shape[0]
    best[T, :] = 0.0
    for k in range(T - 1, first - 1, -1):
        lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
        stamps[0] += 1
        for e in range(lo, hi):
            mark[indices[e]] = stamps[0]
        choice = _cheapest(order[k], mark, stamps[0])
        top = -np.inf if choice < 0 else best[k + 1, R] - prices[k, choice]
        for e in range(lo, hi):
            j, value = indices[e], data[e]
            following = best[k + 1, real[j]] if value > 0.0 else best[k + 1, R]
            moved = value - prices[k, j] + following - _charge(value, cost, forfeit)
            if moved > top:
                top, choice = moved, j
        move[k] = choice
        for r in range(best.shape[1]):
            best[k, r] = top
        for e in range(lo, hi):
            j, value = indices[e], data[e]
            if value > 0.0:
                kept = value - prices[k, j] + best[k + 1, real[j]]
                best[k, real[j]] = max(best[k, real[j]], kept)


@njit(cache=True, nogil=True)
def paths(agents, window, prices, order, values, plan):
    """Longest paths: ``values`` (len(agents),) and ``plan`` (T, len(agents)) are filled."""
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T, m = prices.shape
    mark = np.zeros(m, np.int64)
    stamps = np.zeros(1, np.int64)
    best = np.empty((T + 1, R + 1))
    move = np.empty(T, np.int64)
    for a in range(len(agents)):
        i = agents[a]
        _to_go(i, np.int64(0), window, prices, order, mark, stamps, best, move)
        r = start[i]
        for k in range(T):
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            j = move[k]
            top = best[k, R]
            free = r == R + 1
            for e in range(lo, hi):
                task, value = indices[e], data[e]
                if value > 0.0 and (free or real[task] == r):
                    kept = value - prices[k, task] + best[k + 1, real[task]]
                    if kept > top:
                        top, j = kept, task
            if k == 0:
                values[a] = top
            plan[k, a] = j
            r = R
            for e in range(lo, hi):
                if indices[e] == j and data[e] > 0.0:
                    r = real[j]


@njit(cache=True, nogil=True)
def first_values(window, prices, order, out):
    """Value of every agent's best path that starts with every task, without the first step's prices; fills (n, m)."""
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T, m = prices.shape
    mark = np.zeros(m, np.int64)
    stamps = np.zeros(1, np.int64)
    best = np.empty((T + 1, R + 1))
    move = np.empty(T, np.int64)
    for i in range(n):
        _to_go(i, np.int64(1), window, prices, order, mark, stamps, best, move)
        out[i, :] = best[1, R]
        for e in range(indptr[i], indptr[i + 1]):
            j, value = indices[e], data[e]
            out[i, j] = value + (best[1, real[j]] if value > 0.0 else best[1, R])
            if start[i] != R + 1 and start[i] != real[j]:
                out[i, j] -= _charge(value, cost, forfeit)


@njit(cache=True, nogil=True)
def soft_paths(window, prices, weight, temperature, values, usage):
    """Soft values (n,) and the usage (T, m) of all agents; see `hard.soft_paths`.

    What is not in sight counts in sums: the weight of all tasks less that of the stored ones. Where next to nothing is
    left of that, it is added up task by task, for the difference would be rounding.
    """
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T, m = prices.shape
    part = np.empty((T + 1, R + 2))
    scale = np.empty(T)
    low = np.empty(T)
    rest = np.empty(T)  # weight of all that is not stored, with what follows
    keep = np.empty(len(data))
    enter = np.empty(len(data))
    chance = np.empty(R + 2)
    after = np.empty(R + 2)
    everything = np.zeros(T)
    crowded = np.zeros(T, np.bool_)  # hardly any weight is left to the tasks that are not stored
    mark = np.full(m, -1, np.int64)
    for k in range(T):
        for j in range(m):
            everything[k] += weight[k, j]
    common = np.zeros(T)
    blind = 0
    blind_log_z = 0.0
    for k in range(T):
        blind_log_z += np.log(everything[k])
    for i in range(n):
        stored = 0
        for k in range(T):
            stored += indptr[k * n + i + 1] - indptr[k * n + i]
        if stored == 0:  # in a short window most agents see nothing, and are alike
            values[i] = temperature * blind_log_z
            blind += 1
            continue
        log_z = 0.0
        part[T, :] = 1.0
        for k in range(T - 1, -1, -1):
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            top, unseen = -np.inf, everything[k]
            for e in range(lo, hi):
                top = max(top, (data[e] - prices[k, indices[e]]) / temperature)
                unseen -= weight[k, indices[e]]
            crowded[k] = unseen < _CANCELLED * everything[k]
            if crowded[k]:
                unseen = 0.0
                for e in range(lo, hi):
                    mark[indices[e]] = k
                for j in range(m):
                    if mark[j] != k:
                        unseen += weight[k, j]
                mark[:] = -1
                if unseen > 0.0:
                    top = max(top, np.log(unseen))
            else:
                top = max(top, 0.0)
            low[k] = np.exp(-top) if unseen > 0.0 else 0.0
            rest[k] = unseen * low[k] * part[k + 1, R]
            moved = free = rest[k]
            for e in range(lo, hi):
                j, value = indices[e], data[e]
                following = part[k + 1, real[j]] if value > 0.0 else part[k + 1, R]
                keep[e] = np.exp((value - prices[k, j]) / temperature - top) * following
                enter[e] = keep[e] * np.exp(-_charge(value, cost, forfeit) / temperature)
                moved += enter[e]
                free += keep[e]
            part[k, :] = moved
            part[k, R + 1] = free
            largest = free
            for e in range(lo, hi):
                if data[e] > 0.0:
                    r = real[indices[e]]
                    part[k, r] += keep[e] - enter[e]
                    largest = max(largest, part[k, r])
            if not largest > 0.0:  # see `hard.soft_paths`
                values[:] = np.nan
                usage[:] = np.nan
                return
            for r in range(R + 2):
                part[k, r] *= 1.0 / largest
            scale[k] = largest
            log_z += np.log(largest) + top
        if not part[0, start[i]] > 0.0:
            values[:] = np.nan
            usage[:] = np.nan
            return
        values[i] = temperature * (log_z + np.log(part[0, start[i]]))
        chance[:] = 0.0
        chance[start[i]] = 1.0
        for k in range(T):
            shared = 0.0
            for r in range(R + 1):
                if chance[r] > 0.0:
                    shared += chance[r] / part[k, r]
            free_share = chance[R + 1] / part[k, R + 1] if k == 0 else 0.0
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            after[:] = 0.0
            after[R] = rest[k] * (shared + free_share) / scale[k]
            each = low[k] * part[k + 1, R] * (shared + free_share) / scale[k]
            if crowded[k]:
                for e in range(lo, hi):
                    mark[indices[e]] = k
                for j in range(m):
                    if mark[j] != k:
                        usage[k, j] += weight[k, j] * each
                mark[:] = -1
                each = 0.0
            common[k] += each
            for e in range(lo, hi):
                j, value = indices[e], data[e]
                r = real[j]
                own = chance[r] / part[k, r] if chance[r] > 0.0 else 0.0
                used = (enter[e] * shared + (keep[e] - enter[e]) * own + keep[e] * free_share) / scale[k]
                usage[k, j] += used - weight[k, j] * each
                after[r if value > 0.0 else R] += used
            chance, after = after, chance
    for k in range(T):
        common[k] += blind / everything[k]
        for j in range(m):
            usage[k, j] = max(usage[k, j] + weight[k, j] * common[k], 0.0)
