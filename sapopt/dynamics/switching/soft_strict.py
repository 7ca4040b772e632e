"""Soft longest paths under the strict switching cost: log-sum-exp in place of max.

With temperature eps the value of an agent becomes ``eps log sum_paths exp(value(path) / eps)``, a smooth convex upper
bound of its longest path whose gradient is the occupancy of (step, task) under the Gibbs distribution of paths. In the
linear domain the recursion of `switching_paths_kernels` turns into multiplications and additions, with
q = exp(-cost / eps), w = exp(-price / eps), g = exp(benefit / eps):

    forward   A_k[j] = w g (A_{k-1}[j] + q sum A_{k-1})
    backward  B_k[j] = (w g B)_{k+1}[j] + R_k,   R_k = q sum_j (w g B)_{k+1}[j]

Every step is rescaled, so only ratios within one step matter; what underflows there is worse than moving away by far
more than the cost of a move. Parking on tasks the agent never sees runs over shared intervals, as in the hard
recursion: ``S[b, a] = sum_j exp(-sum_{a <= k < b} price_k[j] / eps)``.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

_FAST = {"nnan", "nsz", "reassoc", "contract"}


# Terms below exp(_TINY) of their sum are left out.
_TINY = -30.0


@njit(cache=True, parallel=True, fastmath=_FAST)
def soft_parking(w, excluded):
    """log S (T+1, T): S[b, a] = sum over tasks not excluded of the product of w (T, m) over the steps a..b-1."""
    T, m = w.shape
    log_S = np.full((T + 1, T), -1e300)
    for a in prange(T):
        acc = np.empty(m)
        for j in range(m):
            acc[j] = 0.0 if excluded[j] else 1.0
        level = 0.0
        factor = 1.0
        for b in range(a + 1, T + 1):
            row = w[b - 1]
            total = 0.0
            for j in range(m):
                v = acc[j] * row[j] * factor
                acc[j] = v
                total += v
            if not total > 0.0:
                break
            log_S[b, a] = level + np.log(total)
            factor = 1.0
            if total < 1e-100:  # rescale before anything that matters underflows
                factor = 1.0 / total
                level += np.log(total)
    return log_S


@njit(cache=True, parallel=True, fastmath=_FAST)
def spread_parking(prices, eps, excluded, log_S, mass):
    """Occupancy (T, m) of the parked agents: interval masses `mass` (T+1, T) spread over the tasks by their weight."""
    T, m = prices.shape
    occupancy = np.zeros((m, T))
    last = np.zeros(T, np.int64)
    for a in range(T):
        for b in range(a + 1, T + 1):
            if mass[b, a] > 1e-6:
                last[a] = b
    for j in prange(m):
        if excluded[j]:
            continue
        column = prices[:, j].copy()
        held = np.empty(T + 1)
        for a in range(T):
            paid = 0.0
            for b in range(a + 1, last[a] + 1):
                paid += column[b - 1]
                held[b] = 0.0
                if mass[b, a] > 1e-6:
                    x = -paid / eps - log_S[b, a]
                    if x > _TINY:
                        held[b] = np.exp(x) * mass[b, a]
            total = 0.0
            for k in range(last[a] - 1, a - 1, -1):
                total += held[k + 1]
                occupancy[j, k] += total
    return occupancy.T.copy()


@njit(cache=True, fastmath=_FAST)
def _soft_strict(
    agent, n, indptr, entry_slot, data, slots, q, eps, start, prices, w, park, log_S,
    A, scale, enter, leave, level_after, B, gain, usage, mass,
):  # fmt: skip
    """One agent: adds its occupancy to `usage` and its parking intervals to `mass`; returns log Z."""
    T = w.shape[0]
    size = slots.size
    log_z = 0.0
    before = -1
    if start >= 0:
        for s in range(size):
            if slots[s] == start:
                before = s
    first = q if before >= 0 else 1.0
    log_q = np.log(q)
    log_first = np.log(first)
    # A place of weight below q times the rest is never kept: moving there later is better.
    floor = _TINY + min(0.0, log_q)
    g = 0
    for k in range(T):
        row = w[k]
        here = A[k]
        r = k * n + agent
        lo, hi = indptr[r], indptr[r + 1]
        # All weights of the step are taken relative to the best net benefit in sight, so none overflows.
        top = 0.0
        for e in range(lo, hi):
            top = max(top, data[e] - prices[k, slots[entry_slot[e]]])
        shift = np.exp(-top / eps)
        for e in range(lo, hi):
            gain[g + e - lo] = np.exp((data[e] - prices[k, slots[entry_slot[e]]] - top) / eps)
        if k == 0:
            for s in range(size):
                here[s] = first * row[slots[s]] * shift
            if before >= 0:
                here[before] = (1.0 + first) * row[slots[before]] * shift
            for e in range(lo, hi):
                s = entry_slot[e]
                here[s] = gain[g + e - lo] * (first + (1.0 if s == before else 0.0))
        else:
            prev = A[k - 1]
            for s in range(size):
                here[s] = (prev[s] + q) * (row[slots[s]] * shift)
            for e in range(lo, hi):
                s = entry_slot[e]
                here[s] = (prev[s] + q) * gain[g + e - lo]
        total = 0.0
        for s in range(size):
            total += here[s]
        if park:
            enter[k] = (log_first if k == 0 else log_q) + log_z
            column = log_S[k + 1]
            level = log_z + top / eps
            for a in range(k + 1):
                x = enter[a] + column[a] - level
                if x > floor:
                    total += np.exp(x)
        if not total > 0.0:
            return -np.inf
        inverse = 1.0 / total
        for s in range(size):
            here[s] *= inverse
        base = shift * inverse
        scale[k, 0] = base
        scale[k, 1] = inverse
        log_z += np.log(total) + top / eps
        level_after[k] = log_z
        g += hi - lo
    # Backward, with B scaled so that sum_j A_k[j] B_k[j] + parked = 1 at every step.
    for s in range(size):
        B[s] = 1.0
    leave[T - 1] = -log_z  # log of the weight of what follows step k after a move, less log_z of step k
    for k in range(T - 1, -1, -1):
        here = A[k]
        row_usage = usage[k]
        row = w[k]
        base, inverse = scale[k, 0], scale[k, 1]
        r = k * n + agent
        lo, hi = indptr[r], indptr[r + 1]
        g -= hi - lo
        for e in range(lo, hi):
            s = entry_slot[e]
            v = B[s]
            row_usage[slots[s]] += here[s] * v
            gain[g + e - lo] *= v * inverse
            B[s] = 0.0
        total = 0.0
        for s in range(size):
            v = B[s]
            j = slots[s]
            row_usage[j] += here[s] * v
            v *= row[j] * base
            B[s] = v
            total += v
        for e in range(lo, hi):
            v = gain[g + e - lo]
            B[entry_slot[e]] = v
            total += v
        if park:
            factor = q if k > 0 else first
            level = level_after[k - 1] if k > 0 else 0.0
            for b in range(k + 1, T + 1):
                x = leave[b - 1] + log_S[b, k] + level
                if x + (log_q if k > 0 else log_first) > _TINY:
                    v = np.exp(x)
                    total += v
                    mass[b, k] += v * factor
        if k > 0:
            back = q * total
            leave[k - 1] = np.log(back) - level_after[k - 1]
            for s in range(size):
                B[s] += back
    return log_z


@njit(cache=True, parallel=True)
def soft_strict_paths(
    indptr, entry_slot, data, slot_ptr, slot_task, cost, eps, start, prices, w, park, log_S, chunks
):
    """All agents. Returns (log Z (n,), usage (T, m) of the slots, parking masses (T+1, T))."""
    T, m = w.shape
    n = slot_ptr.size - 1
    q = np.exp(-cost / eps)
    log_z = np.empty(n)
    size = 1
    for i in range(n):
        size = max(size, slot_ptr[i + 1] - slot_ptr[i])
    widest = 1
    for i in range(n):
        count = 0
        for k in range(T):
            count += indptr[k * n + i + 1] - indptr[k * n + i]
        widest = max(widest, count)
    usages = np.zeros((chunks, T, m))
    masses = np.zeros((chunks, T + 1, T))
    for c in prange(chunks):
        A = np.empty((T, size))
        scale = np.empty((T, 2))
        enter = np.empty(T)
        leave = np.empty(T)
        level_after = np.empty(T)
        B = np.empty(size)
        gain = np.empty(widest)
        for i in range(c, n, chunks):
            slots = slot_task[slot_ptr[i] : slot_ptr[i + 1]]
            log_z[i] = _soft_strict(
                i, n, indptr, entry_slot, data, slots, q, eps, start[i], prices, w, park, log_S,
                A, scale, enter, leave, level_after, B, gain, usages[c], masses[c],
            )  # fmt: skip
    return log_z, usages.sum(axis=0), masses.sum(axis=0)
