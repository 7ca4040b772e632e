"""Soft longest paths of agents on batteries: the recursion of `battery_paths_kernels` with sums for maxima.

Backwards the logarithms of the weights of what follows are kept for every level by themselves: an agent with a full
battery has gained less so far and will gain more later than an empty one, by far more than a float of one common scale
can hold. Within a level all places differ by no more than the cost of a move, so for the entries it is enough to keep
their ratio ``x = X / N``. Forwards the probabilities of levels and places are carried along the conditional
probabilities that the backward weights give; they need no scale.

With ``q = exp(-cost / eps)``, w_k[j] = exp(-price_k[j] / eps), U_k the sum of w over the tasks without an entry, and
``g_e = exp((benefit - price) / eps)``:

    N_k[l] = q sum_e X_k[l, e] + U_k N_{k+1}[l''] + (1 - q) sum_e' w_k[j'] X_{k+1}[l'', e'],
    X_k[l, e] = g_e (N_{k+1}[l'] + (1 - q) X_{k+1}[l', entry of the same task]).

An agent that is ready for entry e gets ``N + (1 - q) X[e]``, so every path counts once.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np
from numba import njit, prange

from sapopt.dynamics.battery.hard import most_entries

_FAST = {"nnan", "nsz", "reassoc", "contract"}
_SWAMPED = 100.0  # occupancy that is added and taken off again; beyond it the tasks are visited one by one


@njit(cache=True)
def _idle_sums(i, n, rows, w, cheapest, tail, rank, mark, U):
    """Sum of w over the tasks without an entry at every step; the cheapest are added one by one, see `tail`."""
    indptr, indices = rows[0], rows[1]
    count = cheapest.shape[1]
    for k in range(w.shape[0]):
        r = k * n + i
        total = tail[k]
        for e in range(indptr[r], indptr[r + 1]):
            j = indices[e]
            mark[j] = r
            if rank[k, j] >= count:
                total -= w[k, j]
        total = max(total, 0.0)
        for c in range(count):
            j = cheapest[k, c]
            if mark[j] != r:
                total += w[k, j]
        U[k] = total


@njit(cache=True, fastmath=_FAST)
def _backward(i, n, rows, battery, eps, prices, w, U, logN, x, gain, wait, idle, D, offset):
    """Fill logN (T+1, levels+1), the ratios x (entries, levels+1), and per entry `gain` (relative to the step's best
    net benefit, which is D[k, 1]) and `wait`, the weight of standing on its task one step before."""
    indptr, indices, data, follow, back = rows
    cost, drain, charge, capacity, entries, end = battery
    T = prices.shape[0]
    q = np.exp(-cost / eps)
    offset[0] = 0
    for k in range(T):
        offset[k + 1] = offset[k] + indptr[k * n + i + 1] - indptr[k * n + i]
    logN[T] = end / eps
    for k in range(T - 1, -1, -1):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        top = 0.0
        for e in range(lo, hi):
            if data[e] > 0.0:
                top = max(top, data[e] - prices[k, indices[e]])
        idle[k] = U[k]
        alive_or_dead = U[k]
        for e in range(lo, hi):
            j = indices[e]
            z = offset[k] + e - lo
            if data[e] > 0.0:
                gain[z] = np.exp((data[e] - prices[k, j] - top) / eps)
                alive_or_dead += w[k, j]
            else:
                gain[z] = np.exp((data[e] - prices[k, j]) / eps)
                idle[k] += gain[z]
                alive_or_dead += gain[z]
            wait[z] = 0.0
            if k > 0 and data[e] > 0.0 and not entries:
                if back[e] < 0:
                    wait[z] = w[k - 1, j]
                elif not data[back[e]] > 0.0:
                    wait[z] = np.exp((data[back[e]] - prices[k - 1, j]) / eps)
        D[k, 0] = alive_or_dead
        D[k, 1] = top
        later = offset[k + 1]
        next_lo = indptr[r + n] if k + 1 < T else 0
        width = offset[k + 2] - later if k + 1 < T else 0
        logN[k, 0] = logN[k + 1, 0] + np.log(alive_or_dead)
        for e in range(lo, hi):
            x[offset[k] + e - lo, 0] = 0.0
        for level in range(1, capacity + 1):
            worked, rested = max(level - drain, 0), min(level + charge, capacity)
            a = logN[k + 1, worked] + top / eps
            b = logN[k + 1, rested]
            high = max(a, b)
            scale_a = 1.0 if a == high else np.exp(a - high)
            scale_b = 1.0 if b == high else np.exp(b - high)
            total = 0.0
            for e in range(lo, hi):
                if data[e] > 0.0:
                    z = offset[k] + e - lo
                    v = 1.0
                    if follow[e] >= 0:
                        v += (1.0 - q) * x[later + follow[e] - next_lo, worked]
                    x[z, level] = gain[z] * v * scale_a
                    total += x[z, level]
            places = idle[k]
            for z in range(later, later + width):
                if wait[z] > 0.0:
                    places += wait[z] * (1.0 - q) * x[z, rested]
            total = q * total + scale_b * places
            if not total > 0.0:
                return False
            inverse = 1.0 / total
            for e in range(lo, hi):
                if data[e] > 0.0:
                    x[offset[k] + e - lo, level] *= inverse
            logN[k, level] = high + np.log(total)
    return True


@njit(cache=True, fastmath=_FAST)
def _forward(
    i, n, rows, battery, eps, w, U, start, logN, x, gain, wait, idle, D, offset, at, usage, free_usage
):
    """Add one agent's expected use of the tasks; returns log Z. `at` holds the probabilities of ready entries."""
    indptr, indices, data, follow, back = rows
    cost, drain, charge, capacity, entries, end = battery
    T, m = w.shape
    q = np.exp(-cost / eps)
    level0, ready, free = start
    none = np.zeros(capacity + 1)
    none_next = np.zeros(capacity + 1)
    for z in range(offset[T]):
        at[z, :] = 0.0
    # log Z, and where the agent starts
    lo, hi = indptr[i], indptr[i + 1]
    log_z = logN[0, level0]
    extra = 1.0
    if level0 > 0:
        for e in range(lo, hi):
            if data[e] > 0.0 and (free or indices[e] == ready):
                extra += (1.0 - q) * x[e - lo, level0]
    log_z += np.log(extra)
    none[level0] = 1.0
    for k in range(T):
        r = k * n + i
        lo, hi = indptr[r], indptr[r + 1]
        later = offset[k + 1]
        next_lo = indptr[r + n] if k + 1 < T else 0
        next_hi = indptr[r + n + 1] if k + 1 < T else 0
        for level in range(capacity + 1):
            none_next[level] = 0.0
        factor = 0.0  # of w, on the tasks without an entry
        dead = none[0]
        for e in range(lo, hi):
            dead += at[offset[k] + e - lo, 0]
        if dead > 0.0:
            dead /= D[k, 0]
            none_next[0] += dead * D[k, 0]
            for e in range(lo, hi):
                j = indices[e]
                usage[k, j] += dead * (w[k, j] if data[e] > 0.0 else gain[offset[k] + e - lo])
            factor += dead
        for level in range(1, capacity + 1):
            # Everyone as if he paid for whatever he starts; what being ready adds is x alone.
            common = none[level]
            present = none[level]
            if k == 0:
                common /= extra
            for e in range(lo, hi):
                z = offset[k] + e - lo
                if data[e] > 0.0 and at[z, level] > 0.0:
                    present += at[z, level]
                    at[z, level] /= 1.0 + (1.0 - q) * x[z, level]
                    common += at[z, level]
            if not present > 1e-16:
                continue
            worked, rested = max(level - drain, 0), min(level + charge, capacity)
            for e in range(lo, hi):
                if not data[e] > 0.0:
                    continue
                z = offset[k] + e - lo
                mass = q * common
                if k == 0:
                    if common > 0.0 and (free or indices[e] == ready):
                        mass += (1.0 - q) * common
                else:
                    mass += (1.0 - q) * at[z, level]
                mass *= x[z, level]
                usage[k, indices[e]] += mass
                if follow[e] >= 0:
                    at[later + follow[e] - next_lo, worked] += mass
                else:
                    none_next[worked] += mass
            rate = common * np.exp(logN[k + 1, rested] - logN[k, level])
            factor += rate
            spread = idle[k]
            for e in range(lo, hi):
                z = offset[k] + e - lo
                if not data[e] > 0.0:
                    usage[k, indices[e]] += rate * gain[z]
            for e in range(next_lo, next_hi):
                z = later + e - next_lo
                if wait[z] > 0.0:
                    mass = rate * wait[z] * (1.0 + (1.0 - q) * x[z, rested])
                    at[z, rested] += mass
                    usage[k, indices[e]] += mass - rate * wait[z]
                    spread -= wait[z]
            none_next[rested] += rate * max(spread, 0.0)
        # Tasks without an entry: added to all, taken off those with one, where that does not swamp what they have.
        largest = 0.0
        for e in range(lo, hi):
            largest = max(largest, w[k, indices[e]])
        if factor * largest > _SWAMPED:
            p = lo
            for j in range(m):
                if p < hi and indices[p] == j:
                    p += 1
                else:
                    usage[k, j] += factor * w[k, j]
        else:
            free_usage[k] += factor
            for e in range(lo, hi):
                usage[k, indices[e]] -= factor * w[k, indices[e]]
        for level in range(capacity + 1):
            none[level] = none_next[level]
    return log_z


