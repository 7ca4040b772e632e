"""Rolling assignment with priced futures: one assignment problem per step, whose weights see the whole horizon.

The weight of (agent, task) at step k is the benefit, less the handover from the task that the agent really holds, plus
the value of the agent's best path from there to the end of the horizon under the prices. The step's own capacities are
kept by the assignment, later ones by the prices. This gives a feasible plan for any n <= m, also where no task is
spare and agents can only swap.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, prange
from scipy.optimize import linear_sum_assignment

from sapopt.solvers.dual_decomposition.arrays import Arrays, Floats, Ints, move_cost


@njit(cache=True, parallel=True)
def step_back(kernel, k, prices, later, now):  # type: ignore[no-untyped-def]
    """From the futures after step k + 1, later[i, j], fill those after step k, now[i, j]."""
    indptr, indices, data, n, cost, matrix, idle_is_free = kernel
    m = prices.shape[1]
    by_pair = matrix.shape[0] > 0
    for i in prange(n):
        enter = np.empty(m)
        row = np.zeros(m)
        for q in range(indptr[(k + 1) * n + i], indptr[(k + 1) * n + i + 1]):
            row[indices[q]] = data[q]
        best = -np.inf
        for j in range(m):
            enter[j] = later[i, j] + row[j] - prices[k + 1, j]
            best = max(best, enter[j] - cost if row[j] > 0.0 or not idle_is_free else enter[j])
        for a in range(m):
            value = enter[a]
            if by_pair:
                for j in range(m):
                    value = max(value, enter[j] - move_cost(kernel, a, j, row[j]))
            else:
                value = max(value, best)
            now[i, a] = value


@njit(cache=True, parallel=True)
def step_weights(kernel, k, held, future, weights):  # type: ignore[no-untyped-def]
    """Fill weights[i, j]: benefit at step k, less the handover from held[i], plus future[i, j]."""
    indptr, indices, data, n, cost, matrix, idle_is_free = kernel
    for i in prange(n):
        row = np.zeros(future.shape[1])
        for q in range(indptr[k * n + i], indptr[k * n + i + 1]):
            row[indices[q]] = data[q]
        for j in range(future.shape[1]):
            weights[i, j] = future[i, j] + row[j] - move_cost(kernel, held[i], j, row[j])


def rolling_plan(arrays: Arrays, prices: Floats, stop: Callable[[], Any] = lambda: False) -> Ints | None:
    """Return the plan (T, n) of the rolling assignment under ``prices`` (T, m), or None when ``stop()`` came true.

    About 2 sqrt(T) matrices of single-precision futures are in memory: those of every sqrt(T)-th step, from which the
    ones between are computed again.
    """
    steps, n, m = arrays.steps, arrays.agents, arrays.tasks
    stride = max(1, math.isqrt(steps - 1) + 1)
    kept: dict[int, Any] = {steps - 1: np.zeros((n, m), np.float32)}
    later = kept[steps - 1]
    for k in range(steps - 2, -1, -1):
        now = np.empty_like(later)
        step_back(arrays.kernel, k, prices, later, now)
        if k % stride == stride - 1:
            kept[k] = now
        later = now
        if stop():
            return None
    plan = np.zeros((steps, n), np.int64)
    held = arrays.initial
    weights = np.empty((n, m))
    block: dict[int, Any] = {}
    for k in range(steps):
        if k not in kept and k not in block:
            end = min(k - k % stride + stride - 1, steps - 1)
            block = {end: kept[end]}
            for back in range(end - 1, k - 1, -1):
                block[back] = np.empty((n, m), np.float32)
                step_back(arrays.kernel, back, prices, block[back + 1], block[back])
        step_weights(arrays.kernel, k, held, block[k] if k in block else kept[k], weights)
        held = plan[k] = linear_sum_assignment(weights, maximize=True)[1]
        if stop():
            return None
    return plan
