"""Log-sum-exp smoothing when only a move into a positive benefit pays; see `soft_strict` for the idea.

A task without an entry at step k can be entered for nothing, so its weight is that of everything before step k times
weight_k[j], and the recursion runs over the stored entries. All such tasks together weigh the sum of their weights; it
is summed explicitly over the cheapest tasks, where cancellation would hurt.

Forward all weights are logarithms, backward all numbers are probabilities: at low temperatures the weights of states
that matter differ by more than floats can, and so any temperature will do.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.blocks import work_array
from sapopt.kernels.jit import njit

_FAST = {"nnan", "nsz", "reassoc", "contract"}
_SWAMPED = 100.0  # occupancy that is added and taken off again; beyond it the tasks are visited one by one
_NEVER = -1e300  # logarithm of nothing
_NOTHING = 40.0  # a term whose logarithm is so much smaller than that of another is left out
_UNFELT = 1e-12  # agents that are not looked for any more
_VANISHED = 1e-200  # a sum of weights below which all tasks are gone through by their logarithms


class IdleSoftScratch(NamedTuple):
    """Work arrays of `soft_idle_free_paths`; an agent's entries lie end to end, step by step.

    Attributes
    ----------
    level : (most entries,) float64
        Log weight of all ways that end with an entry, among all ways up to that step.
    ahead : (most entries,) float64
        Its exponential.
    stayed : (most entries,) float64
        Share of these ways that came from the same task.
    behind : (most entries,) float64
        Probability of the ways that stay from an entry into the next step.
    match : (most entries,) int64
        Entry of the same task one step before, -1 for none.
    mark : (m,) int64
        Row (T * n of them) that saw a task last, or -2 - row in the second half; -1 at first.
    others : (T,) float64
        Sum of the weights of the tasks without an entry.
    share : (T,) float64
        Their share among all ways up to a step.
    total : (T,) float64
        Log weight of all ways up to a step, less that up to the step before.
    """

    level: FloatArray
    ahead: FloatArray
    stayed: FloatArray
    behind: FloatArray
    match: IntArray
    mark: IntArray
    others: FloatArray
    share: FloatArray
    total: FloatArray


def idle_soft_scratch(T: int, m: int, entries: int) -> tuple[IdleSoftScratch]:
    """Work arrays of one thread."""
    return (
        IdleSoftScratch(
            work_array(entries), work_array(entries), work_array(entries), work_array(entries),
            work_array(entries, np.int64), work_array(m, np.int64, -1), work_array(T), work_array(T), work_array(T),
        ),
    )  # fmt: skip


@njit(cache=True, borrows=True, nogil=True)
def soft_idle_free_paths(begin, end, window, smoothing, cheapest, log_z, scratch, usage, unlisted):
    """Smoothed values of the agents of a block: fills `log_z` (n,), adds to `usage` (T, m) and `unlisted` (T,).

    The expected use of the tasks is ``usage[k, j] + unlisted[k] * weight[k, j]``: what the tasks without an entry get
    is added to all tasks at once, and was taken off those with one. Prices count from the cheapest task of a step.
    """
    for i in range(begin, end):
        log_z[i] = _ahead(i, window, smoothing, cheapest, scratch)
        if log_z[i] > -np.inf:
            _behind(i, window, smoothing, scratch, usage, unlisted)


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _ahead(i, window, smoothing, cheapest, scratch):
    """Forward recursion of one agent: fills `scratch`, returns log Z.

        level_k[e] = (benefit - price) / eps + log(exp(level_{k-1}[entry of the same task]) + move if the benefit is
                     positive, else 1)

    less the log of the step's total, `others` among it. Where there was no entry of the task one step before, the
    agent stood on it without one: weight_{k-1}[j] over the total of that step.
    """
    n, indptr, indices, data = window.n, window.indptr, window.indices, window.data
    prices, weight = smoothing.prices, smoothing.weight
    level, ahead, stayed, match, mark = (
        scratch.level, scratch.ahead, scratch.stayed, scratch.match, scratch.mark,
    )  # fmt: skip
    T = weight.shape[0]
    count = cheapest.tasks.shape[1]
    colder = 1.0 / smoothing.temperature
    log_move = -window.cost * colder
    held = window.held[i]
    log_z = 0.0
    g = 0
    before = 0  # where the previous step's entries begin
    for k in range(T):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        unseen = cheapest.rest[k]
        for e in range(lo, hi):
            j = indices[e]
            mark[j] = r
            if cheapest.rank[k, j] >= count:
                unseen -= weight[k, j]
        unseen = max(unseen, 0.0)
        for c in range(count):
            j = cheapest.tasks[k, c]
            if mark[j] != r:
                unseen += weight[k, j]
        scratch.others[k] = unseen
        unseen_level = np.log(unseen) if unseen > _VANISHED else _dear(mark, r, prices[k], colder)
        top = unseen_level
        p = indptr[r - n] if k > 0 else 0
        prev_lo = p
        prev_hi = indptr[r - n + 1] if k > 0 else 0
        for e in range(lo, hi):
            j = indices[e]
            x = g + e - lo
            match[x] = -1
            enter = log_move if data[e] > 0.0 else 0.0
            if k == 0:
                stay = 0.0 if j == held else _NEVER
                if held < 0:
                    enter = 0.0
            else:
                while p < prev_hi and indices[p] < j:
                    p += 1
                if p < prev_hi and indices[p] == j:
                    match[x] = before + p - prev_lo
                    stay = level[match[x]]
                else:
                    stay = -prices[k - 1, j] * colder - scratch.total[k - 1]
            lead = stay - enter
            if lead > _NOTHING:
                stayed[x], came = 1.0, stay
            elif lead < -_NOTHING:
                stayed[x], came = 0.0, enter
            else:
                odds = np.exp(lead)
                stayed[x], came = odds / (1.0 + odds), enter + np.log(1.0 + odds)
            level[x] = (data[e] - prices[k, j]) * colder + came
            top = max(top, level[x])
        if not top > _NEVER:
            return -np.inf
        share = np.exp(unseen_level - top)
        total = share
        for x in range(g, g + hi - lo):
            ahead[x] = np.exp(level[x] - top)
            total += ahead[x]
        inverse, log_total = 1.0 / total, top + np.log(total)
        for x in range(g, g + hi - lo):
            ahead[x] *= inverse
            level[x] -= log_total
        scratch.share[k] = share * inverse
        scratch.total[k] = log_total
        log_z += log_total
        before = g
        g += hi - lo
    return log_z


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _dear(mark, r, prices, colder):
    """Log weight of the tasks that are not marked by r, where each is far dearer than the cheapest of all."""
    least = np.inf
    for j in range(prices.size):
        if mark[j] != r:
            least = min(least, prices[j])
    if least == np.inf:
        return _NEVER
    total = 0.0
    for j in range(prices.size):
        if mark[j] != r:
            total += np.exp((least - prices[j]) * colder)
    return np.log(total) - least * colder


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _behind(i, window, smoothing, scratch, usage, unlisted):
    """Backward recursion of one agent: adds to `usage` and `unlisted`.

    Of the ways that hold an entry at step k the share `stayed` came from the same task, the others from anywhere, as
    likely from one state as it weighs. With `anywhere`, the probability of these at step k:

        probability_k[e] = anywhere ahead_k[e] + behind_k[e],    behind_{k-1}[entry of the same task] = stayed
        probability_k[e]
    """
    n, indptr, indices = window.n, window.indptr, window.indices
    weight, prices, colder = smoothing.weight, smoothing.prices, 1.0 / smoothing.temperature
    ahead, stayed, behind, match = scratch.ahead, scratch.stayed, scratch.behind, scratch.match
    mark = scratch.mark
    T, m = weight.shape
    g = 0
    for k in range(T):
        g += indptr[k * n + i + 1] - indptr[k * n + i]
    for x in range(g - (indptr[(T - 1) * n + i + 1] - indptr[(T - 1) * n + i]), g):
        behind[x] = 0.0
    anywhere = 1.0
    waits = 0.0  # on tasks that the agent has an entry for at the next step
    for k in range(T - 1, -1, -1):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        first = g - (hi - lo)
        # Occupancy of the tasks without entry: weight times a factor, added to all tasks at the end and here taken off
        # those with an entry. Where these would swamp it (their weight is far larger), it is spread one by one.
        unseen = anywhere * scratch.share[k]
        vanished = scratch.others[k] <= _VANISHED
        factor = unseen / scratch.others[k] if unseen > _UNFELT and not vanished else 0.0
        largest = 0.0
        for e in range(lo, hi):
            largest = max(largest, weight[k, indices[e]])
        if unseen > _UNFELT and (vanished or factor * largest > _SWAMPED):
            for e in range(lo, hi):
                mark[indices[e]] = -2 - r
            for j in range(m):
                if mark[j] != -2 - r:
                    usage[k, j] += anywhere * np.exp(-prices[k, j] * colder - scratch.total[k])
            factor = 0.0
        unlisted[k] += factor
        if k > 0:
            for x in range(first - (indptr[r - n + 1] - indptr[r - n]), first):
                behind[x] = 0.0
        moved = unseen + waits
        waits = 0.0
        for e in range(lo, hi):
            x = first + e - lo
            j = indices[e]
            likely = anywhere * ahead[x] + behind[x]
            usage[k, j] += likely - factor * weight[k, j]
            stays = likely * stayed[x]
            moved += likely - stays
            if k > 0 and match[x] >= 0:
                behind[match[x]] = stays
            elif k > 0:
                usage[k - 1, j] += stays
                waits += stays
        anywhere = moved
        g = first
