"""Log-sum-exp smoothing when only a move into a positive benefit pays; see `soft_strict` for the idea.

A task without an entry at step k can be entered for nothing, so its weight is that of everything before step k times
weight_k[j], and the recursion runs over the stored entries. All such tasks together weigh the sum of their weights; it
is summed explicitly over the cheapest tasks, where cancellation would hurt.
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


class IdleSoftScratch(NamedTuple):
    """Work arrays of `soft_idle_free_paths`; an agent's entries lie end to end, step by step.

    Attributes
    ----------
    ahead : (most entries,) float64
        Weight of all ways that end with an entry, among all ways up to that step.
    gain : (most entries,) float64
        Weight of an entry's benefit less price, relative to the best of its step; backward: that of staying into the
        entry, times what follows.
    match : (most entries,) int64
        Entry of the same task one step before, -1 for none.
    behind : (most entries,) float64
        Weight of what follows an entry, scaled as `ahead` is.
    mark : (m,) int64
        Row (T * n of them) that saw a task last, or -2 - row in the second half; -1 at first.
    others : (T,) float64
        Sum of the weights of the tasks without an entry.
    base, inverse : (T,) float64
        What the weights of a step were multiplied by: those of plain tasks, and those of entries.
    """

    ahead: FloatArray
    gain: FloatArray
    match: IntArray
    behind: FloatArray
    mark: IntArray
    others: FloatArray
    base: FloatArray
    inverse: FloatArray


def idle_soft_scratch(T: int, m: int, entries: int) -> tuple[IdleSoftScratch]:
    """Work arrays of one thread."""
    return (
        IdleSoftScratch(
            work_array(entries), work_array(entries), work_array(entries, np.int64), work_array(entries),
            work_array(m, np.int64, -1), work_array(T), work_array(T), work_array(T),
        ),
    )  # fmt: skip


@njit(cache=True, borrows=True, nogil=True)
def soft_idle_free_paths(begin, end, window, smoothing, cheapest, log_z, scratch, usage, unlisted):
    """Smoothed values of the agents of a block: fills `log_z` (n,), adds to `usage` (T, m) and `unlisted` (T,).

    The expected use of the tasks is ``usage[k, j] + unlisted[k] * weight[k, j]``: what the tasks without an entry get
    is added to all tasks at once, and was taken off those with one.
    """
    for i in range(begin, end):
        log_z[i] = _ahead(i, window, smoothing, cheapest, scratch)
        if log_z[i] > -np.inf:
            _behind(i, window, smoothing, scratch, usage, unlisted)


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _ahead(i, window, smoothing, cheapest, scratch):
    """Forward recursion of one agent: fills `scratch`, returns log Z.

        ahead_k[e] = gain_k[e] * (ahead_{k-1}[entry of the same task] + (move if the benefit is positive, else 1))

    divided by the step's total, `others` among it. Where there was no entry of the task one step before, the agent
    stood on it without one: weight_{k-1}[j] * base_{k-1}.
    """
    n, indptr, indices, data = window.n, window.indptr, window.indices, window.data
    eps, move, prices, weight = smoothing.temperature, smoothing.move, smoothing.prices, smoothing.weight
    ahead, gain, match, mark = scratch.ahead, scratch.gain, scratch.match, scratch.mark
    others, base, inverse = scratch.others, scratch.base, scratch.inverse
    T = weight.shape[0]
    count = cheapest.tasks.shape[1]
    held = window.held[i]
    log_z = 0.0
    g = 0
    before = 0  # where the previous step's entries begin
    for k in range(T):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        top = 0.0
        unseen = cheapest.rest[k]
        for e in range(lo, hi):
            j = indices[e]
            top = max(top, data[e] - prices[k, j])
            mark[j] = r
            if cheapest.rank[k, j] >= count:
                unseen -= weight[k, j]
        unseen = max(unseen, 0.0)
        for c in range(count):
            j = cheapest.tasks[k, c]
            if mark[j] != r:
                unseen += weight[k, j]
        others[k] = unseen
        shift = np.exp(-top / eps)
        total = unseen * shift
        p = indptr[r - n] if k > 0 else 0
        prev_lo = p
        prev_hi = indptr[r - n + 1] if k > 0 else 0
        for e in range(lo, hi):
            j = indices[e]
            x = g + e - lo
            match[x] = -1
            enter = move if data[e] > 0.0 else 1.0
            if k == 0:
                stay = 1.0 if j == held else 0.0
                if held < 0:
                    enter = 1.0
            else:
                while p < prev_hi and indices[p] < j:
                    p += 1
                if p < prev_hi and indices[p] == j:
                    match[x] = before + p - prev_lo
                    stay = ahead[match[x]]
                else:
                    stay = weight[k - 1, j] * base[k - 1]
            gain[x] = np.exp((data[e] - prices[k, j] - top) / eps)
            ahead[x] = gain[x] * (stay + enter)
            total += ahead[x]
        if not total > 0.0:
            return -np.inf
        inverse[k] = 1.0 / total
        base[k] = shift / total
        for x in range(g, g + hi - lo):
            ahead[x] *= inverse[k]
        log_z += np.log(total) + top / eps
        before = g
        g += hi - lo
    return log_z


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _behind(i, window, smoothing, scratch, usage, unlisted):
    """Backward recursion of one agent: adds to `usage` and `unlisted`.

    With `total`, the weight of all that may follow step k - 1 after a move at step k:

        behind_{k-1}[e] = total + gain_k[entry of the same task] behind_k[that entry]
    """
    n, indptr, indices, data = window.n, window.indptr, window.indices, window.data
    move, weight = smoothing.move, smoothing.weight
    ahead, gain, match, behind = scratch.ahead, scratch.gain, scratch.match, scratch.behind
    mark, others, base, inverse = scratch.mark, scratch.others, scratch.base, scratch.inverse
    T, m = weight.shape
    g = 0
    for k in range(T):
        g += indptr[k * n + i + 1] - indptr[k * n + i]
    for x in range(g - (indptr[(T - 1) * n + i + 1] - indptr[(T - 1) * n + i]), g):
        behind[x] = 1.0
    follow = 1.0  # weight of what follows a task without an entry
    later_lo, later_hi, later_row = g, g, 0
    for k in range(T - 1, -1, -1):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        first = g - (hi - lo)
        # Occupancy of the tasks without entry: weight times a factor, added to all tasks at the end and here taken off
        # those with an entry. Where these would swamp it (their weight is far larger), it is spread one by one.
        factor = base[k] * follow
        if factor * others[k] < 1e-12:
            factor = 0.0
        largest = 0.0
        for e in range(lo, hi):
            largest = max(largest, weight[k, indices[e]])
        if factor * largest > _SWAMPED:
            for e in range(lo, hi):
                mark[indices[e]] = -2 - r
            for j in range(m):
                if mark[j] != -2 - r:
                    usage[k, j] += factor * weight[k, j]
            factor = 0.0
        unlisted[k] += factor
        into_free = follow * others[k]
        for x in range(later_lo, later_hi):
            if match[x] < 0:  # waits at step k on a task that it has an entry for at step k + 1
                j = indices[later_row + x - later_lo]
                v = weight[k, j] * gain[x]
                usage[k, j] += base[k] * v
                into_free += v
        total = base[k] * into_free
        for e in range(lo, hi):
            x = first + e - lo
            j = indices[e]
            usage[k, j] += ahead[x] * behind[x] - factor * weight[k, j]
            gain[x] *= inverse[k] * behind[x]
            total += gain[x] * (move if data[e] > 0.0 else 1.0)
        if k > 0:
            for x in range(first - (indptr[r - n + 1] - indptr[r - n]), first):
                behind[x] = total
            for x in range(first, g):
                if match[x] >= 0:
                    behind[match[x]] += gain[x]
        later_lo, later_hi, later_row = first, g, lo
        follow = total
        g = first
