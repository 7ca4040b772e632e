"""Compiled longest paths of agents on batteries under task prices.

Backwards in time, for every step k and charge level l,

    N_k[l]     value of what follows from step k on, if the next start of work has to be paid,
    X_k[l, e]  the same for working at step k on entry e (a task j that the agent sees), not counting what it pays:
               ``X_k[l, e] = benefit - price + max(N_{k+1}[l'], X_{k+1}[l', the entry of j there])``

with l' the level after work, from ``N_T``, the value of charge that is left over at the end of the window (0 if the
problem ends there). An idle agent may stand on any task, the cheapest one if it is only to charge
(``least[k]``), so the recursion runs over levels and stored entries alone:

    N_k[l] = max(max_e X_k[l, e] - cost,  N_{k+1}[l''] - least[k],  max_e X_{k+1}[l'', e] - price of e's task at k)

with l'' the level after charging. The last term, an idle agent that stands on the task on which it will work at the
next step and does not pay for it, is there only where moves are charged and not entries. Level 0 is dead for good.

Layouts: entries are those of the flat benefits, row ``k * n + i``. `follow[e]` is the entry of the same task at the
next step if its benefit is positive there, `back[e]` that at the step before, whatever its benefit; -1 for none. The
arrays of one agent hold its entries end to end.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np
from numba import njit, prange

from sapopt.kernels.windows import fill_sorted

_FAST = {"nnan", "nsz"}  # infinities only meet with equal sign
_NEG = -np.inf


@njit(cache=True)
def neighbours(indptr, indices, data, T, n):
    """Entries of the same task one step later, if positive there, and one step before: (follow, back), int64."""
    follow = np.full(indices.size, -1, np.int64)
    back = np.full(indices.size, -1, np.int64)
    for r in range((T - 1) * n):
        p, end = indptr[r + n], indptr[r + n + 1]
        for e in range(indptr[r], indptr[r + 1]):
            while p < end and indices[p] < indices[e]:
                p += 1
            if p < end and indices[p] == indices[e]:
                back[p] = e
                if data[p] > 0.0:
                    follow[e] = p
    return follow, back


@njit(cache=True)
def row_maxima(indptr, data):
    """Largest entry of every row, at least 0."""
    out = np.zeros(indptr.size - 1)
    for r in range(out.size):
        for e in range(indptr[r], indptr[r + 1]):
            out[r] = max(out[r], data[e])
    return out


@njit(cache=True)
def most_entries(indptr, n, T):
    """Largest number of entries of one agent over all steps."""
    most = 1
    for i in range(n):
        count = 0
        for k in range(T):
            count += indptr[k * n + i + 1] - indptr[k * n + i]
        most = max(most, count)
    return most


@njit(cache=True)
def cheapest_tasks(prices, count):
    """Per step the `count` cheapest tasks in order of price: enough to find one that an agent has no entry for."""
    T, m = prices.shape
    out = np.empty((T, count), np.int32)
    for k in range(T):
        out[k] = np.argsort(prices[k], kind="mergesort")[:count]
    return out


@njit(cache=True)
def _idle_places(i, n, indptr, indices, prices, cheapest, mark, least, least_task):
    """Cheapest task without an entry at every step, and its price; +inf and -1 if there is none.

    `cheapest` (T, count) as from `cheapest_tasks`; if it is empty all tasks are looked at.
    """
    T, m = prices.shape
    for k in range(T):
        r = k * n + i
        for e in range(indptr[r], indptr[r + 1]):
            mark[indices[e]] = r
        least[k], least_task[k] = np.inf, -1
        if cheapest.shape[1] > 0:
            for c in range(cheapest.shape[1]):
                j = cheapest[k, c]
                if mark[j] != r:
                    least[k], least_task[k] = prices[k, j], j
                    break
        else:
            for j in range(m):
                if prices[k, j] < least[k] and mark[j] != r:
                    least[k], least_task[k] = prices[k, j], j
        for e in range(indptr[r], indptr[r + 1]):
            mark[indices[e]] = -1


@njit(cache=True, fastmath=_FAST)
def _values(i, n, rows, battery, prices, least, first, N, X, offset):
    """Fill N (T+1, levels+1) from step `first` on, and X (entries, levels+1) of one agent."""
    indptr, indices, data, follow, back = rows
    cost, drain, charge, capacity, entries, end = battery
    T = prices.shape[0]
    offset[0] = 0
    for k in range(T):
        offset[k + 1] = offset[k] + indptr[k * n + i + 1] - indptr[k * n + i]
    N[T] = end
    for k in range(T - 1, -1, -1):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        next_lo = indptr[r + n] if k + 1 < T else 0
        next_hi = indptr[r + n + 1] if k + 1 < T else 0
        dead = -least[k]
        for e in range(lo, hi):
            net = data[e] - prices[k, indices[e]]
            x = offset[k] + e - lo
            if not data[e] > 0.0:
                dead = max(dead, net)
                continue
            dead = max(dead, -prices[k, indices[e]])
            f = follow[e]
            X[x, 0] = _NEG
            for level in range(1, capacity + 1):
                after = max(level - drain, 0)
                best = N[k + 1, after]
                if f >= 0 and after > 0:
                    best = max(best, X[offset[k + 1] + f - next_lo, after])
                X[x, level] = net + best
        if k < first:
            continue
        N[k, 0] = N[k + 1, 0] + dead
        for level in range(1, capacity + 1):
            N[k, level] = N[k + 1, min(level + charge, capacity)] - least[k]
        for e in range(lo, hi):
            x = offset[k] + e - lo
            if data[e] > 0.0:
                for level in range(1, capacity + 1):
                    N[k, level] = max(N[k, level], X[x, level] - cost)
            else:
                net = data[e] - prices[k, indices[e]]
                for level in range(1, capacity + 1):
                    N[k, level] = max(N[k, level], net + N[k + 1, min(level + charge, capacity)])
        if entries:
            continue
        for e in range(next_lo, next_hi):
            if not data[e] > 0.0 or (back[e] >= 0 and data[back[e]] > 0.0):
                continue
            net = (data[back[e]] if back[e] >= 0 else 0.0) - prices[k, indices[e]]
            x = offset[k + 1] + e - next_lo
            for level in range(1, capacity + 1):
                N[k, level] = max(N[k, level], net + X[x, min(level + charge, capacity)])


@njit(cache=True)
def _walk(i, n, rows, battery, prices, least, least_task, start, N, X, offset, out):
    """Write the best path of one agent to `out` (T,) and return its value."""
    indptr, indices, data, _, back = rows
    cost, drain, charge, capacity, entries, end = battery
    level, ready, free = start
    T = prices.shape[0]
    value = 0.0
    for k in range(T):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        after = min(level + charge, capacity) if level > 0 else 0
        best = N[k + 1, after] - least[k]
        task = least_task[k]
        work = False
        for e in range(lo, hi):
            j = indices[e]
            if data[e] > 0.0 and level > 0:
                v = X[offset[k] + e - lo, level]
                if ready != j and not free:
                    v -= cost
            else:
                v = min(data[e], 0.0) - prices[k, j] + N[k + 1, after]
            if v > best or task < 0:
                best, task, work = v, j, data[e] > 0.0 and level > 0
        if level > 0 and not entries and k + 1 < T:
            next_lo, next_hi = indptr[r + n], indptr[r + n + 1]
            for e in range(next_lo, next_hi):
                if not data[e] > 0.0 or (back[e] >= 0 and data[back[e]] > 0.0):
                    continue
                net = (data[back[e]] if back[e] >= 0 else 0.0) - prices[k, indices[e]]
                v = net + X[offset[k + 1] + e - next_lo, after]
                if v > best or task < 0:
                    best, task, work = v, indices[e], False
        if k == 0:
            value = best
        out[k] = task
        free = False
        if work:
            level = max(level - drain, 0)
            ready = task
        else:
            level = after
            ready = -1 if entries else task
    return value


@njit(cache=True, parallel=True)
def best_paths(n, rows, battery, prices, cheapest, levels, ready, free, chunks):
    """All agents' longest paths: (values (n,), plan (T, n)).

    Parameters
    ----------
    rows : (indptr, indices, data, follow, back)
    battery : (cost, drain, charge, capacity, whether entries pay instead of moves, value (levels + 1,) at the end)
    cheapest : see `cheapest_tasks`
    levels, ready : (n,) int64
        Levels, and tasks that may be worked on at the first step without paying (-1 for none).
    free : bool
        Whether nobody pays at the first step.
    """
    T, m = prices.shape
    capacity = battery[3]
    most = most_entries(rows[0], n, T)
    values = np.empty(n)
    plan = np.empty((n, T), np.int64)
    for c in prange(chunks):
        N, X = np.empty((T + 1, capacity + 1)), np.empty((most, capacity + 1))
        mark, offset = np.full(m, -1), np.empty(T + 1, np.int64)
        least, least_task = np.empty(T), np.empty(T, np.int64)
        for i in range(c, n, chunks):
            _idle_places(i, n, rows[0], rows[1], prices, cheapest, mark, least, least_task)
            _values(i, n, rows, battery, prices, least, 0, N, X, offset)
            start = (levels[i], ready[i], free)
            values[i] = _walk(i, n, rows, battery, prices, least, least_task, start, N, X, offset, plan[i])
    return values, plan.T.copy()


@njit(cache=True)
def best_path(i, n, rows, battery, levels, ready, free, prices):
    """One agent's longest path: (value, path (T,)); cheap, as no list of the cheapest tasks is made."""
    T, m = prices.shape
    N, X = np.empty((T + 1, battery[3] + 1)), np.empty((most_entries(rows[0], n, T), battery[3] + 1))
    offset, path = np.empty(T + 1, np.int64), np.empty(T, np.int64)
    least, least_task = np.empty(T), np.empty(T, np.int64)
    none = np.empty((T, 0), np.int32)
    _idle_places(i, n, rows[0], rows[1], prices, none, np.full(m, -1), least, least_task)
    _values(i, n, rows, battery, prices, least, 0, N, X, offset)
    start = (levels[i], ready[i], free)
    return _walk(i, n, rows, battery, prices, least, least_task, start, N, X, offset, path), path


