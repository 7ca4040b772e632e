"""Priced path sweeps: agents one after another take their best path among the cells that are left.

A *cell* is a task at a step. The sweep keeps one array of cell prices in which a taken cell costs +inf, so that the
path of an agent over the free cells is an ordinary longest path.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Callable

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays, move_cost
from sapopt.solvers.dual_decomposition.plans import closed_prices

Workspace = namedtuple("Workspace", "row values old origin best_task")
"""Scratch arrays of `best_path`, made once for many paths. Of shape (m,): an agent's benefits at a step, all 0 in
between, and the values of its best paths to every task at this step and the last; of shape (T, m): where these come
from, and of shape (T,) the best task of the step before."""

_CLOSED = -1e299
"""Below the value of any path through open cells."""

_CELLS_AT_ONCE = 10**8
"""Path cells between two looks at the clock, some tenths of a second."""


@njit(cache=True, borrows=True)
def best_path(rows, i, prices, first, last, before, after, work, path):  # type: ignore[no-untyped-def]
    """Write agent i's best path over the steps first..last-1 into path[first:last] and return its priced value.

    ``before`` is the task held before the first step and ``after`` the one that follows the last (-1: none).
    A price of +inf closes a cell; the value is -inf when no path is open. ``work`` comes from `workspace`.
    """
    indptr, indices, data, n = rows.indptr, rows.indices, rows.data, rows.agents
    cost, matrix, idle_is_free = rows.cost, rows.matrix, rows.idle_is_free
    row, values, old, origin, best_task = work.row, work.values, work.old, work.origin, work.best_task
    m = prices.shape[1]
    by_pair = matrix.shape[0] > 0
    for k in range(first, last):
        lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
        for q in range(lo, hi):
            row[indices[q]] = data[q]
        if k == first:
            for j in range(m):
                values[j] = row[j] - prices[k, j] - move_cost(rows, before, j, row[j])
        elif by_pair:
            for j in range(m):  # not by a slice: that would make a copy on the way
                old[j] = values[j]
            for j in range(m):
                charged = row[j] > 0.0 or not idle_is_free
                values[j] = -np.inf
                for a in range(m):
                    new = old[a] - matrix[a, j] if charged else old[a]
                    if new > values[j] or (new == values[j] and a == j):
                        values[j] = new
                        origin[k, j] = a
                values[j] += row[j] - prices[k, j]
        else:
            task = 0
            for j in range(m):
                if values[j] > values[task]:
                    task = j
            best_task[k] = task
            best = values[task]
            for j in range(m):
                switch = best - cost if row[j] > 0.0 or not idle_is_free else best
                stay = values[j] >= switch
                origin[k, j] = 0 if stay else 1
                values[j] = (values[j] if stay else switch) + row[j] - prices[k, j]
        for q in range(lo, hi):
            row[indices[q]] = 0.0
    end_benefit = 0.0
    if after >= 0 and idle_is_free:
        for q in range(indptr[last * n + i], indptr[last * n + i + 1]):
            if indices[q] == after:
                end_benefit = data[q]
    task = 0
    for j in range(m):
        if after >= 0:
            values[j] -= move_cost(rows, j, after, end_benefit)
        if values[j] > values[task]:
            task = j
    result = values[task]
    for k in range(last - 1, first - 1, -1):
        path[k] = task
        if k > first:
            if by_pair:
                task = origin[k, task]
            elif origin[k, task] == 1:
                task = best_task[k]
    return result


@njit(cache=True)
def workspace(steps, tasks):  # type: ignore[no-untyped-def]
    """Return the scratch arrays of `best_path`."""
    return Workspace(
        np.zeros(tasks),
        np.zeros(tasks),
        np.zeros(tasks),
        np.zeros((steps, tasks), np.int16),
        np.zeros(steps, np.int64),
    )


@njit(cache=True)
def place(rows, initial, order, prices, open_prices, plan):  # type: ignore[no-untyped-def]
    """Let the agents of ``order`` re-plan one by one: each frees its cells and takes its best open path.

    ``prices`` (T, m) has +inf at taken cells and is kept so; ``open_prices`` are the prices of free cells.
    Returns False when an agent found no open path (its cells stay free and its column of the plan is stale).
    """
    steps, m = prices.shape
    work = workspace(steps, m)
    path = np.zeros(steps, np.int64)
    for i in order:
        for k in range(steps):
            prices[k, plan[k, i]] = open_prices[k, plan[k, i]]
        if best_path(rows, i, prices, np.int64(0), steps, initial[i], np.int64(-1), work, path) < _CLOSED:
            return False
        for k in range(steps):
            plan[k, i] = path[k]
            prices[k, path[k]] = np.inf
    return True


def sweep_by_arrays(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    rng: np.random.Generator,
    seconds_left: Callable[[], float] = lambda: math.inf,
) -> IntArray:
    """Return the plan (T, n) after the agents, in random order, moved to their best paths under ``prices`` (T, m)."""
    moved = plan.copy()
    order = rng.permutation(arrays.agents)
    closed = closed_prices(prices, plan)
    for part in np.array_split(order, 1 + arrays.steps * arrays.agents * arrays.tasks // _CELLS_AT_ONCE):
        if seconds_left() <= 0:
            break
        place(arrays.rows, arrays.initial, part, closed, prices, moved)
    return moved
