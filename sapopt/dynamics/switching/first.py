"""Values of the best paths that start with a given task: what the first assignment of a window is worth.

For every agent i and task j: the value of i's longest path under the prices among those that hold j at the first step,
the price of the first step left out. With these values as benefits, one assignment problem settles the first step
without conflicts, while the prices stand for the competition at the later ones.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True, parallel=True)
def first_values(indptr, indices, data, n, cost, idle_is_free, start, prices):
    """Uniform cost: (n, m) values, by the recursion backwards in time over all tasks."""
    T, m = prices.shape
    out = np.zeros((n, m))
    for i in prange(n):
        future = out[i]  # best value of the steps after the current one, by the task held at it
        charge = np.empty(m)
        for k in range(T - 1, -1, -1):
            charge[:] = 0.0 if idle_is_free else cost
            if k > 0:
                for j in range(m):
                    future[j] -= prices[k, j]
            for e in range(indptr[k * n + i], indptr[k * n + i + 1]):
                future[indices[e]] += data[e]
                if data[e] > 0.0:
                    charge[indices[e]] = cost
            if k > 0:
                enter = -np.inf
                for j in range(m):
                    enter = max(enter, future[j] - charge[j])
                for j in range(m):
                    future[j] = max(future[j], enter)
            elif start[i] >= 0:
                for j in range(m):
                    if j != start[i]:
                        future[j] -= charge[j]
    return out


@njit(cache=True, parallel=True)
def first_values_matrix(indptr, indices, data, n, cost, idle_is_free, start, prices):
    """Matrix cost: (n, m) values, O(T m^2) an agent."""
    T, m = prices.shape
    out = np.zeros((n, m))
    for i in prange(n):
        future = out[i]
        old = np.empty(m)
        free = np.empty(m, np.bool_)
        for k in range(T - 1, -1, -1):
            free[:] = idle_is_free
            if k > 0:
                for j in range(m):
                    future[j] -= prices[k, j]
            for e in range(indptr[k * n + i], indptr[k * n + i + 1]):
                future[indices[e]] += data[e]
                if data[e] > 0.0:
                    free[indices[e]] = False
            if k > 0:
                old[:] = future
                for a in range(m):
                    best = old[a]
                    for j in range(m):
                        v = old[j] if free[j] else old[j] - cost[a, j]
                        if v > best:
                            best = v
                    future[a] = best
            elif start[i] >= 0:
                for j in range(m):
                    if not free[j]:
                        future[j] -= cost[start[i], j]
    return out