@njit(cache=True)
def place(n, rows, battery, levels, ready, free, order, closed, prices, plan):
    """Let the agents of `order` re-plan one by one, see `sapopt.dynamics.paths.oracles.PlacingOracle`."""
    T, m = prices.shape
    N = np.empty((T + 1, battery[3] + 1))
    X = np.empty((most_entries(rows[0], n, T), battery[3] + 1))
    mark, offset, path = np.full(m, -1), np.empty(T + 1, np.int64), np.empty(T, np.int64)
    least, least_task = np.empty(T), np.empty(T, np.int64)
    none = np.empty((T, 0), np.int32)
    for i in order:
        for k in range(T):
            closed[k, plan[k, i]] = prices[k, plan[k, i]]
        _idle_places(i, n, rows[0], rows[1], closed, none, mark, least, least_task)
        _values(i, n, rows, battery, closed, least, 0, N, X, offset)
        start = (levels[i], ready[i], free)
        _walk(i, n, rows, battery, closed, least, least_task, start, N, X, offset, path)
        for k in range(T):  # its old path was open, so one was found
            plan[k, i] = path[k]
            closed[k, path[k]] = np.inf


@njit(cache=True, parallel=True)
def first_entries(n, rows, battery, prices, cheapest, levels, ready, free, chunks):
    """Values of the paths by their first task; the prices of the first step must be 0.

    Returns (rest (n,), listed): the value of all tasks without an entry at step 0 and none at step 1, and for every
    entry of the steps 0 and 1 (in the order of the flat benefits) the value of its task.
    """
    indptr, indices, data, _, back = rows
    cost, drain, charge, capacity, entries, end = battery
    T, m = prices.shape
    most = most_entries(indptr, n, T)
    rest = np.empty(n)
    listed = np.full(indptr[min(T, 2) * n], _NEG)
    for c in prange(chunks):
        N, X = np.empty((T + 1, capacity + 1)), np.empty((most, capacity + 1))
        mark, offset = np.full(m, -1), np.empty(T + 1, np.int64)
        least, least_task = np.empty(T), np.empty(T, np.int64)
        for i in range(c, n, chunks):
            _idle_places(i, n, indptr, indices, prices, cheapest, mark, least, least_task)
            _values(i, n, rows, battery, prices, least, 1, N, X, offset)
            level = levels[i]
            after = min(level + charge, capacity) if level > 0 else 0
            rest[i] = N[1, after]
            for e in range(indptr[i], indptr[i + 1]):
                if data[e] > 0.0 and level > 0:
                    listed[e] = X[e - indptr[i], level]
                    if not free and ready[i] != indices[e]:
                        listed[e] -= cost
                else:
                    listed[e] = min(data[e], 0.0) + N[1, after]
            if T == 1:
                continue
            for e in range(indptr[n + i], indptr[n + i + 1]):
                b = back[e]
                listed[e] = listed[b] if b >= 0 else rest[i]
                if entries or level == 0 or not data[e] > 0.0 or (b >= 0 and data[b] > 0.0):
                    continue
                waits = X[offset[1] + e - indptr[n + i], after] + (data[b] if b >= 0 else 0.0)
                listed[e] = max(listed[e], waits)
                if b >= 0:
                    listed[b] = listed[e]
    return rest, listed


