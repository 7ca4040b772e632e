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

The arrays of one agent hold its entries end to end, step by step. Kernels that take `begin` and `end` are for
`sapopt.kernels.blocks`.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.blocks import work_array
from sapopt.kernels.jit import njit
from sapopt.kernels.windows import fill_sorted

_FAST = {"nnan", "nsz"}  # infinities only meet with equal sign
_NEG = -np.inf


class Rows(NamedTuple):
    """Benefits of n agents over a window; row ``k * n + i`` is agent i at step k.

    Attributes
    ----------
    n : int
    indptr : (T * n + 1,) int64
    indices : (entries,) int32
        Tasks, ascending inside a row.
    data : (entries,) float64
        Benefits; -inf forbids a pair.
    follow : (entries,) int64
        Entry of the same task at the next step if its benefit is positive there, else -1.
    back : (entries,) int64
        Entry of the same task at the step before, whatever its benefit; -1 for none.
    """

    n: int
    indptr: IntArray
    indices: NDArray[np.int32]
    data: FloatArray
    follow: IntArray
    back: IntArray


class Rule(NamedTuple):
    """What a battery does, in whole units of charge.

    Attributes
    ----------
    cost : float
        Of a start of work that has to be paid.
    drain, charge, capacity : int
    entries : bool
        Whether every start of work pays, instead of every move.
    end : (capacity + 1,) float64
        Value of every level after the window.
    """

    cost: float
    drain: int
    charge: int
    capacity: int
    entries: bool
    end: FloatArray


class Before(NamedTuple):
    """State before the window.

    Attributes
    ----------
    levels : (n,) int64
    ready : (n,) int64
        Task that an agent may work on at the first step without paying, -1 for none.
    free : bool
        Whether nobody pays at the first step.
    """

    levels: IntArray
    ready: IntArray
    free: bool


class Scratch(NamedTuple):
    """Work arrays of one agent at a time.

    Attributes
    ----------
    paid : (T + 1, levels + 1) float64
        N_k[l], value of what follows if the next start of work has to be paid.
    working : (most entries, levels + 1) float64
        X_k[l, e], value of working on an entry and what follows, not counting what it pays.
    offset : (T + 1,) int64
        Where the entries of a step begin in `working`.
    mark : (m,) int64
        Row that saw a task last; -1 between two agents.
    least : (T,) float64
        Price of the cheapest task without an entry, +inf if there is none.
    least_task : (T,) int64
        That task, -1 if there is none.
    """

    paid: FloatArray
    working: FloatArray
    offset: IntArray
    mark: IntArray
    least: FloatArray
    least_task: IntArray


def make_scratch(T: int, m: int, most: int, capacity: int) -> tuple[Scratch]:
    """Work arrays of one thread, for agents of at most `most` entries."""
    return (
        Scratch(
            work_array((T + 1, capacity + 1)), work_array((most, capacity + 1)), work_array(T + 1, np.int64),
            work_array(m, np.int64, -1), work_array(T), work_array(T, np.int64),
        ),
    )  # fmt: skip


def link_rows(indptr: IntArray, indices: NDArray[np.int32], data: FloatArray, n: int) -> Rows:
    """The rows with the entries of the same task one step later and one before."""
    rows = Rows(n, indptr, indices, data, np.full(indices.size, -1), np.full(indices.size, -1))
    _link(rows)
    return rows


@njit(cache=True, borrows=True, nogil=True)
def _link(rows):
    n, indptr, indices = rows.n, rows.indptr, rows.indices
    for r in range(indptr.size - 1 - n):
        p, end = indptr[r + n], indptr[r + n + 1]
        for e in range(indptr[r], indptr[r + 1]):
            while p < end and indices[p] < indices[e]:
                p += 1
            if p < end and indices[p] == indices[e]:
                rows.back[p] = e
                if rows.data[p] > 0.0:
                    rows.follow[e] = p


def row_maxima(indptr: IntArray, data: FloatArray) -> FloatArray:
    """Largest entry of every row, at least 0."""
    out = np.zeros(indptr.size - 1)
    filled = np.flatnonzero(np.diff(indptr))
    if filled.size:
        out[filled] = np.maximum(np.maximum.reduceat(data, indptr[filled]), 0.0)
    return out


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _idle_places(i, rows, prices, cheapest, scratch):
    """Cheapest task without an entry at every step, and its price; +inf and -1 if there is none.

    `cheapest` (T, count) as from `cheapest_tasks`; if it is empty all tasks are looked at.
    """
    n, indptr, indices = rows.n, rows.indptr, rows.indices
    mark, least, least_task = scratch.mark, scratch.least, scratch.least_task
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


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _values(i, rows, rule, prices, first, scratch):
    """Fill ``N = scratch.paid`` from step `first` on, and ``X = scratch.working`` of one agent; see the module."""
    n, indptr, indices, data, follow, back = rows
    cost, drain, charge, capacity, entries, end = rule
    N, X, offset, least = scratch.paid, scratch.working, scratch.offset, scratch.least
    T = prices.shape[0]
    offset[0] = 0
    for k in range(T):
        offset[k + 1] = offset[k] + indptr[k * n + i + 1] - indptr[k * n + i]
    for level in range(capacity + 1):
        N[T, level] = end[level]
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


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _walk(i, rows, rule, prices, before, scratch, out):
    """Write the best path of one agent to `out` (T,) and return its value.

    Forward in time from the agent's own level; at every step it does what the values to go say is best.
    """
    n, indptr, data, back = rows.n, rows.indptr, rows.data, rows.back
    indices = rows.indices
    cost, drain, charge, capacity, entries, end = rule
    N, X, offset = scratch.paid, scratch.working, scratch.offset
    least, least_task = scratch.least, scratch.least_task
    level, ready, free = before.levels[i], before.ready[i], before.free
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


