"""Compiled recursions of `synthetic_paths`: one agent after another, O(T m) each.

State r < R means that real task r is held, state R that nothing is held, and R + 1 (only before the first step) that
the first step is free.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit


class Window(NamedTuple):
    """Benefits and rule of n agents over a window; row ``k * n + i`` is agent i at step k.

    Attributes
    ----------
    n : int
    indptr : (T * n + 1,) int64
    indices : (entries,) int32
    data : (entries,) float64
        Pairs that are not stored are worth 0.
    real : (m,) int64
        The real task of every task.
    real_count : int
        R, the number of real tasks.
    cost, forfeit : float
        What a move into a positive benefit pays: the cost and this share of the benefit.
    idle_is_free, needs_sight : bool
        Whether a move to a task without benefit is free, and leads to holding nothing.
    start : (n,) int64
        State before the first step.
    """

    n: int
    indptr: IntArray
    indices: NDArray[np.int32]
    data: FloatArray
    real: IntArray
    real_count: int
    cost: float
    forfeit: float
    idle_is_free: bool
    needs_sight: bool
    start: IntArray


@njit(cache=True, nogil=True, inline="always")
def charge(value, cost, forfeit, idle_free):
    """What a move to a task of a benefit pays."""
    if value > 0.0:
        return cost + forfeit * value
    return 0.0 if idle_free else cost


@njit(cache=True, borrows=True, nogil=True)
def _to_go(i, first, window, prices, row, best, move, stay):
    """Value to go before every step and state, ``best`` (T + 1, R + 1), and the choices behind it.

    For the steps from `first` on, with j running over all tasks and the state that j leads to:

        kept_j     = benefit_k[j] - price_k[j] + best[k + 1, state]
        best[k, r] = max(max_j kept_j - charge_j, max over the copies j of r of kept_j)

    ``move[k]`` is the best task of an agent that pays, ``stay[k, r]`` the best copy of real
    task r for who holds it, -1 where moving is better.
    """
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T, m = prices.shape
    best[T, :] = 0.0
    for k in range(T - 1, first - 1, -1):
        lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
        for e in range(lo, hi):
            row[indices[e]] = data[e]
        top, choice = -np.inf, -1
        for r in range(R):
            best[k, r] = -np.inf
            stay[k, r] = -1
        for j in range(m):
            r = real[j]
            value = row[j]
            following = best[k + 1, r] if (not sight or value > 0.0) else best[k + 1, R]
            kept = value - prices[k, j] + following
            if kept > best[k, r]:
                best[k, r] = kept
                stay[k, r] = j
            moved = kept - charge(value, cost, forfeit, idle_free)
            if moved > top:
                top, choice = moved, j
        move[k] = choice
        best[k, R] = top
        for r in range(R):
            if best[k, r] < top:
                best[k, r] = top
                stay[k, r] = -1
        for e in range(lo, hi):
            row[indices[e]] = 0.0


@njit(cache=True, nogil=True)
def paths(agents, window, prices, values, plan):
    """Longest paths: ``values`` (len(agents),) and ``plan`` (T, len(agents)) are filled."""
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T, m = prices.shape
    row = np.zeros(m)
    best = np.empty((T + 1, R + 1))
    move = np.empty(T, np.int64)
    stay = np.empty((T, R + 1), np.int64)
    stay[:, R] = -1
    for a in range(len(agents)):
        i = agents[a]
        free = start[i] == R + 1
        _to_go(i, 1 if free else 0, window, prices, row, best, move, stay)
        k, r = 0, start[i]
        if free:
            values[a], plan[0, a] = -np.inf, -1
            for e in range(indptr[i], indptr[i + 1]):
                row[indices[e]] = data[e]
            for j in range(m):
                q = real[j] if (not sight or row[j] > 0.0) else R
                total = row[j] - prices[0, j] + best[1, q]
                if total > values[a]:
                    values[a], plan[0, a], r = total, j, q
            for e in range(indptr[i], indptr[i + 1]):
                row[indices[e]] = 0.0
            k = 1
        else:
            values[a] = best[0, r]
        while k < T:
            j = stay[k, r] if stay[k, r] >= 0 else move[k]
            plan[k, a] = j
            if j < 0:  # nothing is allowed: the value is -inf
                k += 1
                continue
            r = real[j]
            if sight:
                seen = False
                for e in range(indptr[k * n + i], indptr[k * n + i + 1]):
                    if indices[e] == j:
                        seen = data[e] > 0.0
                if not seen:
                    r = R
            k += 1


@njit(cache=True, nogil=True)
def first_values(window, prices, out):
    """Value of every agent's best path that starts with every task, without the first step's prices; fills (n, m)."""
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T, m = prices.shape
    row = np.zeros(m)
    best = np.empty((T + 1, R + 1))
    move = np.empty(T, np.int64)
    stay = np.empty((T, R + 1), np.int64)
    for i in range(n):
        _to_go(i, np.int64(1), window, prices, row, best, move, stay)
        for e in range(indptr[i], indptr[i + 1]):
            row[indices[e]] = data[e]
        for j in range(m):
            r = real[j]
            total = row[j] + (best[1, r] if (not sight or row[j] > 0.0) else best[1, R])
            if start[i] != R + 1 and start[i] != r:
                total -= charge(row[j], cost, forfeit, idle_free)
            out[i, j] = total
        for e in range(indptr[i], indptr[i + 1]):
            row[indices[e]] = 0.0


@njit(cache=True, nogil=True)
def soft_paths(window, prices, weight, temperature, values, usage):
    """Soft values (n,) and the usage (T, m) added over the agents.

    ``weight`` is ``exp(-prices / temperature)``. Partition sums are kept relative to the largest one of their step.
    """
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T, m = prices.shape
    part = np.empty((T + 1, R + 2))
    scale = np.empty(T)
    lift = np.empty(T)
    keep = np.empty((T, m))  # weight of a task for who holds it
    enter = np.empty((T, m))  # and for who pays
    chance = np.empty(R + 2)
    after = np.empty(R + 2)
    leads_to = np.empty(m, np.int64)
    idle_factor = 1.0 if idle_free else np.exp(-cost / temperature)
    for i in range(n):
        log_z = 0.0
        part[T, :] = 1.0
        for k in range(T - 1, -1, -1):
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            top = 0.0
            for e in range(lo, hi):
                top = max(top, (data[e] - prices[k, indices[e]]) / temperature)
            lift[k] = top
            low = np.exp(-top)
            for j in range(m):
                keep[k, j] = weight[k, j] * low
                enter[k, j] = keep[k, j] * idle_factor
            for e in range(lo, hi):
                j = indices[e]
                keep[k, j] = np.exp((data[e] - prices[k, j]) / temperature - top)
                enter[k, j] = keep[k, j] * np.exp(-charge(data[e], cost, forfeit, idle_free) / temperature)
            if sight:  # only what is seen leads to its own state
                for j in range(m):
                    keep[k, j] *= part[k + 1, R]
                    enter[k, j] *= part[k + 1, R]
                for e in range(lo, hi):
                    if data[e] > 0.0:
                        j = indices[e]
                        blind = part[k + 1, R]
                        ratio = part[k + 1, real[j]] / blind if blind > 0.0 else np.nan
                        keep[k, j] *= ratio
                        enter[k, j] *= ratio
            else:
                for j in range(m):
                    keep[k, j] *= part[k + 1, real[j]]
                    enter[k, j] *= part[k + 1, real[j]]
            moved, free = 0.0, 0.0
            for j in range(m):
                moved += enter[k, j]
                free += keep[k, j]
            for r in range(R + 1):
                part[k, r] = moved
            for j in range(m):
                part[k, real[j]] += keep[k, j] - enter[k, j]
            part[k, R + 1] = free
            largest = free
            for r in range(R + 1):
                largest = max(largest, part[k, r])
            if not largest > 0.0:  # nothing that is allowed has a weight in the range of floats
                values[:] = np.nan
                usage[:] = np.nan
                return
            for r in range(R + 2):
                part[k, r] /= largest
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
            after[:] = 0.0
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            for j in range(m):
                leads_to[j] = R if sight else real[j]
            if sight:  # only what is seen leads to its own state
                for e in range(lo, hi):
                    if data[e] > 0.0:
                        leads_to[indices[e]] = real[indices[e]]
            for j in range(m):
                r = real[j]
                own = chance[r] / part[k, r] if chance[r] > 0.0 else 0.0
                used = (
                    enter[k, j] * shared + (keep[k, j] - enter[k, j]) * own + keep[k, j] * free_share
                ) / scale[k]
                usage[k, j] += used
                after[leads_to[j]] += used
            chance, after = after, chance
