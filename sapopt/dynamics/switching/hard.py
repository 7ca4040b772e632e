"""Compiled longest-path recursions of one agent under `SwitchingCost` and task prices.

Three recursions, one per cost rule; all of them are exact and all of them return a path that attains the value.

*strict* (every change of task pays the same cost): with E_k = max_j V_{k-1}[j] - cost,
``V_k[j] = benefit_k[j] - price_k[j] + max(V_{k-1}[j], E_k)``. Only the tasks an agent ever sees (its *slots*) need
an entry of their own. On all other tasks it merely parks, and the price of parking over the steps [a, b) is the same
for every agent: ``P[a, b] = min_j sum_{a <= k < b} price_k[j]``. The table P is built once per price vector and shared.

*idle is free* (only a move into a positive benefit pays): an agent without a benefit at step k may stand anywhere, so
``V_k[j] = best_{k-1} - price_k[j]`` for such tasks, and the recursion runs over the stored benefits alone.

*matrix* (the cost of a move depends on both tasks): all m tasks, O(m^2) per step.

Prices may be +inf (forbidden), benefits may be -inf (forbidden); neither may be the other way round.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

# No NaN ever arises (infinities only meet with equal sign), which lets the compiler vectorise the max-reductions.
_FAST = {"nnan", "nsz"}
_NEG = -np.inf


@njit(cache=True)
def seen_tasks(indptr, indices, n, T, m, extra, always):
    """Per agent the sorted tasks of its stored entries, of `extra[i]` (if >= 0) and of `always` (m,) bool.

    Returns (slot_ptr (n+1,), slot_task (total,) int32, entry_slot (nnz,) int32).
    """
    slot_ptr = np.zeros(n + 1, np.int64)
    entry_slot = np.empty(indices.size, np.int32)
    stamp = np.zeros(m, np.int64)  # i + 1 where agent i has the task
    where = np.empty(m, np.int32)
    tasks = np.empty(max(16, 4 * n), np.int32)
    total = 0
    everyone = np.flatnonzero(always)
    for i in range(n):
        if total + m > tasks.size:
            bigger = np.empty(2 * tasks.size + m, np.int32)
            bigger[:total] = tasks[:total]
            tasks = bigger
        for j in everyone:
            stamp[j] = i + 1
        if extra[i] >= 0:
            stamp[extra[i]] = i + 1
        for k in range(T):
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                stamp[indices[e]] = i + 1
        for task in range(m):  # in order; sorting them takes as long, and numba seconds to compile
            if stamp[task] == i + 1:
                where[task] = total - slot_ptr[i]
                tasks[total] = task
                total += 1
        slot_ptr[i + 1] = total
        for k in range(T):
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                entry_slot[e] = where[indices[e]]
    return slot_ptr, tasks[:total].copy(), entry_slot


@njit(cache=True, parallel=True, fastmath=_FAST)
def parking_table(prices, excluded):
    """P[a, b] = min over tasks not excluded of sum_{a <= k < b} prices[k, j], and a task that attains it.

    Returns (P (T, T+1), task (T, T+1) int32); entries with b <= a are unused.
    """
    T, m = prices.shape
    P = np.zeros((T, T + 1))
    task = np.zeros((T, T + 1), np.int32)
    for a in prange(T):
        acc = np.zeros(m)
        for j in range(m):
            if excluded[j]:
                acc[j] = np.inf
        for b in range(a + 1, T + 1):
            row = prices[b - 1]
            least = np.inf
            for j in range(m):
                acc[j] += row[j]
                least = min(least, acc[j])
            P[a, b] = least
            for j in range(m):
                if acc[j] == least:
                    task[a, b] = j
                    break
    return P, task


@njit(cache=True)
def _parking_task(prices, excluded, table, least, a, b, agent):
    """A task that attains P[a, b]; free parking is spread over the free tasks by the agent's number.

    Spreading matters: if all idle agents stood on one task, the subgradient would punish that task alone.
    """
    if least > 0.0:
        return table[a, b]
    m = prices.shape[1]
    start = (agent * 7919) % m
    for d in range(m):
        j = start + d
        if j >= m:
            j -= m
        if excluded[j]:
            continue
        free = True
        for k in range(a, b):
            if prices[k, j] > 0.0:
                free = False
                break
        if free:
            return j
    return table[a, b]


@njit(cache=True, fastmath=_FAST)
def _strict_path(
    agent, n, indptr, entry_slot, data, slots, cost, start, prices, park, P, park_task, excluded,
    V, moved, argbest, W, out,
):  # fmt: skip
    """Longest path of one agent under the strict rule; writes it to `out` (T,) and returns its value."""
    T = prices.shape[0]
    S = slots.size
    for s in range(S):
        V[s] = _NEG
    best = 0.0
    first_free = True
    if start >= 0:
        for s in range(S):
            if slots[s] == start:
                V[s] = 0.0
                first_free = False
    for k in range(T):
        enter = best - cost
        if k == 0 and first_free:
            enter = 0.0
        row = prices[k]
        for s in range(S):
            v = V[s]
            moved[k, s] = enter > v
            V[s] = max(v, enter) - row[slots[s]]
        r = k * n + agent
        for e in range(indptr[r], indptr[r + 1]):
            V[entry_slot[e]] += data[e]
        best = _NEG
        for s in range(S):
            best = max(best, V[s])
        arg = -1
        if park:
            W[k] = enter
            for a in range(k + 1):
                v = W[a] - P[a, k + 1]
                if v > best:
                    best = v
                    arg = S + a
        if arg < 0:
            arg = 0
            for s in range(S):
                if V[s] == best:
                    arg = s
                    break
        argbest[k] = arg
    k = T - 1
    at = argbest[k]
    while k >= 0:
        if at >= S:
            a = at - S
            j = _parking_task(prices, excluded, park_task, P[a, k + 1], a, k + 1, agent)
            for t in range(a, k + 1):
                out[t] = j
            k = a - 1
            if k >= 0:
                at = argbest[k]
        else:
            out[k] = slots[at]
            if moved[k, at] and k > 0:
                at = argbest[k - 1]
            k -= 1
    return best


@njit(cache=True, parallel=True)
def strict_paths(
    indptr, entry_slot, data, slot_ptr, slot_task, cost, start, prices, park, P, park_task, excluded, chunks
):
    """All agents' longest paths under the strict rule. Returns (values (n,), plan (T, n))."""
    T = prices.shape[0]
    n = slot_ptr.size - 1
    values = np.empty(n)
    plan = np.empty((n, T), np.int64)
    S_max = 1
    for i in range(n):
        S_max = max(S_max, slot_ptr[i + 1] - slot_ptr[i])
    for c in prange(chunks):
        V = np.empty(S_max)
        moved = np.empty((T, S_max), np.bool_)
        argbest = np.empty(T, np.int64)
        W = np.empty(T)
        for i in range(c, n, chunks):
            slots = slot_task[slot_ptr[i] : slot_ptr[i + 1]]
            values[i] = _strict_path(
                i, n, indptr, entry_slot, data, slots, cost, start[i], prices,
                park, P, park_task, excluded, V, moved, argbest, W, plan[i],
            )  # fmt: skip
    return values, plan.T.copy()