@njit(cache=True)
def first_gains(n, m, rows, rest, listed):
    """Sorted rows of what every listed first task brings beyond `rest`: (row_start, tasks, gains)."""
    indptr, indices, _, _, back = rows
    row_start = np.zeros(n + 1, np.int64)
    tasks = np.empty(listed.size, np.int32)
    gains = np.empty(listed.size)
    total = np.zeros(m)
    filled = 0
    for i in range(n):
        begin = filled
        for r in range(i, (indptr.size - 1) // n * n, n):
            if indptr[r] >= listed.size:
                break
            for e in range(indptr[r], indptr[r + 1]):
                if r >= n and back[e] >= 0:
                    continue
                tasks[filled] = indices[e]
                total[indices[e]] = listed[e] - rest[i]
                filled += 1
        fill_sorted(tasks, gains, total, begin, filled)
        row_start[i + 1] = filled
    return row_start, tasks[:filled].copy(), gains[:filled].copy()


@njit(cache=True)
def mean_values(n, rows, battery, prices, cheapest):
    """N_k[l] (T + 1, levels + 1), averaged over the agents."""
    T, m = prices.shape
    capacity = battery[3]
    total = np.zeros((T + 1, capacity + 1))
    N, X = np.empty((T + 1, capacity + 1)), np.empty((most_entries(rows[0], n, T), capacity + 1))
    mark, offset = np.full(m, -1), np.empty(T + 1, np.int64)
    least, least_task = np.empty(T), np.empty(T, np.int64)
    for i in range(n):
        _idle_places(i, n, rows[0], rows[1], prices, cheapest, mark, least, least_task)
        _values(i, n, rows, battery, prices, least, 0, N, X, offset)
        total += N / n
    return total
