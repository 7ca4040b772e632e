"""Log-sum-exp smoothing for agents on batteries: the recursion of `hard` with sums for maxima.

Backwards the logarithms of the weights of what follows are kept for every level by themselves: an agent with a full
battery has gained less so far and will gain more later than an empty one, by far more than a float of one common scale
can hold. Within a level all places differ by no more than the cost of a move, so for the entries it is enough to keep
their ratio ``x = X / N``. Forwards the probabilities of levels and places are carried along the conditional
probabilities that the backward weights give; they need no scale.

With ``move = exp(-cost / eps)``, weight_k[j] = exp(-price_k[j] / eps), U_k the sum of the weights of the tasks without
an entry, and ``g_e = exp((benefit - price) / eps)``, l' the level after work and l'' that after charging:

    N_k[l] = move sum_e X_k[l, e] + U_k N_{k+1}[l''] + (1 - move) sum_e' weight_k[j'] X_{k+1}[l'', e'],
    X_k[l, e] = g_e (N_{k+1}[l'] + (1 - move) X_{k+1}[l', entry of the same task]).

An agent that is ready for entry e gets ``N + (1 - move) X[e]``, so every path counts once.
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


class SoftScratch(NamedTuple):
    """Work arrays of one agent at a time; its entries lie end to end, step by step.

    Attributes
    ----------
    log_paid : (T + 1, levels + 1) float64
        Logarithms of N.
    ratio : (most entries, levels + 1) float64
        X / N for entries of a positive benefit.
    gain : (most entries,) float64
        Weight of benefit less price; for a positive benefit relative to the best of its step, `top`.
    wait : (most entries,) float64
        Weight of standing on the entry's task one step before without working; 0 where that makes nothing ready.
    offset : (T + 1,) int64
        Where the entries of a step begin.
    unlisted : (T,) float64
        U, sum of the weights of the tasks without an entry.
    idle : (T,) float64
        Sum of the weights of all places of an agent that does not work.
    everywhere : (T,) float64
        The same for an agent without charge, which works nowhere.
    top : (T,) float64
        Best benefit less price, at least 0.
    ready : (most entries, levels + 1) float64
        Probability of being ready for an entry, by level; after a level was dealt with, divided by what being ready
        was worth, see `_forward`.
    not_ready, after : (levels + 1,) float64
        Probability of being ready for nothing, before and after the step.
    mark : (m,) int64
        Row that saw a task last, -1 at first.
    """

    log_paid: FloatArray
    ratio: FloatArray
    gain: FloatArray
    wait: FloatArray
    offset: IntArray
    unlisted: FloatArray
    idle: FloatArray
    everywhere: FloatArray
    top: FloatArray
    ready: FloatArray
    not_ready: FloatArray
    after: FloatArray
    mark: IntArray


def make_soft_scratch(T: int, m: int, most: int, capacity: int) -> tuple[SoftScratch]:
    """Work arrays of one thread, for agents of at most `most` entries."""
    levels = capacity + 1
    return (
        SoftScratch(
            work_array((T + 1, levels)), work_array((most, levels)), work_array(most), work_array(most),
            work_array(T + 1, np.int64), work_array(T), work_array(T), work_array(T), work_array(T),
            work_array((most, levels)), work_array(levels), work_array(levels), work_array(m, np.int64, -1),
        ),
    )  # fmt: skip


@njit(cache=True, borrows=True, nogil=True)
def soft_paths(begin, end, rows, rule, before, smoothing, cheapest, log_z, scratch, usage, unlisted):
    """Smoothed values of the agents of a block: fills `log_z` (n,), adds to `usage` (T, m) and `unlisted` (T,).

    The expected use of the tasks is ``usage[k, j] + unlisted[k] * weight[k, j]``, as in
    `sapopt.dynamics.switching.soft_idle`.
    """
    for i in range(begin, end):
        _idle_sums(i, rows, smoothing.weight, cheapest, scratch)
        if _backward(i, rows, rule, smoothing, scratch):
            log_z[i] = _forward(i, rows, rule, before, smoothing, scratch, usage, unlisted)
        else:
            log_z[i] = -np.inf


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _idle_sums(i, rows, weight, cheapest, scratch):
    """Fill `scratch.unlisted`; the cheapest tasks are added one by one, see `cheapest_and_rest`."""
    n, indptr, indices = rows.n, rows.indptr, rows.indices
    mark = scratch.mark
    count = cheapest.tasks.shape[1]
    for k in range(weight.shape[0]):
        r = k * n + i
        total = cheapest.rest[k]
        for e in range(indptr[r], indptr[r + 1]):
            j = indices[e]
            mark[j] = r
            if cheapest.rank[k, j] >= count:
                total -= weight[k, j]
        total = max(total, 0.0)
        for c in range(count):
            j = cheapest.tasks[k, c]
            if mark[j] != r:
                total += weight[k, j]
        scratch.unlisted[k] = total


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _backward(i, rows, rule, smoothing, scratch):
    """Fill `scratch` by the recursion of N and X, see the module; False if an agent with charge has no path.

    For one level l, with l' = worked and l'' = rested, both terms are taken relative to the larger of N_{k+1}[l']
    (times the step's best gain) and N_{k+1}[l'']: ``scale_worked`` and ``scale_rested`` are 1 and less than 1.
    """
    n, indptr, indices, data, follow, back = rows
    cost, drain, charge, capacity, entries, end = rule
    eps, move, prices, weight = smoothing.temperature, smoothing.move, smoothing.prices, smoothing.weight
    log_paid, ratio, offset = scratch.log_paid, scratch.ratio, scratch.offset
    gain, wait, idle = scratch.gain, scratch.wait, scratch.idle
    T = prices.shape[0]
    offset[0] = 0
    for k in range(T):
        offset[k + 1] = offset[k] + indptr[k * n + i + 1] - indptr[k * n + i]
    for level in range(capacity + 1):
        log_paid[T, level] = end[level] / eps
    for k in range(T - 1, -1, -1):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        here = offset[k] - lo  # place of an entry less its number
        top = 0.0
        for e in range(lo, hi):
            if data[e] > 0.0:
                top = max(top, data[e] - prices[k, indices[e]])
        idle[k] = scratch.unlisted[k]
        everywhere = scratch.unlisted[k]
        for e in range(lo, hi):
            j = indices[e]
            at = here + e
            wait[at] = 0.0
            if data[e] > 0.0:
                gain[at] = np.exp((data[e] - prices[k, j] - top) / eps)
                everywhere += weight[k, j]
            else:
                # Nothing to work on: a place like the others, with a benefit of its own.
                gain[at] = np.exp((data[e] - prices[k, j]) / eps)
                idle[k] += gain[at]
                everywhere += gain[at]
            if k > 0 and data[e] > 0.0 and not entries:
                if back[e] < 0:
                    wait[at] = weight[k - 1, j]
                elif not data[back[e]] > 0.0:
                    wait[at] = np.exp((data[back[e]] - prices[k - 1, j]) / eps)
        scratch.everywhere[k] = everywhere
        scratch.top[k] = top
        later = offset[k + 1]
        next_lo = indptr[r + n] if k + 1 < T else 0
        width = offset[k + 2] - later if k + 1 < T else 0
        log_paid[k, 0] = log_paid[k + 1, 0] + np.log(everywhere)
        for e in range(lo, hi):
            ratio[here + e, 0] = 0.0
        for level in range(1, capacity + 1):
            worked, rested = max(level - drain, 0), min(level + charge, capacity)
            log_worked = log_paid[k + 1, worked] + top / eps
            log_rested = log_paid[k + 1, rested]
            high = max(log_worked, log_rested)
            scale_worked = 1.0 if log_worked == high else np.exp(log_worked - high)
            scale_rested = 1.0 if log_rested == high else np.exp(log_rested - high)
            total = 0.0
            for e in range(lo, hi):
                if data[e] > 0.0:
                    v = 1.0
                    if follow[e] >= 0:
                        v += (1.0 - move) * ratio[later + follow[e] - next_lo, worked]
                    ratio[here + e, level] = gain[here + e] * v * scale_worked
                    total += ratio[here + e, level]
            places = idle[k]
            for at in range(later, later + width):
                if wait[at] > 0.0:
                    places += wait[at] * (1.0 - move) * ratio[at, rested]
            total = move * total + scale_rested * places
            if not total > 0.0:
                return False
            inverse = 1.0 / total
            for e in range(lo, hi):
                if data[e] > 0.0:
                    ratio[here + e, level] *= inverse
            log_paid[k, level] = high + np.log(total)
    return True


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST, no_cpython_wrapper=True)
def _forward(i, rows, rule, before, smoothing, scratch, usage, unlisted):
    """Add one agent's expected use of the tasks; returns log Z.

    The state is a level and what the agent is ready for: an entry, or nothing (`not_ready`). At level l before step k
    the weights of what may follow are, relative to N_k[l],

        1                               ready for nothing,
        1 + (1 - move) ratio[e, l]      ready for entry e.

    So every agent may be taken for one that pays for whatever it starts, with the probability `common` = not_ready +
    sum_e ready[e] / (1 + (1 - move) ratio[e, l]); what being ready for e adds is working on e alone. Then

        P(works on e)   = (move common + (1 - move) ready[e] / (1 + (1 - move) ratio[e, l])) ratio[e, l]
        P(rests on j)   = common N_{k+1}[l''] / N_k[l] times the weight of j, and what follows from being there.
    """
    n, indptr, indices, data, follow, back = rows
    cost, drain, charge, capacity, entries, end = rule
    move, weight = smoothing.move, smoothing.weight
    log_paid, ratio, offset = scratch.log_paid, scratch.ratio, scratch.offset
    gain, wait, ready = scratch.gain, scratch.wait, scratch.ready
    not_ready, after = scratch.not_ready, scratch.after
    T, m = weight.shape
    for at in range(offset[T]):
        for level in range(capacity + 1):
            ready[at, level] = 0.0
    for level in range(capacity + 1):
        not_ready[level] = 0.0
    lo, hi = indptr[i], indptr[i + 1]
    first_level = before.levels[i]
    # At the first step an agent may be ready for several entries at once (all of them, if nobody pays): `extra` is
    # what follows relative to N_0, and `common` below starts as its inverse.
    extra = 1.0
    if first_level > 0:
        for e in range(lo, hi):
            if data[e] > 0.0 and (before.free or indices[e] == before.ready[i]):
                extra += (1.0 - move) * ratio[e - lo, first_level]
    log_z = log_paid[0, first_level] + np.log(extra)
    not_ready[first_level] = 1.0
    for k in range(T):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        here = offset[k] - lo
        later = offset[k + 1]
        next_lo = indptr[r + n] if k + 1 < T else 0
        next_hi = indptr[r + n + 1] if k + 1 < T else 0
        for level in range(capacity + 1):
            after[level] = 0.0
        factor = 0.0  # times the weight: the use of a task without an entry
        # Level 0 is dead for good: it stands anywhere.
        dead = not_ready[0]
        for e in range(lo, hi):
            dead += ready[here + e, 0]
        if dead > 0.0:
            after[0] += dead
            dead /= scratch.everywhere[k]
            for e in range(lo, hi):
                j = indices[e]
                usage[k, j] += dead * (weight[k, j] if data[e] > 0.0 else gain[here + e])
            factor += dead
        for level in range(1, capacity + 1):
            common = not_ready[level]
            present = not_ready[level]
            if k == 0:
                common /= extra
            for e in range(lo, hi):
                at = here + e
                if data[e] > 0.0 and ready[at, level] > 0.0:
                    present += ready[at, level]
                    ready[at, level] /= 1.0 + (1.0 - move) * ratio[at, level]
                    common += ready[at, level]
            if not present > 1e-16:
                continue
            worked, rested = max(level - drain, 0), min(level + charge, capacity)
            for e in range(lo, hi):
                if not data[e] > 0.0:
                    continue
                at = here + e
                mass = move * common
                if k == 0:
                    if common > 0.0 and (before.free or indices[e] == before.ready[i]):
                        mass += (1.0 - move) * common
                else:
                    mass += (1.0 - move) * ready[at, level]
                mass *= ratio[at, level]
                usage[k, indices[e]] += mass
                if follow[e] >= 0:
                    ready[later + follow[e] - next_lo, worked] += mass
                else:
                    after[worked] += mass
            rate = common * np.exp(log_paid[k + 1, rested] - log_paid[k, level])
            factor += rate
            spread = scratch.idle[k]  # weight of the places that make ready for nothing
            for e in range(lo, hi):
                if not data[e] > 0.0:
                    usage[k, indices[e]] += rate * gain[here + e]
            # Who stands on a task with work at the next step is ready for it, and the likelier there for that.
            for e in range(next_lo, next_hi):
                at = later + e - next_lo
                if wait[at] > 0.0:
                    mass = rate * wait[at] * (1.0 + (1.0 - move) * ratio[at, rested])
                    ready[at, rested] += mass
                    usage[k, indices[e]] += mass - rate * wait[at]
                    spread -= wait[at]
            after[rested] += rate * max(spread, 0.0)
        # Tasks without an entry: added to all, taken off those with one, where that does not swamp what they have.
        largest = 0.0
        for e in range(lo, hi):
            largest = max(largest, weight[k, indices[e]])
        if factor * largest > _SWAMPED:
            p = lo
            for j in range(m):
                if p < hi and indices[p] == j:
                    p += 1
                else:
                    usage[k, j] += factor * weight[k, j]
        else:
            unlisted[k] += factor
            for e in range(lo, hi):
                usage[k, indices[e]] -= factor * weight[k, indices[e]]
        for level in range(capacity + 1):
            not_ready[level] = after[level]
    return log_z
