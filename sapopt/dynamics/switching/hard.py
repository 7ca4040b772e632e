"""Compiled longest paths of agents under `SwitchingCost` and task prices.

Three recursions, one per cost rule; all of them are exact and all of them return a path that attains the value.

*strict* (every change of task pays the same cost): ``value_k[j] = benefit_k[j] - price_k[j] + max(value_{k-1}[j],
enter_k)`` with ``enter_k = max_j value_{k-1}[j] - cost``. Only the tasks an agent ever sees (its *slots*) need a value
of their own. On all other tasks it merely waits, and the least price of waiting over the steps [a, b) is the same for
every agent: ``min_j sum_{a <= k < b} price_k[j]``. That table is built once per price vector and shared.

*idle is free* (only a move into a positive benefit pays): an agent without a benefit at step k may stand anywhere, so
``value_k[j] = best_{k-1} - price_k[j]`` for such tasks, and the recursion runs over the stored benefits alone.

*matrix* (the cost of a move depends on both tasks): all m tasks, O(m^2) per step.

Prices may be +inf (forbidden), benefits may be -inf (forbidden); neither may be the other way round. The arrays are
explained in `sapopt.dynamics.switching.layout`; kernels that take `begin` and `end` are for `sapopt.kernels.blocks`.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.switching.layout import Slots, Window
from sapopt.kernels.blocks import work_array
from sapopt.kernels.jit import njit

# No NaN ever arises (infinities only meet with equal sign), which lets the compiler vectorise the max-reductions.
_FAST = {"nnan", "nsz"}
_NEG = -np.inf

_SMALL = 10_000
"""Numbers in the arguments of `_list_slots` up to which it takes a millisecond interpreted."""


def find_slots(window: Window, m: int, everyone: np.ndarray) -> Slots:
    """The slots of the agents: the tasks that they see or hold, and those of `everyone` (m,) bool."""
    n = window.n
    ptr = np.zeros(n + 1, np.int64)
    entry = np.empty(window.indices.size, np.int32)
    common = np.flatnonzero(everyone)
    # Counting first costs a second walk, and saves growing an array.
    for filling in (False, True):
        task = np.empty(ptr[n] if filling else 0, np.int32)
        _list_slots(window, common, filling, np.zeros(m, np.int64), np.empty(m, np.int32), ptr, task, entry)
        if not filling:
            np.cumsum(ptr, out=ptr)
    return Slots(ptr, task, entry)


@njit(cache=True, borrows=True, nogil=True, small=_SMALL)
def _list_slots(window, common, filling, mark, place, ptr, task, entry):
    """Count the tasks of every agent i into ``ptr[i + 1]``, or fill `task` and `entry`; `mark` (m,) holds zeros."""
    n, indptr, indices = window.n, window.indptr, window.indices
    for i in range(n):
        for j in common:
            mark[j] = i + 1
        if window.held[i] >= 0:
            mark[window.held[i]] = i + 1
        for r in range(i, indptr.size - 1, n):
            for e in range(indptr[r], indptr[r + 1]):
                mark[indices[e]] = i + 1
        found = 0
        for j in range(mark.size):  # in order; sorting an agent's tasks takes as long
            if mark[j] == i + 1:
                if filling:
                    task[ptr[i] + found] = j
                    place[j] = found
                found += 1
        if not filling:
            ptr[i + 1] = found
            continue
        for r in range(i, indptr.size - 1, n):
            for e in range(indptr[r], indptr[r + 1]):
                entry[e] = place[indices[e]]


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def waiting_table(begin, end, prices, excluded, price, task, paid):
    """Fill the rows of `Waiting.price` and `Waiting.task` for the first steps of a block; `paid` (m,) is scratch."""
    T, m = prices.shape
    for a in range(begin, end):
        for j in range(m):
            paid[j] = np.inf if excluded[j] else 0.0
        for b in range(a + 1, T + 1):
            row = prices[b - 1]
            least = np.inf
            for j in range(m):
                paid[j] += row[j]
                least = min(least, paid[j])
            price[a, b] = least
            for j in range(m):
                if paid[j] == least:
                    task[a, b] = j
                    break


class StrictScratch(NamedTuple):
    """Work arrays of `strict_paths`, for at most S slots.

    Attributes
    ----------
    value : (S,) float64
        Of the best way that ends on a slot.
    moved : (T, S) bool
        Whether the agent moved to the slot at that step, rather than stayed there.
    best : (T,) int64
        Where the best way up to a step ends: a slot, or S + a for waiting since step a (S the agent's number of slots).
    enter : (T,) float64
        Value of the best way before a step, less the cost of the move.
    """

    value: FloatArray
    moved: np.ndarray
    best: IntArray
    enter: FloatArray


def strict_scratch(T: int, slots: int) -> tuple[StrictScratch]:
    """Work arrays of one thread."""
    return (
        StrictScratch(
            work_array(slots), work_array((T, slots), np.bool_), work_array(T, np.int64), work_array(T)
        ),
    )


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def strict_paths(begin, end, window, slots, prices, waiting, values, plan, scratch):
    """Longest paths of the agents of a block under the strict rule: fills `values` (n,) and `plan` (n, T).

    Forward, for the slots s of an agent, with ``enter = best_{k-1} - cost`` and the shared table `waiting`:

        value_k[s] = max(value_{k-1}[s], enter_k) - price_k[s] + benefit_k[s]
        best_k     = max(max_s value_k[s], max_{a <= k} enter_a - waiting.price[a, k + 1])

    Backward the path is read off: from the best place of a step an agent stays where it is until the step at which
    it moved there (or began to wait), and was at the best place of the step before that.
    """
    n, indptr, data, cost = window.n, window.indptr, window.data, window.cost
    entry = slots.entry
    value, moved, best_at, enter_at = scratch.value, scratch.moved, scratch.best, scratch.enter
    T, m = prices.shape
    for i in range(begin, end):
        tasks = slots.task[slots.ptr[i] : slots.ptr[i + 1]]
        S = tasks.size
        for s in range(S):
            value[s] = _NEG
        best = 0.0
        first_is_free = True
        if window.held[i] >= 0:
            for s in range(S):
                if tasks[s] == window.held[i]:
                    value[s] = 0.0
                    first_is_free = False
        for k in range(T):
            enter = 0.0 if k == 0 and first_is_free else best - cost
            row = prices[k]
            for s in range(S):
                v = value[s]
                moved[k, s] = enter > v
                value[s] = max(v, enter) - row[tasks[s]]
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                value[entry[e]] += data[e]
            best = _NEG
            for s in range(S):
                best = max(best, value[s])
            at = -1
            if waiting.shared:
                enter_at[k] = enter
                for a in range(k + 1):
                    v = enter_at[a] - waiting.price[a, k + 1]
                    if v > best:
                        best = v
                        at = S + a
            if at < 0:
                # The maximum is found first and then looked for: the plain maximum is vectorised.
                at = 0
                for s in range(S):
                    if value[s] == best:
                        at = s
                        break
            best_at[k] = at
        values[i] = best
        k = T - 1
        at = best_at[k]
        while k >= 0:
            if at >= S:
                a = at - S
                j = waiting.task[a, k + 1]
                if not waiting.price[a, k + 1] > 0.0:
                    j = _free_task(prices, waiting.excluded, j, a, k + 1, (i * 7919) % m)
                for t in range(a, k + 1):
                    plan[i, t] = j
                k = a - 1
                if k >= 0:
                    at = best_at[k]
            else:
                plan[i, k] = tasks[at]
                if moved[k, at] and k > 0:
                    at = best_at[k - 1]
                k -= 1


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _free_task(prices, excluded, otherwise, a, b, first):
    """A task that costs nothing over the steps a .. b - 1, the next one from `first` on; `otherwise` if there is none.

    Agents start from different tasks: if all that wait stood on one task, the subgradient would punish that task alone.
    """
    m = prices.shape[1]
    for d in range(m):
        j = first + d
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
    return otherwise


class IdleFreeScratch(NamedTuple):
    """Work arrays of `idle_free_paths`; an agent's entries lie end to end, step by step.

    Attributes
    ----------
    value : (most entries,) float64
        Of the best way that ends with an entry.
    stay : (most entries,) bool
        Whether that way held the entry's task one step before.
    back : (T, 2) int64
        Best end of a way at each step: position of its entry (-1: none), and its task.
    """

    value: FloatArray
    stay: np.ndarray
    back: IntArray


def idle_free_scratch(T: int, entries: int) -> tuple[IdleFreeScratch]:
    """Work arrays of one thread."""
    return (
        IdleFreeScratch(work_array(entries), work_array(entries, np.bool_), work_array((T, 2), np.int64)),
    )


@njit(cache=True, borrows=True, nogil=True)
def idle_free_paths(begin, end, window, prices, cheapest, values, plan, scratch):
    """Longest paths of the agents of a block when idling is free: fills `values` (n,) and `plan` (n, T).

    Over the entries e (a task j with a benefit at step k) and the tasks without one, which cost their price alone:

        value_k[e] = max(value_{k-1}[j], best_{k-1} - cost if the benefit is positive) + benefit - price
        best_k     = max(max_e value_k[e], best_{k-1} - least price of a task without an entry)

    where value_{k-1}[j] of a task without an entry at step k - 1 is ``best_{k-2} - price_{k-1}[j]``. `cheapest`
    (T, count) lists the cheapest tasks of each step, enough to find one that an agent has no entry for; if it is empty
    all tasks are looked at.
    """
    n, indptr, indices, data, cost = window.n, window.indptr, window.indices, window.data, window.cost
    value, stay, back = scratch.value, scratch.stay, scratch.back
    T, m = prices.shape
    count = cheapest.shape[1]
    for i in range(begin, end):
        held = window.held[i]
        best_2 = 0.0  # best value two steps ago, for tasks that had no entry one step ago
        best_1 = 0.0
        place = 0  # of the step's first entry
        prev_lo, prev_hi, prev_place = 0, 0, 0
        for k in range(T):
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            row = prices[k]
            best = _NEG
            back[k, 0] = -1
            back[k, 1] = cheapest[k, 0] if count > 0 else 0
            p = prev_lo
            for e in range(lo, hi):
                j = indices[e]
                if k == 0:
                    kept = 0.0 if j == held else _NEG
                    charge = cost if (held >= 0 and data[e] > 0.0) else 0.0
                else:
                    charge = cost if data[e] > 0.0 else 0.0
                    while p < prev_hi and indices[p] < j:
                        p += 1
                    if p < prev_hi and indices[p] == j:
                        kept = value[prev_place + p - prev_lo]
                    else:
                        kept = best_2 - prices[k - 1, j]
                q = place + e - lo
                enter = best_1 - charge
                stay[q] = kept >= enter
                value[q] = max(kept, enter) + data[e] - row[j]
                if value[q] > best:
                    best = value[q]
                    back[k, 0] = q
                    back[k, 1] = j
            idle = _cheapest_without(indices, lo, hi, row, cheapest[k])
            if idle >= 0 and best_1 - row[idle] > best:
                best = best_1 - row[idle]
                back[k, 0] = -1
                back[k, 1] = idle
            prev_lo, prev_hi, prev_place = lo, hi, place
            place += hi - lo
            best_2 = best_1 if k > 0 else 0.0
            best_1 = best
        values[i] = best_1
        q = back[T - 1, 0]
        j = back[T - 1, 1]
        after = place
        for k in range(T - 1, -1, -1):
            plan[i, k] = j
            r = k * n + i
            place = after - (indptr[r + 1] - indptr[r])
            if k > 0:
                if q >= 0 and stay[q]:
                    # the same task one step earlier: an entry there, or a place to stand
                    lo, hi = indptr[r - n], indptr[r - n + 1]
                    here = _find(indices, lo, hi, j)
                    q = place - (hi - lo) + here - lo if here >= 0 else -1
                else:
                    q = back[k - 1, 0]
                    j = back[k - 1, 1]
            after = place


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _find(indices, lo, hi, j):
    """Position of task j among the ascending ``indices[lo:hi]``, -1 if it is not there."""
    stop = hi
    while lo < stop:
        middle = (lo + stop) >> 1
        if indices[middle] < j:
            lo = middle + 1
        else:
            stop = middle
    return lo if lo < hi and indices[lo] == j else -1


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _cheapest_without(indices, lo, hi, row, cheapest):
    """The cheapest task that is not among the ascending ``indices[lo:hi]``, -1 if there is none."""
    for j in cheapest:
        if _find(indices, lo, hi, j) < 0:
            return np.int64(j)
    if cheapest.size > 0:
        return np.int64(-1)
    found = np.int64(-1)
    e = lo
    for j in range(row.size):
        if e < hi and indices[e] == j:
            e += 1
        elif found < 0 or row[j] < row[found]:
            found = np.int64(j)
    return found


class MatrixScratch(NamedTuple):
    """Work arrays of `matrix_paths`: three of shape (m,), and `origin` (T, m) int32, the task one step before."""

    value: FloatArray
    new: FloatArray
    benefit: FloatArray
    origin: np.ndarray


def matrix_scratch(T: int, m: int) -> tuple[MatrixScratch]:
    """Work arrays of one thread."""
    return (
        MatrixScratch(work_array(m), work_array(m), work_array(m, fill=0.0), work_array((T, m), np.int32)),
    )


@njit(cache=True, borrows=True, nogil=True)
def matrix_paths(begin, end, window, idle_is_free, prices, values, plan, scratch):
    """Longest paths of the agents of a block under a matrix cost: fills `values` (n,) and `plan` (n, T).

    ``value_k[j] = benefit_k[j] - price_k[j] + max_a value_{k-1}[a] - cost[a, j]``; no cost where idling is free and
    the benefit is not positive.
    """
    n, indptr, indices, data, cost = window.n, window.indptr, window.indices, window.data, window.cost
    value, new, benefit, origin = scratch.value, scratch.new, scratch.benefit, scratch.origin
    T, m = prices.shape
    for i in range(begin, end):
        held = window.held[i]
        for k in range(T):
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                benefit[indices[e]] = data[e]
            for j in range(m):
                charged = benefit[j] > 0.0 or not idle_is_free
                if k == 0:
                    best = 0.0
                    arg = max(held, 0)
                    if held >= 0 and charged:
                        best = -cost[held, j]
                else:
                    best = _NEG
                    arg = 0
                    for a in range(m):
                        v = value[a] - cost[a, j] if charged else value[a]
                        if v > best:
                            best = v
                            arg = a
                new[j] = best + benefit[j] - prices[k, j]
                origin[k, j] = arg
            for j in range(m):
                value[j] = new[j]
            for e in range(indptr[r], indptr[r + 1]):
                benefit[indices[e]] = 0.0
        j = 0
        for a in range(m):
            if value[a] > value[j]:
                j = a
        values[i] = value[j]
        for k in range(T - 1, -1, -1):
            plan[i, k] = j
            j = origin[k, j]
