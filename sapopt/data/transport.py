"""Assignments where a task may take several agents."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from sapopt.data.feasibility import InfeasibleError, explain_infeasible
from sapopt.data.matrices import GainMatrix
from sapopt.data.types import FloatArray, IntArray

_LARGE = 50_000
"""Pairs from which on agents that may all rest in one place are assigned sparsely."""


def transported(matrix: FloatArray, room: IntArray) -> IntArray:
    """The assignment (n,) of greatest total that gives task j to at most ``room[j]`` agents.

    Parameters
    ----------
    matrix : ndarray, shape (n, m)
        -inf forbids a pair.
    room : ndarray of int64, shape (m,)

    Raises
    ------
    InfeasibleError
        If there is no assignment.
    """
    from scipy.optimize import linear_sum_assignment

    rest = int(np.argmax(room))
    if matrix.size >= _LARGE and room[rest] >= len(matrix) and int(room.sum()) - room[rest] == len(room) - 1:
        others = np.delete(room, rest)
        if (others == 1).all() and np.isfinite(matrix[:, rest]).all():
            return _beside_rest(matrix, rest)
    columns = np.repeat(np.arange(len(room)), np.minimum(room, len(matrix)))
    if len(columns) < len(matrix):
        raise InfeasibleError(f"the tasks have room for {len(columns)} of {len(matrix)} agents")
    try:
        _, place = linear_sum_assignment(matrix[:, columns], maximize=True)
    except ValueError:
        raise InfeasibleError(short_of_room(matrix, room)) from None
    return np.asarray(columns[place], dtype=np.int64)


def _beside_rest(matrix: FloatArray, rest: int) -> IntArray:
    """`transported` where one task has room for all, and every other one for one: only what beats resting matters."""
    from sapopt.kernels.matching import assign_and_park

    n, m = matrix.shape
    gains = matrix - matrix[:, rest, None]
    agent, task = np.nonzero(gains > 0)
    own = np.zeros(n + 1, dtype=np.int64)
    np.cumsum(np.bincount(agent, minlength=n), out=own[1:])
    listed = GainMatrix.from_matrix(sp.csr_array((gains[agent, task], task, own), shape=(n, m + n)))
    none = np.full(n, -1)
    # Whoever is left is parked on a task that it gains nothing by; there are enough of them, n being made up.
    tasks, _, _ = assign_and_park(
        listed.row_start, listed.tasks, listed.gains, none, np.zeros(n), np.arange(m + n), False
    )
    beats = tasks < m
    beats[beats] = gains[beats, tasks[beats]] > 0
    return np.where(beats, tasks, rest)


def short_of_room(matrix: FloatArray, room: IntArray) -> str:
    """Which agents are short of tasks."""
    allowed = np.repeat(np.isfinite(matrix), np.minimum(room, len(matrix)), axis=1)
    return explain_infeasible(allowed) or "no full assignment exists within the limits"
