"""The tasks that an agent may come to in a dive, and what it earns there."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit
from sapopt.solvers.dual_decomposition.dives.kernels import _BINS, Work
from sapopt.solvers.dual_decomposition.exchanges.cells import Cells
from sapopt.solvers.dual_decomposition.exchanges.rule import earned, entered

Candidates = namedtuple("Candidates", "start task move stay")
"""Tasks of agent i at step k: ``start[i * T + k] : start[i * T + k + 1]``; what it earns there when it comes from
another task (`move`, without what a matrix of costs charges) and when it held the task before (`stay`)."""


def candidates(rule: Any, cells: Cells, plan: IntArray, widest: int) -> Any:
    """Candidates from good cells (the best first), those of a plan (T, n) included, at most `widest` and one a step."""
    T, n = plan.shape
    steps, agents = np.divmod(np.arange(T * n), n)
    own = np.stack([agents, steps, plan.ravel()], axis=1)
    listed = np.concatenate([own, cells.astype(np.int64)])
    row = listed[:, 0] * T + listed[:, 1]
    order = np.argsort(row, kind="stable")
    sorted_rows = row[order]
    begin = np.searchsorted(sorted_rows, np.arange(n * T))
    rank = np.arange(len(order)) - begin[sorted_rows]
    own_task = np.ascontiguousarray(plan.T).ravel()[sorted_rows]
    task = listed[order, 2]
    keep = (rank == 0) | ((rank <= widest) & (task != own_task))
    start = np.searchsorted(sorted_rows[keep], np.arange(n * T + 1))
    task = task[keep].astype(np.int32)
    move, stay = np.empty(len(task)), np.empty(len(task))
    gains(rule, start, task, move, stay, T)
    return Candidates(start, task, move, stay)


@njit(borrows=True, nogil=True)
def gains(rule, start, task, move, stay, steps):  # type: ignore[no-untyped-def]
    """Fill `move` and `stay` of `Candidates`."""
    for row in range(len(start) - 1):
        i, k = row // steps, row % steps
        for c in range(start[row], start[row + 1]):
            move[c] = entered(rule, k, i, task[c])
            stay[c] = earned(rule, k, i, task[c], task[c])


def work_for(cells: Any, shape: tuple[int, int, int]) -> Any:
    """Arrays for dives over some candidates."""
    T, n, m = shape
    most = len(cells.task) + T * n
    whole = {name: np.empty(most) for name in ("move", "stay", "price", "forward", "backward", "soft")}
    numbers = {name: np.empty(most, np.int32) for name in ("task", "origin", "same")}
    rows = {name: np.empty(T * n + 1, np.int64) for name in ("chosen", "start", "old")}
    planes: dict[str, FloatArray] = {name: np.zeros((T, m)) for name in ("weight", "usage", "claim")}
    rest = {
        "dropped": np.zeros(most, np.uint8),
        "bins": np.zeros(_BINS + 1, np.int64),
    }
    return Work(**whole, **numbers, **rows, **planes, **rest)
