"""Which entries a near-optimal path may use: the regret of every (step, agent, task) at given prices.

The regret of an entry is what the agent's best path loses when it must hold that task at that step. In the soft
recursion an entry of regret r has weight exp(-r / temperature) at most, so far fewer entries matter than are seen once
the prices are good and the temperature is low.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True, parallel=True)
def near_entries(
    indptr, entry_slot, data, slot_ptr, slot_task, cost, start, prices, park, P, regret, chunks
):  # fmt: skip
    """Mark the entries of regret at most `regret` under the strict rule, and the negative ones: (nnz,) bool.

    `P` as `parking_table`.
    """
    T = prices.shape[0]
    n = slot_ptr.size - 1
    near = np.zeros(data.size, np.bool_)
    widest = 1
    for i in range(n):
        widest = max(widest, slot_ptr[i + 1] - slot_ptr[i])
    for c in prange(chunks):
        after, enter, leave = np.empty((T, widest)), np.empty(T), np.empty(T + 1)
        now = np.empty(widest)
        for i in range(c, n, chunks):
            slots = slot_task[slot_ptr[i] : slot_ptr[i + 1]]
            S = slots.size
            # backward: after[k, s] is the value of the steps after k, leave[b] that of those from b on after a move
            leave[T] = 0.0
            for s in range(S):
                now[s] = 0.0
            for k in range(T - 1, -1, -1):
                future = after[k]
                row = prices[k]
                for s in range(S):
                    future[s] = now[s]
                    now[s] -= row[slots[s]]
                r = k * n + i
                for e in range(indptr[r], indptr[r + 1]):
                    now[entry_slot[e]] += data[e]
                best = -np.inf
                for s in range(S):
                    best = max(best, now[s])
                if park:
                    for b in range(k + 1, T + 1):
                        best = max(best, leave[b] - P[k, b])
                leave[k] = best - cost
                for s in range(S):
                    now[s] = max(now[s], best - cost)
            # forward: now[s] is the value up to step k at slot s
            first = -cost if start[i] >= 0 else 0.0
            value = leave[0] + cost + first
            for s in range(S):
                now[s] = -np.inf
                if slots[s] == start[i]:
                    now[s] = 0.0
                    stay = after[0, s] - prices[0, start[i]]
                    for e in range(indptr[i], indptr[i + 1]):
                        if entry_slot[e] == s:
                            stay += data[e]
                    value = max(value, stay)
            best = 0.0
            for k in range(T):
                enter[k] = best - cost if k > 0 else first
                row = prices[k]
                for s in range(S):
                    now[s] = max(now[s], enter[k]) - row[slots[s]]
                r = k * n + i
                for e in range(indptr[r], indptr[r + 1]):
                    now[entry_slot[e]] += data[e]
                best = -np.inf
                for s in range(S):
                    best = max(best, now[s])
                if park:
                    for a in range(k + 1):
                        best = max(best, enter[a] - P[a, k + 1])
                for e in range(indptr[r], indptr[r + 1]):
                    s = entry_slot[e]
                    near[e] = data[e] < 0.0 or now[s] + after[k, s] >= value - regret
    return near


@njit(cache=True)
def kept_rows(indptr, indices, data, near):
    """The marked entries alone: (indptr, indices, data)."""
    count = 0
    for e in range(near.size):
        count += near[e]
    starts = np.zeros(indptr.size, np.int64)
    tasks = np.empty(count, np.int32)
    kept = np.empty(count)
    filled = 0
    for r in range(indptr.size - 1):
        for e in range(indptr[r], indptr[r + 1]):
            if near[e]:
                tasks[filled] = indices[e]
                kept[filled] = data[e]
                filled += 1
        starts[r + 1] = filled
    return starts, tasks, kept
