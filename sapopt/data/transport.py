"""Assignments where a task may take several agents."""

from __future__ import annotations

import numpy as np

from sapopt.data.feasibility import InfeasibleError, explain_infeasible
from sapopt.data.types import FloatArray, IntArray


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

    columns = np.repeat(np.arange(len(room)), np.minimum(room, len(matrix)))
    if len(columns) < len(matrix):
        raise InfeasibleError(f"the tasks have room for {len(columns)} of {len(matrix)} agents")
    try:
        _, place = linear_sum_assignment(matrix[:, columns], maximize=True)
    except ValueError:
        raise InfeasibleError(short_of_room(matrix, room)) from None
    return np.asarray(columns[place], dtype=np.int64)


def short_of_room(matrix: FloatArray, room: IntArray) -> str:
    """Which agents are short of tasks."""
    allowed = np.repeat(np.isfinite(matrix), np.minimum(room, len(matrix)), axis=1)
    return explain_infeasible(allowed) or "no full assignment exists within the limits"
