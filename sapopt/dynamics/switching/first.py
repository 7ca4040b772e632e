"""Values of the best paths that start with a given task: what the first assignment of a window is worth.

For every agent i and task j: the value of i's longest path under the prices among those that hold j at the first step,
the price of the first step left out. With these values as benefits, one assignment problem settles the first step
without conflicts, while the prices stand for the competition at the later ones.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from sapopt.kernels.jit import njit


@njit(cache=True, borrows=True, nogil=True)
def first_values(begin, end, window, idle_is_free, prices, out, charge):
    """Uniform cost: fill the rows of `out` (n, m), by the recursion backwards in time over all tasks.

    ``future_k[j] = benefit_k[j] + max(future_{k+1}[j], max_a future_{k+1}[a] - charge_{k+1}[a])``, less the price of
    the later steps. `charge` (m,) is scratch.
    """
    n, indptr, indices, data, cost = window.n, window.indptr, window.indices, window.data, window.cost
    T, m = prices.shape
    for i in range(begin, end):
        future = out[i]  # best value of the steps after the current one, by the task held at it
        for j in range(m):
            future[j] = 0.0
        for k in range(T - 1, -1, -1):
            for j in range(m):
                charge[j] = 0.0 if idle_is_free else cost
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
            elif window.held[i] >= 0:
                for j in range(m):
                    if j != window.held[i]:
                        future[j] -= charge[j]


@njit(cache=True, borrows=True, nogil=True)
def first_values_matrix(begin, end, window, idle_is_free, prices, out, old, free):
    """Matrix cost, O(T m^2) an agent: fill the rows of `out` (n, m); `old` (m,) and `free` (m,) bool are scratch."""
    n, indptr, indices, data, cost = window.n, window.indptr, window.indices, window.data, window.cost
    T, m = prices.shape
    for i in range(begin, end):
        future = out[i]
        for j in range(m):
            future[j] = 0.0
        for k in range(T - 1, -1, -1):
            for j in range(m):
                free[j] = idle_is_free
            if k > 0:
                for j in range(m):
                    future[j] -= prices[k, j]
            for e in range(indptr[k * n + i], indptr[k * n + i + 1]):
                future[indices[e]] += data[e]
                if data[e] > 0.0:
                    free[indices[e]] = False
            if k > 0:
                for j in range(m):
                    old[j] = future[j]
                for a in range(m):
                    best = old[a]
                    for j in range(m):
                        v = old[j] if free[j] else old[j] - cost[a, j]
                        if v > best:
                            best = v
                    future[a] = best
            elif window.held[i] >= 0:
                for j in range(m):
                    if not free[j]:
                        future[j] -= cost[window.held[i], j]
