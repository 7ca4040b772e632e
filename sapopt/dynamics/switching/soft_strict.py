"""Log-sum-exp smoothing of the longest paths under the strict switching cost.

With temperature eps the value of an agent becomes ``eps log sum_paths exp(value(path) / eps)``, a smooth convex upper
bound of its longest path whose gradient is the occupancy of (step, task) under the Gibbs distribution of paths. In the
linear domain the recursion of `sapopt.dynamics.switching.hard` turns into multiplications and additions, with
move = exp(-cost / eps), weight = exp(-price / eps), gain = exp(benefit / eps):

    forward    ahead_k[j] = weight gain (ahead_{k-1}[j] + move sum ahead_{k-1})
    backward   behind_k[j] = (weight gain behind)_{k+1}[j] + move sum_j (weight gain behind)_{k+1}[j]

Every step is rescaled, so only ratios within one step matter; what underflows there is worse than moving away by far
more than the cost of a move. Waiting on tasks that the agent never sees runs over intervals a .. b - 1 that all agents
share, as in the hard recursion, here with the sums over the tasks of the product of their weights: see
`sapopt.dynamics.switching.soft_waits`.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.dynamics.switching.soft_waits import LEAST, soft_waiting, spread_waiting
from sapopt.kernels.blocks import work_array
from sapopt.kernels.jit import njit

_FAST = {"nnan", "nsz", "reassoc", "contract"}

# Terms below exp(_TINY) of their sum are left out, as in `soft_waits`.
_TINY = -30.0

# What is set to zero in time, before it becomes a number that processors are slow with.
_NOTHING = 1e-200


class StrictSoftScratch(NamedTuple):
    """Work arrays of `soft_strict_paths`, for at most S slots; an agent's entries lie end to end.

    Attributes
    ----------
    ahead : (T, S) float64
        Weight of all ways that end on a slot; times ``scale[k, 1]``, their share among all ways up to that step.
    scale : (T, 2) float64
        What a step's weights are to be multiplied by: those of plain tasks, and those of entries.
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

    where ``ahead_{k-1}`` is divided by its step's total, in which the ways that wait since step a count as the weight
    of those that began then times that of the interval a .. k. Its sum is then 1, less what waits, so the ways that
    move to slot s together weigh `move`.
    """
    n, indptr, data = window.n, window.indptr, window.data
    eps, move, prices, weight = smoothing.temperature, smoothing.move, smoothing.prices, smoothing.weight
    ahead, scale, gain = scratch.ahead, scratch.scale, scratch.gain
    enter, level = scratch.enter, scratch.level
    T = weight.shape[0]
    size = tasks.size
    log_move = np.log(move)
    colder = 1.0 / eps
    # Waiting of a weight below that of a move times the rest is never kept: moving there later is better.
    floor = _TINY + min(0.0, log_move)
    log_z = 0.0
    g = 0  # place of the step's first entry
    share = 0.0  # what the previous step's weights are to be multiplied by
    for k in range(T):
        row = weight[k]
        here = ahead[k]
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        # All weights of the step are taken relative to the best net benefit in sight, so none overflows.
        top = 0.0
        for e in range(lo, hi):
            net = data[e] - prices[k, tasks[entry[e]]]
            gain[g + e - lo] = net
            top = max(top, net)
        shift = np.exp(-top * colder)
        if k == 0:
            for s in range(size):
                here[s] = first * row[tasks[s]] * shift
            if before >= 0:
                here[before] = (1.0 + first) * row[tasks[before]] * shift
            for e in range(lo, hi):
                s = entry[e]
                v = np.exp((gain[g + e - lo] - top) * colder)
                gain[g + e - lo] = v
                here[s] = v * (first + (1.0 if s == before else 0.0))
        else:
            prev = ahead[k - 1]
            for s in range(size):
                here[s] = (prev[s] * share + move) * (row[tasks[s]] * shift)
            for e in range(lo, hi):
                s = entry[e]
                v = np.exp((gain[g + e - lo] - top) * colder)
                gain[g + e - lo] = v
                here[s] = (prev[s] * share + move) * v
        total = 0.0
        for s in range(size):
            total += here[s]
        column = waiting.by_end[k + 1 if waiting.shared else 0]
        if waiting.shared and waiting.linear:
            waits = (first if k == 0 else move) * waiting.best[k]
            enter[k] = waits
            waits *= column[k]
            if k > 0:
                factor = scale[k - 1, 0] * waiting.best[k]
                for a in range(k):
                    x = enter[a] * factor
                    x = x if x > _NOTHING else 0.0
                    enter[a] = x
                    waits += x * column[a]
            total += waits * shift
        elif waiting.shared:
            enter[k] = (log_first if k == 0 else log_move) + log_z
            above = log_z + top * colder
            for a in range(k + 1):
                x = enter[a] + column[a] - above
                if x > floor:
                    total += np.exp(x)
        if not total > 0.0:
            return -np.inf
        share = 1.0 / total
        scale[k, 0] = shift * share
        scale[k, 1] = share
        log_z += np.log(total) + top * colder
        level[k] = log_z
        g += hi - lo
    return log_z


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _behind(
    i, window, entry, tasks, smoothing, first, log_first, waiting, scratch, usage, mass
):  # fmt: skip
    """Backward recursion of one agent: adds to `usage` and `mass`.

    `behind` is scaled so that ``sum_s ahead_k[s] behind_k[s]``, with the shares `ahead`, and what waits add up to 1 at
    every step; the products are the probabilities of the slots. With `back` = move * (sum of the weighted `behind` and
    of what waits):

        behind_{k-1}[s] = weight_k[s] behind_k[s] + back

    where `back` is only added as the next step reads what is stored.
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
        behind[s] = 0.0
    back = 1.0
    if not waiting.linear:
        leave[T - 1] = -level[T - 1]
    for k in range(T - 1, -1, -1):
        here = ahead[k]
        row_usage = usage[k]
        row = weight[k]
        base, share = scale[k, 0], scale[k, 1]
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        g -= hi - lo
        # Slots with an entry first: they are set to zero, so that the loop over all slots adds nothing for them.
        for e in range(lo, hi):
            s = entry[e]
            v = (behind[s] + back) * share
            row_usage[tasks[s]] += here[s] * v
            gain[g + e - lo] *= v
            behind[s] = -back
        total = 0.0
        for s in range(size):
            v = behind[s] + back
            j = tasks[s]
            row_usage[j] += here[s] * (v * share)
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
                leave[k + 1] = back
                waits = 0.0
                for b in range(k + 1, T + 1):
                    x = leave[b] * onward
                    x = x if x > _NOTHING else 0.0
                    leave[b] = x
                    x *= row_waiting[b]
                    waits += x
                    row_mass[b] += x * factor
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