@njit(cache=True, parallel=True)
def soft_paths(n, rows, battery, eps, prices, w, cheapest, tail, rank, levels, ready, free, chunks):
    """All agents: (log Z (n,), usage (T, m)); the weights as in `sapopt.dynamics.switching.soft_idle`."""
    T, m = prices.shape
    capacity = battery[3]
    most = most_entries(rows[0], n, T)
    log_z = np.empty(n)
    usages = np.zeros((chunks, T, m))
    frees = np.zeros((chunks, T))
    for c in prange(chunks):
        logN = np.empty((T + 1, capacity + 1))
        x, at = np.empty((most, capacity + 1)), np.empty((most, capacity + 1))
        gain, wait = np.empty(most), np.empty(most)
        U, idle, D = np.empty(T), np.empty(T), np.empty((T, 2))
        mark, offset = np.full(m, -1), np.empty(T + 1, np.int64)
        for i in range(c, n, chunks):
            _idle_sums(i, n, rows, w, cheapest, tail, rank, mark, U)
            if not _backward(i, n, rows, battery, eps, prices, w, U, logN, x, gain, wait, idle, D, offset):
                log_z[i] = -np.inf
                continue
            start = (levels[i], ready[i], free)
            log_z[i] = _forward(
                i,
                n,
                rows,
                battery,
                eps,
                w,
                U,
                start,
                logN,
                x,
                gain,
                wait,
                idle,
                D,
                offset,
                at,
                usages[c],
                frees[c],
            )
    usage = usages.sum(axis=0)
    free_usage = frees.sum(axis=0)
    for k in range(T):
        for j in range(m):
            usage[k, j] += free_usage[k] * w[k, j]
    return log_z, usage