@njit(cache=True, borrows=True, nogil=True)
def best_paths(begin, end, rows, rule, before, prices, cheapest, values, plan, scratch):
    """Longest paths of the agents of a block: fills `values` (n,) and `plan` (n, T).

    `cheapest` as in `_idle_places`.
    """
    for i in range(begin, end):
        _idle_places(i, rows, prices, cheapest, scratch)
        _values(i, rows, rule, prices, np.int64(0), scratch)
        values[i] = _walk(i, rows, rule, prices, before, scratch, plan[i])


@njit(cache=True, borrows=True, nogil=True)
def place(order, rows, rule, before, closed, prices, none, plan, path, scratch):
    """Let the agents of `order` re-plan one by one, see `sapopt.dynamics.paths.oracles.PlacingOracle`.

    `none` (T, 0) int32 and `path` (T,) int64 are scratch.
    """
    T = prices.shape[0]
    for i in order:
        for k in range(T):
            closed[k, plan[k, i]] = prices[k, plan[k, i]]
        _idle_places(i, rows, closed, none, scratch)
        _values(i, rows, rule, closed, np.int64(0), scratch)
        _walk(i, rows, rule, closed, before, scratch, path)
        for k in range(T):  # its old path was open, so one was found
            plan[k, i] = path[k]
            closed[k, path[k]] = np.inf


@njit(cache=True, borrows=True, nogil=True)
def first_entries(begin, end, rows, rule, before, prices, cheapest, rest, listed, scratch):
    """Values of the paths by their first task, for the agents of a block; the prices of the first step must be 0.

    Fills `rest` (n,), the value of all tasks without an entry at step 0 and none at step 1, and `listed`: for every
    entry of the steps 0 and 1 (in the order of the flat benefits) the value of its task.
    """
    n, indptr, indices, data, back = rows.n, rows.indptr, rows.indices, rows.data, rows.back
    N, X, offset = scratch.paid, scratch.working, scratch.offset
    T = prices.shape[0]
    for i in range(begin, end):
        _idle_places(i, rows, prices, cheapest, scratch)
        _values(i, rows, rule, prices, np.int64(1), scratch)
        level = before.levels[i]
        after = min(level + rule.charge, rule.capacity) if level > 0 else 0
        rest[i] = N[1, after]
        for e in range(indptr[i], indptr[i + 1]):
            if data[e] > 0.0 and level > 0:
                listed[e] = X[e - indptr[i], level]
                if not before.free and before.ready[i] != indices[e]:
                    listed[e] -= rule.cost
            else:
                listed[e] = min(data[e], 0.0) + N[1, after]
        if T == 1:
            continue
        for e in range(indptr[n + i], indptr[n + i + 1]):
            b = back[e]
            listed[e] = listed[b] if b >= 0 else rest[i]
            if rule.entries or level == 0 or not data[e] > 0.0 or (b >= 0 and data[b] > 0.0):
                continue
            # It may wait on the task at step 0 and start work there at step 1 without paying.
            waits = X[offset[1] + e - indptr[n + i], after] + (data[b] if b >= 0 else 0.0)
            listed[e] = max(listed[e], waits)
            if b >= 0:
                listed[b] = listed[e]


@njit(cache=True, borrows=True, nogil=True)
def first_gains(rows, rest, listed, total, row_start, tasks, gains):
    """Sorted rows of what every listed first task brings beyond `rest`; returns how many entries they have.

    Fills `row_start` (n + 1,), `tasks` and `gains` (at most as many as `listed`); `total` (m,) is scratch.
    """
    n, indptr, indices, back = rows.n, rows.indptr, rows.indices, rows.back
    filled = np.int64(
        0
    )  # a plain 0 would be a type of its own to the compiler, and `fill_sorted` compiled twice
    row_start[0] = 0
    for i in range(n):
        begin = filled
        for r in range(i, indptr.size - 1, n):
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
    return filled


@njit(cache=True, borrows=True, nogil=True)
def add_values(begin, end, rows, rule, prices, cheapest, scratch, total):
    """Add N_k[l] of the agents of a block to `total` (T + 1, levels + 1)."""
    T = prices.shape[0]
    for i in range(begin, end):
        _idle_places(i, rows, prices, cheapest, scratch)
        _values(i, rows, rule, prices, np.int64(0), scratch)
        for k in range(T + 1):
            for level in range(rule.capacity + 1):
                total[k, level] += scratch.paid[k, level]
