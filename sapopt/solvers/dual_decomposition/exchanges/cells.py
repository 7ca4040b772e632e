"""Cells that are good for an agent: what its best priced path loses when it is led through them."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sapopt.data.types import FloatArray, root_mean_square
from sapopt.kernels.jit import njit
from sapopt.problem.sap import SAP
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import marginals

Cells = npt.NDArray[np.int32]
"""Agent, step and task of every cell, (cells, 3)."""

_MOST = 4_000_000
"""Most cells that are kept."""


_SMALL = 0.5
"""Share of a typical benefit that is small."""


def good_cells(problem: SAP, prices: FloatArray, regret: float, most: int = _MOST) -> Cells:
    """Agent, step and task (cells, 3), int32, of the cells of least loss under prices (T, m), the best first.

    Parameters
    ----------
    regret : float
        Loss up to which a cell counts.

    Notes
    -----
    Under a plain switching cost the loss is that of the whole path; else that of the step alone, against the agent's
    best pair of it, and only pairs whose benefit is not small are listed.
    """
    if problem.model.switching() is not None:
        cells, loss = _by_path(Arrays.of(problem), prices, regret, most)
    else:
        cells, loss = _by_step(problem, prices)
    order = np.argsort(loss, kind="stable")[:most]
    return np.ascontiguousarray(cells[order])


def _by_path(arrays: Arrays, prices: FloatArray, regret: float, most: int) -> tuple[Cells, FloatArray]:
    T, m = arrays.steps, arrays.tasks
    cells, loss = np.empty((most, 3), np.int32), np.empty(most)
    scratch = np.zeros((3, T, m))
    found = near_cells(
        arrays.rows,
        arrays.initial,
        prices,
        regret,
        np.full(m, -1),
        np.zeros(m, np.int64),
        scratch,
        cells,
        loss,
    )
    return cells[:found], loss[:found]


@njit(borrows=True, nogil=True)
def near_cells(rows, initial, prices, regret, local, tasks, scratch, cells, loss):  # type: ignore[no-untyped-def]
    """Fill `cells` and `loss` with the cells of all agents that lose at most `regret`; return how many.

    The tasks of an agent are those that it sees at some step; `local` (m,) holds -1, `tasks` (m,) and `scratch`
    (3, T, m) are for work.
    """
    T = prices.shape[0]
    n = rows.agents
    benefit, forward, backward = scratch[0], scratch[1], scratch[2]
    found = 0
    for i in range(n):
        count = 0
        for k in range(T):
            for e in range(rows.indptr[k * n + i], rows.indptr[k * n + i + 1]):
                j = rows.indices[e]
                if local[j] < 0:
                    local[j], tasks[count] = count, j
                    count += 1
        own = tasks[:count]
        marginals(
            rows, i, prices, np.int64(0), T, initial[i], np.int64(-1), local, own, benefit, forward, backward
        )
        for k in range(T):
            best = -math.inf
            for c in range(count):
                best = max(best, forward[k, c] + backward[k, c])
            for c in range(count):
                lost = best - forward[k, c] - backward[k, c]
                if lost <= regret and found < len(loss):
                    cells[found, 0], cells[found, 1], cells[found, 2] = i, k, own[c]
                    loss[found] = lost
                    found += 1
        for c in range(count):
            local[own[c]] = -1
    return found


def _by_step(problem: SAP, prices: FloatArray) -> tuple[Cells, FloatArray]:
    flat = problem.benefits.flat()
    row = np.repeat(np.arange(problem.T * problem.n), np.diff(flat.indptr))
    keep = flat.data > _SMALL * root_mean_square(flat.data)
    row, task, data = row[keep], flat.indices[keep], flat.data[keep]
    step, agent = np.divmod(row, problem.n)
    gain = data - prices[step, task]
    best = np.full(problem.T * problem.n, -np.inf)
    np.maximum.at(best, row, gain)
    cells = np.stack([agent, step, task], axis=1).astype(np.int32)
    return cells, best[row] - gain