class RoundScratch(NamedTuple):
    """Work arrays of `soft_strict_round` beyond those of the agents.

    Attributes
    ----------
    mass : (T, T + 1) float64
        As `soft_strict_paths` fills it; zeros on entry.
    lowest, held : (T,) and (m,) float64
        Of `soft_waiting`.
    ratio, product, onward, crowd : (T, m), (T, m), (m,) and (T + 1,) float64
        Of `spread_waiting`.
    """

    mass: FloatArray
    lowest: FloatArray
    held: FloatArray
    ratio: FloatArray
    product: FloatArray
    onward: FloatArray
    crowd: FloatArray


def round_scratch(T: int, m: int) -> RoundScratch:
    """Work arrays of one call."""
    return RoundScratch(
        np.zeros((T, T + 1)), np.empty(T), np.empty(m), np.empty((T, m)), np.empty((T, m)), np.empty(m), np.empty(T + 1)
    )  # fmt: skip


@njit(cache=True, borrows=True, nogil=True)
def soft_strict_round(window, slots, smoothing, excluded, waiting, scratch, more, log_z, usage):
    """All that `soft_waiting`, `soft_strict_paths` and `spread_waiting` do for one vector of prices, in one call.

    A window of a few steps takes hardly longer than the calls one by one. Fills `log_z` (n,) and the table of `waiting`
    (whose `best` is given), and adds to `usage` (T, m).

    Returns
    -------
    bool
        False, and nothing done, if the weights would leave the range of floats.
    """
    T, m = usage.shape
    none = np.int64(0)
    soft_waiting(none, T, smoothing.weight, waiting.best, excluded, waiting.table, more.lowest, more.held)
    for a in range(T):
        if not more.lowest[a] > LEAST:
            return False
        for b in range(a + 1, T + 1):
            waiting.by_end[b, a] = waiting.table[a, b]
    soft_strict_paths(none, window.n, window, slots, smoothing, waiting, log_z, scratch, usage, more.mass)
    spread_waiting(
        none, m, smoothing.weight, waiting, excluded, more.mass, usage,
        more.ratio, more.product, more.onward, more.crowd,
    )  # fmt: skip
    return True
