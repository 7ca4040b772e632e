"""Rolling assignment with priced futures: one assignment problem per step, whose weights see the whole horizon.

The weight of (agent, task) at step k is the benefit, less the handover from the task that the agent really holds, plus
the value of the agent's best path from there to the end of the horizon under the prices. The step's own capacities are
kept by the assignment, later ones by the prices. This gives a feasible plan for any n <= m, also where no task is
spare and agents can only swap.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.blocks import in_blocks, work_array
from sapopt.kernels.jit import njit
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays, move_cost
from sapopt.solvers.dual_decomposition.network_plans.priced_assignment import assign

_LARGE = 4_000_000
"""Pairs above which the assignment starts from the prices even where a free task then counts as worth its price."""


@njit(cache=True, borrows=True, nogil=True)
def priced_futures(begin, stop, rows, prices, start, end, futures, now, enter, row):  # type: ignore[no-untyped-def]
    """Fill futures[k - start, i, j] with the value of agent i's best path after it held task j at step k < end.

    For the agents of a block, begin <= i < stop. `now`, `enter` and `row` (m,) are scratch; `row` holds zeros.
    """
    indptr, indices, data, n = rows.indptr, rows.indices, rows.data, rows.agents
    cost, idle_is_free = rows.cost, rows.idle_is_free
    steps, m = prices.shape
    by_pair = rows.matrix.shape[0] > 0
    for i in range(begin, stop):
        for j in range(m):
            now[j] = 0.0
        for k in range(steps - 1, start - 1, -1):
            if k < end:
                for j in range(m):
                    futures[k - start, i, j] = now[j]
            if k == start:
                break
            # from the futures after step k to those after step k - 1
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            for q in range(lo, hi):
                row[indices[q]] = data[q]
            best = -np.inf
            for j in range(m):
                enter[j] = now[j] + row[j] - prices[k, j]
                best = max(best, enter[j] - cost if row[j] > 0.0 or not idle_is_free else enter[j])
            for a in range(m):
                now[a] = enter[a]
                if by_pair:
                    for j in range(m):
                        now[a] = max(now[a], enter[j] - move_cost(rows, a, j, row[j]))
                else:
                    now[a] = max(now[a], best)
            for q in range(lo, hi):
                row[indices[q]] = 0.0


@njit(cache=True)
def step_weights(rows, k, held, future, weights):  # type: ignore[no-untyped-def]
    """Fill weights[i, j]: benefit at step k, less the handover from held[i], plus future[i, j]."""
    indptr, indices, data, n = rows.indptr, rows.indices, rows.data, rows.agents
    for i in range(n):
        row = np.zeros(future.shape[1])
        for q in range(indptr[k * n + i], indptr[k * n + i + 1]):
            row[indices[q]] = data[q]
        for j in range(future.shape[1]):
            weights[i, j] = future[i, j] + row[j] - move_cost(rows, held[i], j, row[j])


def plan_by_futures(
    arrays: Arrays,
    prices: FloatArray,
    stop: Callable[[], Any] = lambda: False,
    *,
    block: int = 10,
    reprice: Callable[[int, IntArray, FloatArray], FloatArray] | None = None,
) -> IntArray | None:
    """Return the plan of the rolling assignment, or None if ``stop()`` ended it.

    Parameters
    ----------
    prices : (T, m)
        Prices of the cells.
    block : int
        Steps whose futures, ``block * n * m`` numbers of single precision, are in memory at a time.
    reprice : callable, optional
        ``reprice(k, held, prices of the steps k..T-1)`` gives new prices for these steps before every block but the
        first. The prices were those of the whole problem; what is left of it, from the assignment that is really held,
        has slightly others, and where no task is spare that is most of what the rolling assignment loses.
    """
    steps, n, m = arrays.steps, arrays.agents, arrays.tasks
    plan = np.zeros((steps, n), np.int64)
    held = arrays.initial
    weights = np.empty((n, m))
    futures = np.zeros((min(block, steps), n, m), np.float32)
    for start in range(0, steps, block):
        end = min(start + block, steps)
        if start > 0 and reprice is not None:
            prices = prices.copy()
            prices[start:] = reprice(start, held, prices[start:])
        in_blocks(
            priced_futures, n, arrays.rows, prices, start, end, futures,
            scratch=lambda: (work_array(m, fill=0.0), work_array(m), work_array(m, fill=0.0)),
            turns=3.0 * (steps - start) * n * m,
        )  # fmt: skip
        for k in range(start, end):
            step_weights(arrays.rows, k, held, futures[k - start], weights)
            if n == m or n * m > _LARGE:
                held = assign(weights, prices[k])
            else:
                held = linear_sum_assignment(weights, maximize=True)[1]
            plan[k] = held
            if stop():
                return None
    return plan