@njit(cache=True)
def strict_path_all_tasks(agent, n, indptr, indices, data, cost, start, prices):
    """One agent's longest path with all m tasks as nodes: no table to build, the cheapest way to a single path."""
    T, m = prices.shape
    tasks = np.arange(m).astype(np.int32)
    out = np.empty(T, np.int64)
    none = np.zeros((1, 1), np.int32)
    value = _strict_path(
        agent, n, indptr, indices, data, tasks, cost, start, prices, False, np.zeros((1, 1)), none,
        np.zeros(1, np.bool_), np.empty(m), np.empty((T, m), np.bool_), np.empty(T, np.int64), np.empty(1), out,
    )  # fmt: skip
    return value, out


@njit(cache=True)
def cheapest_tasks(prices, count):
    """Per step the `count` cheapest tasks in order of price: enough to find one that an agent has no entry for."""
    T, m = prices.shape
    out = np.empty((T, count), np.int32)
    for k in range(T):
        order = np.argsort(prices[k], kind="mergesort")
        for c in range(count):
            out[k, c] = order[c]
    return out


@njit(cache=True)
def _idle_free_path(agent, n, indptr, indices, data, cost, start, prices, cheapest, value, stay, back, out):
    """Longest path of one agent when only a move into a positive benefit pays.

    Scratch: `value`, `stay` over this agent's entries laid end to end, `back` (T, 2): best node of each step as
    (entry position or -1, task).
    """
    T = prices.shape[0]
    best_2 = 0.0  # best value two steps ago, for tasks that had no entry one step ago
    best_1 = 0.0
    begin = 0
    prev_lo, prev_hi, prev_begin = 0, 0, 0
    for k in range(T):
        r = k * n + agent
        lo, hi = indptr[r], indptr[r + 1]
        row = prices[k]
        best = _NEG
        back[k, 0] = -1
        back[k, 1] = cheapest[k, 0]
        p = prev_lo
        for e in range(lo, hi):
            j = indices[e]
            if k == 0:
                held = 0.0 if j == start else _NEG
                charge = cost if (start >= 0 and data[e] > 0.0) else 0.0
            else:
                charge = cost if data[e] > 0.0 else 0.0
                while p < prev_hi and indices[p] < j:
                    p += 1
                if p < prev_hi and indices[p] == j:
                    held = value[prev_begin + p - prev_lo]
                else:
                    held = best_2 - prices[k - 1, j]
            q = begin + e - lo
            enter = best_1 - charge
            stay[q] = held >= enter
            value[q] = max(held, enter) + data[e] - row[j]
            if value[q] > best:
                best = value[q]
                back[k, 0] = q
                back[k, 1] = j
        for c in range(cheapest.shape[1]):  # cheapest task without an entry: free to stand on
            j = cheapest[k, c]
            here = lo + np.searchsorted(indices[lo:hi], j)
            if here == hi or indices[here] != j:
                v = best_1 - row[j]
                if v > best:
                    best = v
                    back[k, 0] = -1
                    back[k, 1] = j
                break
        prev_lo, prev_hi, prev_begin = lo, hi, begin
        begin += hi - lo
        best_2 = best_1 if k > 0 else 0.0
        best_1 = best
    k = T - 1
    q = back[k, 0]
    j = back[k, 1]
    end = begin
    while k >= 0:
        out[k] = j
        r = k * n + agent
        begin = end - (indptr[r + 1] - indptr[r])
        if k > 0:
            if q >= 0 and stay[q]:
                # the same task one step earlier: an entry there, or a place to stand
                lo, hi = indptr[r - n], indptr[r - n + 1]
                here = lo + np.searchsorted(indices[lo:hi], j)
                if here < hi and indices[here] == j:
                    q = begin - (hi - lo) + here - lo
                else:
                    q = -1
            else:
                q = back[k - 1, 0]
                j = back[k - 1, 1]
        end = begin
        k -= 1
    return best_1


