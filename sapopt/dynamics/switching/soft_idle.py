"""Soft longest paths when only a move into a positive benefit pays; see `switching_paths_soft` for the idea.

A task without an entry at step k can be entered for nothing, so its weight is that of everything before step k times
w_k[j], and the recursion runs over the stored entries. All such tasks together weigh ``U = sum of w over the tasks
without an entry``; it is summed explicitly over the cheapest tasks, where cancellation would hurt.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

_FAST = {"nnan", "nsz", "reassoc", "contract"}


@njit(cache=True)
def cheapest_and_rest(prices, w, count):
    """Per step the `count` cheapest tasks, the sum of w over all the others, and every task's rank (T, m)."""
    T, m = prices.shape
    cheapest = np.empty((T, count), np.int32)
    rest = np.zeros(T)
    rank = np.empty((T, m), np.int32)
    for k in range(T):
        order = np.argsort(prices[k], kind="mergesort")
        for c in range(m):
            rank[k, order[c]] = c
            if c < count:
                cheapest[k, c] = order[c]
            else:
                rest[k] += w[k, order[c]]
    return cheapest, rest, rank


@njit(cache=True, fastmath=_FAST)
def _soft_idle_free(
    agent, n, indptr, indices, data, q, eps, start, prices, w, cheapest, rest, rank,
    A, gain, match, mark, U, base, inverse, R, usage, free,
):  # fmt: skip
    """One agent: adds the occupancy of its entries to `usage`, of the tasks without entry to `free`; returns log Z."""
    T = w.shape[0]
    count = cheapest.shape[1]
    log_z = 0.0
    g = 0
    before = 0  # where the previous step's entries begin in A
    for k in range(T):
        r = k * n + agent
        lo, hi = indptr[r], indptr[r + 1]
        top = 0.0
        for e in range(lo, hi):
            top = max(top, data[e] - prices[k, indices[e]])
            mark[indices[e]] = r
        others = rest[k]
        for e in range(lo, hi):
            if rank[k, indices[e]] >= count:
                others -= w[k, indices[e]]
        others = max(others, 0.0)
        for c in range(count):
            j = cheapest[k, c]
            if mark[j] != r:
                others += w[k, j]
        U[k] = others
        shift = np.exp(-top / eps)
        total = others * shift
        p = indptr[r - n] if k > 0 else 0
        prev_lo = p
        prev_hi = indptr[r - n + 1] if k > 0 else 0
        for e in range(lo, hi):
            j = indices[e]
            x = g + e - lo
            match[x] = -1
            enter = q if data[e] > 0.0 else 1.0
            if k == 0:
                held = 1.0 if j == start else 0.0
                if start < 0:
                    enter = 1.0
            else:
                while p < prev_hi and indices[p] < j:
                    p += 1
                if p < prev_hi and indices[p] == j:
                    match[x] = before + p - prev_lo
                    held = A[match[x]]
                else:
                    held = w[k - 1, j] * base[k - 1]
            gain[x] = np.exp((data[e] - prices[k, j] - top) / eps)
            A[x] = gain[x] * (held + enter)
            total += A[x]
        if not total > 0.0:
            return -np.inf
        inverse[k] = 1.0 / total
        base[k] = shift / total
        for e in range(g, g + hi - lo):
            A[e] *= inverse[k]
        log_z += np.log(total) + top / eps
        before = g
        g += hi - lo
    # backward; gain becomes the weight of staying into an entry, times what follows
    for e in range(before, g):
        R[e] = 1.0
    follow = 1.0
    later_lo, later_hi, later_row = g, g, 0
    for k in range(T - 1, -1, -1):
        r = k * n + agent
        lo, hi = indptr[r], indptr[r + 1]
        first = g - (hi - lo)
        # Occupancy of the tasks without entry: w times a factor, added to all tasks at the end and here taken off
        # those with an entry. Where these would swamp it (their w is far larger), it is spread one by one.
        factor = base[k] * follow
        if factor * U[k] < 1e-12:
            factor = 0.0
        largest = 0.0
        for e in range(lo, hi):
            largest = max(largest, w[k, indices[e]])
        if factor * largest > 100.0:
            for e in range(lo, hi):
                mark[indices[e]] = -2 - r
            for j in range(w.shape[1]):
                if mark[j] != -2 - r:
                    usage[k, j] += factor * w[k, j]
            factor = 0.0
        free[k] += factor
        into_free = follow * U[k]
        for x in range(later_lo, later_hi):
            if match[x] < 0:  # waits at step k on a task that it has an entry for at step k+1
                j = indices[later_row + x - later_lo]
                v = w[k, j] * gain[x]
                usage[k, j] += base[k] * v
                into_free += v
        total = base[k] * into_free
        for e in range(lo, hi):
            x = first + e - lo
            j = indices[e]
            usage[k, j] += A[x] * R[x] - factor * w[k, j]
            gain[x] *= inverse[k] * R[x]
            total += gain[x] * (q if data[e] > 0.0 else 1.0)
        if k > 0:
            prev_lo = first - (indptr[r - n + 1] - indptr[r - n])
            for x in range(prev_lo, first):
                R[x] = total
            for x in range(first, g):
                if match[x] >= 0:
                    R[match[x]] += gain[x]
        later_lo, later_hi, later_row = first, g, lo
        follow = total
        g = first
    return log_z


@njit(cache=True, parallel=True)
def soft_idle_free_paths(indptr, indices, data, n, cost, eps, start, prices, w, cheapest, rest, rank, chunks):
    """All agents. Returns (log Z (n,), usage (T, m))."""
    T, m = w.shape
    q = np.exp(-cost / eps)
    log_z = np.empty(n)
    widest = 1
    for i in range(n):
        count = 0
        for k in range(T):
            count += indptr[k * n + i + 1] - indptr[k * n + i]
        widest = max(widest, count)
    usages = np.zeros((chunks, T, m))
    frees = np.zeros((chunks, T))
    for c in prange(chunks):
        A = np.empty(widest)
        gain = np.empty(widest)
        match = np.empty(widest, np.int64)
        R = np.empty(widest)
        mark = np.full(m, -1)
        U = np.empty(T)
        base = np.empty(T)
        inverse = np.empty(T)
        for i in range(c, n, chunks):
            log_z[i] = _soft_idle_free(
                i, n, indptr, indices, data, q, eps, start[i], prices, w, cheapest, rest, rank,
                A, gain, match, mark, U, base, inverse, R, usages[c], frees[c],
            )  # fmt: skip
    usage = usages.sum(axis=0)
    free = frees.sum(axis=0)
    for k in range(T):
        for j in range(m):
            usage[k, j] += free[k] * w[k, j]
    return log_z, usage
