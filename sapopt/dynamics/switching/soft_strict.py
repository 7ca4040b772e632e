"""Log-sum-exp smoothing of the longest paths under the strict switching cost.

With temperature eps the value of an agent becomes ``eps log sum_paths exp(value(path) / eps)``, a smooth convex upper
bound of its longest path whose gradient is the occupancy of (step, task) under the Gibbs distribution of paths. In the
linear domain the recursion of `sapopt.dynamics.switching.hard` turns into multiplications and additions, with
move = exp(-cost / eps), weight = exp(-price / eps), gain = exp(benefit / eps):

    forward    ahead_k[j] = weight gain (ahead_{k-1}[j] + move sum ahead_{k-1})
    backward   behind_k[j] = (weight gain behind)_{k+1}[j] + move sum_j (weight gain behind)_{k+1}[j]

Every step is rescaled, so only ratios within one step matter; what underflows there is worse than moving away by far
more than the cost of a move. Waiting on tasks that the agent never sees runs over intervals a .. b - 1 that all agents
share, as in the hard recursion, here with the sums over the tasks of the product of their weights: see `SoftWaiting`.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.kernels.blocks import work_array
from sapopt.kernels.jit import njit

_FAST = {"nnan", "nsz", "reassoc", "contract"}


# Terms below exp(_TINY) of their sum are left out.
_TINY = -30.0


LEAST = 1e-140
"""Least weight with which `SoftWaiting.linear` is safe: over the least weight of a move it stays within floats."""

# What is set to zero in time, before it becomes a number that processors are slow with.
_NOTHING = 1e-200

_NOBODY = 1e-6
"""Expected number of waiting agents that is not worth spreading over the tasks."""


class SoftWaiting(NamedTuple):
    """What waiting weighs, the same for all agents.

    Attributes
    ----------
    shared : bool
        Whether there are tasks to wait on; else every task is a slot and the arrays have size 1.
    linear : bool
        Whether the table holds weights, relative to `best`; else, as these would leave the range of floats, logarithms
        of weights.
    best : (T,) float64
        Greatest weight of one task that may be waited on.
    table : (T, T + 1) float64
        At [a, b] the sum over these tasks of the product of their weights over the steps a .. b - 1, each divided by
        `best` where `linear`.
    by_end : (T + 1, T) float64
        The same at [b, a].
    """

    shared: bool
    linear: bool
    best: FloatArray
    table: FloatArray
    by_end: FloatArray


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def soft_waiting(begin, end, weight, best, excluded, table, lowest, held):
    """Fill the rows of a block of `table` (T, T + 1) as `SoftWaiting.linear`, and the least of each in `lowest` (T,).

    `held` (m,) is scratch.
    """
    T, m = weight.shape
    for a in range(begin, end):
        for j in range(m):
            held[j] = 0.0 if excluded[j] else 1.0
        lowest[a] = np.inf
        for b in range(a + 1, T + 1):
            row = weight[b - 1]
            inverse = 1.0 / best[b - 1]
            total = 0.0
            for j in range(m):
                v = held[j] * (row[j] * inverse)
                if v < _NOTHING:
                    v = 0.0
                held[j] = v
                total += v
            table[a, b] = total
            lowest[a] = min(lowest[a], total)


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def soft_waiting_logs(begin, end, weight, excluded, table, held):
    """Fill the rows of a block of `table` (T, T + 1) with logarithms; it holds a number close to -inf on entry.

    `held` (m,) is scratch.
    """
    T, m = weight.shape
    for a in range(begin, end):
        for j in range(m):
            held[j] = 0.0 if excluded[j] else 1.0
        level = 0.0
        factor = 1.0
        for b in range(a + 1, T + 1):
            row = weight[b - 1]
            total = 0.0
            for j in range(m):
                v = held[j] * row[j] * factor
                held[j] = v
                total += v
            if not total > 0.0:
                break
            table[a, b] = level + np.log(total)
            factor = 1.0
            if total < 1e-100:  # rescale before anything that matters underflows
                factor = 1.0 / total
                level += np.log(total)


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def spread_waiting(begin, end, weight, waiting, excluded, mass, usage, ratio, product, onward, crowd):
    """Fill the columns of a block of tasks of `usage` (T, m): who waits, spread over the tasks by their weight.

    Of the agents that wait over the steps a .. b - 1, task j gets the share ``ratio_a[j] ... ratio_{b-1}[j] / table``.
    Those that began at a and are on task j at step k are, by one recursion forward and one backward,

        product_k[j] = product_{k-1}[j] ratio_k[j]
        onward_k[j]  = crowd[k + 1] + ratio_{k+1}[j] onward_{k+1}[j]
        usage_k[j]  += product_k[j] onward_k[j]

    Parameters
    ----------
    weight : (T, m) float64
    waiting : SoftWaiting
        With weights, not with logarithms.
    excluded : (m,) bool
    mass : (T, T + 1) float64
        Expected number of agents that wait over the steps a .. b - 1, at [a, b]; next to nobody is left out.
    ratio : (T, m) float64
        Scratch: weights of the tasks that may be waited on, each divided by the best of its step; 0 for the others.
    product, onward : (T, m) and (m,) float64
        Scratch.
    crowd : (T + 1,) float64
        Scratch: the numbers of one a, divided by the table.
    """
    T = weight.shape[0]
    for k in range(T):
        best = waiting.best[k]
        for j in range(begin, end):
            usage[k, j] = 0.0
            ratio[k, j] = 0.0 if excluded[j] else weight[k, j] / best
    for a in range(T):
        last = a
        for b in range(a + 1, T + 1):
            crowd[b] = 0.0
            if mass[a, b] > _NOBODY:
                crowd[b] = mass[a, b] / waiting.table[a, b]
                last = b
        for j in range(begin, end):
            onward[j] = 1.0
        for k in range(a, last):
            for j in range(begin, end):
                v = onward[j] * ratio[k, j]
                v = v if v > _NOTHING else 0.0
                onward[j] = v
                product[k, j] = v
        for j in range(begin, end):
            onward[j] = 0.0
        for k in range(last - 1, a - 1, -1):
            leaving = crowd[k + 1]
            for j in range(begin, end):
                onward[j] += leaving
                usage[k, j] += product[k, j] * onward[j]
                onward[j] *= ratio[k, j]


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def spread_waiting_logs(begin, end, smoothing, excluded, table, mass, usage, held):
    """The same from logarithms of weights, with the expected numbers `mass` (T, T + 1) and scratch `held` (T + 1,)."""
    eps, prices = smoothing.temperature, smoothing.prices
    least = np.exp(_TINY)
    T = prices.shape[0]
    for j in range(begin, end):
        for k in range(T):
            usage[k, j] = 0.0
        if excluded[j]:
            continue
        for a in range(T):
            price = 0.0
            last = T
            while last > a and not mass[a, last] > _NOBODY:
                last -= 1
            for b in range(a + 1, last + 1):
                held[b] = 0.0
                price += prices[b - 1, j]
                if mass[a, b] > _NOBODY:
                    share = np.exp(-price / eps - table[a, b])
                    if share > least:
                        held[b] = share * mass[a, b]
            # Whoever leaves at b was there at every step since a.
            total = 0.0
            for k in range(last - 1, a - 1, -1):
                total += held[k + 1]
                usage[k, j] += total


class StrictSoftScratch(NamedTuple):
    """Work arrays of `soft_strict_paths`, for at most S slots; an agent's entries lie end to end.

    Attributes
    ----------
    ahead : (T, S) float64
        Weight of all ways that end on a slot, among all ways up to that step.
    scale : (T, 2) float64
        What a step's weights were multiplied by: those of plain tasks, and those of entries.
    enter : (T,) float64
        Log weight of all ways before a step that pay for a move there. Where `SoftWaiting.linear`, their weight among
        all ways up to the step before the present one, times `best` from there to the present step.
    leave : (T + 1,) float64
        Log weight of what follows a step after a move, less `level` of that step. Where `SoftWaiting.linear`, at b the
        weight of what follows a move at b, scaled like `behind`, times `best` from the present step to b.
    level : (T,) float64
        Log weight of all ways up to a step.
    behind : (S,) float64
        Weight of what follows, scaled so that the products of `ahead` and `behind` and what waits add up to 1.
    gain : (most entries,) float64
        Weight of an entry's benefit less price, relative to the best of its step.
    """

    ahead: FloatArray
    scale: FloatArray
    enter: FloatArray
    leave: FloatArray
    level: FloatArray
    behind: FloatArray
    gain: FloatArray


def strict_soft_scratch(T: int, slots: int, entries: int) -> tuple[StrictSoftScratch]:
    """Work arrays of one thread."""
    return (
        StrictSoftScratch(
            work_array((T, slots)), work_array((T, 2)), work_array(T), work_array(T + 1), work_array(T),
            work_array(slots), work_array(entries),
        ),
    )  # fmt: skip


@njit(cache=True, borrows=True, nogil=True)
def soft_strict_paths(
    begin, end, window, slots, smoothing, waiting, log_z, scratch, usage, mass
):  # fmt: skip
    """Smoothed values of the agents of a block: fills `log_z` (n,), adds to `usage` (T, m) and `mass` (T, T + 1).

    `mass` gets the expected numbers of agents that wait over intervals of steps, `usage` those that hold one of their
    slots.
    """
    log_move = np.log(smoothing.move)
    for i in range(begin, end):
        tasks = slots.task[slots.ptr[i] : slots.ptr[i + 1]]
        before = np.int64(
            -1
        )  # slot held before the first step; a plain -1 would be a type of its own to the compiler
        if window.held[i] >= 0:
            for s in range(tasks.size):
                if tasks[s] == window.held[i]:
                    before = np.int64(s)
        # At the first step a move is free if nothing was held.
        first = smoothing.move if before >= 0 else 1.0
        log_first = log_move if before >= 0 else 0.0
        log_z[i] = _ahead(
            i, window, slots.entry, tasks, smoothing, before, first, log_first, waiting, scratch
        )
        if log_z[i] > -np.inf:
            _behind(
                i, window, slots.entry, tasks, smoothing, first, log_first, waiting, scratch, usage, mass
            )  # fmt: skip


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _ahead(i, window, entry, tasks, smoothing, before, first, log_first, waiting, scratch):
    """Forward recursion of one agent: fills `scratch`, returns log Z.

        ahead_k[s] = (ahead_{k-1}[s] + move) * weight_k[s]    (or the gain of an entry in place of the weight)

    divided by the step's total, in which the ways that wait since step a count as the weight of those that began then
    times that of the interval a .. k. The sum of ``ahead_{k-1}`` is 1, less what waits, so the ways that move to slot s
    together weigh `move`.
    """
    n, indptr, data = window.n, window.indptr, window.data
    eps, move, prices, weight = smoothing.temperature, smoothing.move, smoothing.prices, smoothing.weight
    ahead, scale, gain = scratch.ahead, scratch.scale, scratch.gain
    enter, level = scratch.enter, scratch.level
    T = weight.shape[0]
    size = tasks.size
    log_move = np.log(move)
    # Waiting of a weight below that of a move times the rest is never kept: moving there later is better.
    floor = _TINY + min(0.0, log_move)
    log_z = 0.0
    g = 0  # place of the step's first entry
    for k in range(T):
        row = weight[k]
        here = ahead[k]
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        # All weights of the step are taken relative to the best net benefit in sight, so none overflows.
        top = 0.0
        for e in range(lo, hi):
            top = max(top, data[e] - prices[k, tasks[entry[e]]])
        shift = np.exp(-top / eps)
        for e in range(lo, hi):
            gain[g + e - lo] = np.exp((data[e] - prices[k, tasks[entry[e]]] - top) / eps)
        if k == 0:
            for s in range(size):
                here[s] = first * row[tasks[s]] * shift
            if before >= 0:
                here[before] = (1.0 + first) * row[tasks[before]] * shift
            for e in range(lo, hi):
                s = entry[e]
                here[s] = gain[g + e - lo] * (first + (1.0 if s == before else 0.0))
        else:
            prev = ahead[k - 1]
            for s in range(size):
                here[s] = (prev[s] + move) * (row[tasks[s]] * shift)
            for e in range(lo, hi):
                s = entry[e]
                here[s] = (prev[s] + move) * gain[g + e - lo]
        total = 0.0
        for s in range(size):
            total += here[s]
        column = waiting.by_end[k + 1 if waiting.shared else 0]
        if waiting.shared and waiting.linear:
            if k > 0:
                factor = scale[k - 1, 0] * waiting.best[k]
                for a in range(k):
                    x = enter[a] * factor
                    enter[a] = x if x > _NOTHING else 0.0
            enter[k] = (first if k == 0 else move) * waiting.best[k]
            waits = 0.0
            for a in range(k + 1):
                waits += enter[a] * column[a]
            total += waits * shift
        elif waiting.shared:
            enter[k] = (log_first if k == 0 else log_move) + log_z
            above = log_z + top / eps
            for a in range(k + 1):
                x = enter[a] + column[a] - above
                if x > floor:
                    total += np.exp(x)
        if not total > 0.0:
            return -np.inf
        inverse = 1.0 / total
        for s in range(size):
            here[s] *= inverse
        scale[k, 0] = shift * inverse
        scale[k, 1] = inverse
        log_z += np.log(total) + top / eps
        level[k] = log_z
        g += hi - lo
    return log_z


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _behind(
    i, window, entry, tasks, smoothing, first, log_first, waiting, scratch, usage, mass
):  # fmt: skip
    """Backward recursion of one agent: adds to `usage` and `mass`.

    `behind` is scaled so that ``sum_s ahead_k[s] behind_k[s]`` and what waits add up to 1 at every step; the products
    are the probabilities of the slots. With `back` = move * (sum of the weighted `behind` and of what waits):

        behind_{k-1}[s] = weight_k[s] behind_k[s] + back
    """
    n, indptr = window.n, window.indptr
    move, weight = smoothing.move, smoothing.weight
    ahead, scale, leave, level = scratch.ahead, scratch.scale, scratch.leave, scratch.level
    behind, gain = scratch.behind, scratch.gain
    T = weight.shape[0]
    size = tasks.size
    log_move = np.log(move)
    g = 0
    for k in range(T):
        g += indptr[k * n + i + 1] - indptr[k * n + i]
    for s in range(size):
        behind[s] = 1.0
    back = 1.0
    if not waiting.linear:
        leave[T - 1] = -level[T - 1]
    for k in range(T - 1, -1, -1):
        here = ahead[k]
        row_usage = usage[k]
        row = weight[k]
        base, inverse = scale[k, 0], scale[k, 1]
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        g -= hi - lo
        # Slots with an entry first: they are set to zero, so that the loop over all slots adds nothing for them.
        for e in range(lo, hi):
            s = entry[e]
            v = behind[s]
            row_usage[tasks[s]] += here[s] * v
            gain[g + e - lo] *= v * inverse
            behind[s] = 0.0
        total = 0.0
        for s in range(size):
            v = behind[s]
            j = tasks[s]
            row_usage[j] += here[s] * v
            v *= row[j] * base
            behind[s] = v
            total += v
        for e in range(lo, hi):
            v = gain[g + e - lo]
            behind[entry[e]] = v
            total += v
        if waiting.shared:
            row_waiting, row_mass = waiting.table[k], mass[k]
            factor = move if k > 0 else first
            if waiting.linear:
                onward = base * waiting.best[k]
                for b in range(k + 2, T + 1):
                    x = leave[b] * onward
                    leave[b] = x if x > _NOTHING else 0.0
                leave[k + 1] = back * onward
                waits = 0.0
                for b in range(k + 1, T + 1):
                    v = leave[b] * row_waiting[b]
                    waits += v
                    row_mass[b] += v * factor
                total += waits
            else:
                log_factor = log_move if k > 0 else log_first
                above = level[k - 1] if k > 0 else 0.0
                for b in range(k + 1, T + 1):
                    x = leave[b - 1] + row_waiting[b] + above
                    if x + log_factor > _TINY:
                        v = np.exp(x)
                        total += v
                        row_mass[b] += v * factor
        if k > 0:
            back = move * total
            if not waiting.linear:
                leave[k - 1] = np.log(back) - level[k - 1]
            for s in range(size):
                behind[s] += back