@njit(cache=True, parallel=True)
def idle_free_paths(indptr, indices, data, n, cost, start, prices, cheapest, chunks):
    """All agents' longest paths when idling is free. Returns (values (n,), plan (T, n))."""
    T = prices.shape[0]
    values = np.empty(n)
    plan = np.empty((n, T), np.int64)
    most = 1
    for i in range(n):
        count = 0
        for k in range(T):
            count += indptr[k * n + i + 1] - indptr[k * n + i]
        most = max(most, count)
    for c in prange(chunks):
        value = np.empty(most)
        stay = np.empty(most, np.bool_)
        back = np.empty((T, 2), np.int64)
        for i in range(c, n, chunks):
            values[i] = _idle_free_path(
                i, n, indptr, indices, data, cost, start[i], prices, cheapest, value, stay, back, plan[i]
            )
    return values, plan.T.copy()


@njit(cache=True)
def idle_free_path(agent, n, indptr, indices, data, cost, start, prices):
    """One agent's longest path when idling is free, with its own list of cheapest tasks."""
    T, m = prices.shape
    most = 1
    count = 0
    for k in range(T):
        width = indptr[k * n + agent + 1] - indptr[k * n + agent]
        most = max(most, width)
        count += width
    cheapest = cheapest_tasks(prices, min(m, most + 1))
    out = np.empty(T, np.int64)
    value = _idle_free_path(
        agent, n, indptr, indices, data, cost, start, prices, cheapest,
        np.empty(count + 1), np.empty(count + 1, np.bool_), np.empty((T, 2), np.int64), out,
    )  # fmt: skip
    return value, out


@njit(cache=True)
def _matrix_path(
    agent, n, indptr, indices, data, cost, idle_is_free, start, prices, V, new, origin, dense, out
):
    """Longest path of one agent with a full (m, m) matrix of move costs; `origin` (T, m) holds predecessors."""
    T, m = prices.shape
    for k in range(T):
        r = k * n + agent
        dense[:] = 0.0
        for e in range(indptr[r], indptr[r + 1]):
            dense[indices[e]] = data[e]
        for j in range(m):
            if k == 0:
                best = 0.0
                arg = max(start, 0)
                if start >= 0 and (dense[j] > 0.0 or not idle_is_free):
                    best = -cost[start, j]
            else:
                best = _NEG
                arg = 0
                charged = dense[j] > 0.0 or not idle_is_free
                for a in range(m):
                    v = V[a] - cost[a, j] if charged else V[a]
                    if v > best:
                        best = v
                        arg = a
            new[j] = best + dense[j] - prices[k, j]
            origin[k, j] = arg
        V[:] = new
    j = 0
    for a in range(m):
        if V[a] > V[j]:
            j = a
    value = V[j]
    for k in range(T - 1, -1, -1):
        out[k] = j
        j = origin[k, j]
    return value


@njit(cache=True, parallel=True)
def matrix_paths(indptr, indices, data, n, cost, idle_is_free, start, prices, first, last):
    """Longest paths of the agents first..last-1 under a matrix cost. Returns (values, plan (T, last-first))."""
    T, m = prices.shape
    count = last - first
    values = np.empty(count)
    plan = np.empty((count, T), np.int64)
    for c in prange(count):
        values[c] = _matrix_path(
            first + c, n, indptr, indices, data, cost, idle_is_free, start[first + c], prices,
            np.empty(m), np.empty(m), np.empty((T, m), np.int32), np.empty(m), plan[c],
        )  # fmt: skip
    return values, plan.T.copy()
