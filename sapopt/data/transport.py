"""Assignments where a task may take several agents."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from sapopt.data.feasibility import InfeasibleError, explain_infeasible
from sapopt.data.matrices import GainMatrix
from sapopt.data.types import FloatArray, IntArray

LARGE = 50_000
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
    if (
        matrix.size >= LARGE
        and rests_beside(np.minimum(room, len(matrix)), rest)
        and room[rest] >= len(matrix)
    ) and np.isfinite(matrix[:, rest]).all():
        return _beside_rest(matrix - matrix[:, rest, None], rest)
    columns = np.repeat(np.arange(len(room)), np.minimum(room, len(matrix)))
    if len(columns) < len(matrix):
        raise InfeasibleError(f"the tasks have room for {len(columns)} of {len(matrix)} agents")
    try:
        _, place = linear_sum_assignment(matrix[:, columns], maximize=True)
    except ValueError:
        raise InfeasibleError(short_of_room(matrix, room)) from None
    return np.asarray(columns[place], dtype=np.int64)


def rests_beside(room: IntArray, rest: int) -> bool:
    """Whether all other tasks than `rest` (-1: there is none) take one agent each."""
    return rest >= 0 and bool((np.delete(room, rest) == 1).all())


def beside_rest(matrix: GainMatrix, rest: int) -> IntArray:
    """`transported` where one task has room for all, and every other one for one, for a sparse matrix."""
    n = len(matrix.held)
    row = np.repeat(np.arange(n), np.diff(matrix.row_start))
    resting = np.zeros(n)  # what resting gains, from the common value of the pairs that are not listed
    at_rest = matrix.tasks == rest
    resting[row[at_rest]] = matrix.gains[at_rest]
    resting = np.where(matrix.held == rest, matrix.held_gain, resting)
    own = (matrix.tasks != matrix.held[row]) & ~at_rest
    holds = np.flatnonzero((matrix.held >= 0) & (matrix.held != rest))
    agent = np.concatenate([row[own], holds])
    task = np.concatenate([matrix.tasks[own], matrix.held[holds]])
    gain = np.concatenate([matrix.gains[own], matrix.held_gain[holds]]) - resting[agent]
    if resting.min(initial=0.0) < 0:  # pairs that are not listed are better than resting
        dense = matrix.toarray()
        return _beside_rest(dense - dense[:, rest, None], rest)
    good = gain > 0
    return _matched(agent[good], task[good], gain[good], (n, matrix.m), rest)


def _beside_rest(gains: FloatArray, rest: int) -> IntArray:
    """The same for an array of what every pair gains over resting: only what is more than nothing matters."""
    agent, task = np.nonzero(gains > 0)
    return _matched(agent, task, gains[agent, task], gains.shape, rest)


def _matched(
    agent: IntArray, task: IntArray, gain: FloatArray, shape: tuple[int, ...], rest: int
) -> IntArray:
    """The matching of greatest gain among some pairs of positive gain, `rest` for whoever is in none."""
    from sapopt.kernels.matching import assign_and_park

    n, m = shape
    pairs = sp.csr_array((gain, (agent, task)), shape=(n, m + n))
    pairs.sort_indices()
    listed = GainMatrix.from_matrix(pairs)
    # Whoever is left is parked on a task that it gains nothing by; there are enough of them, n being made up.
    tasks, _, _ = assign_and_park(
        listed.row_start, listed.tasks, listed.gains, np.full(n, -1), np.zeros(n), np.arange(m + n), False
    )
    key, wanted = agent * (m + n) + task, np.arange(n) * (m + n) + tasks
    return np.where(np.isin(wanted, key), tasks, rest)


def short_of_room(matrix: FloatArray, room: IntArray) -> str:
    """Which agents are short of tasks."""
    allowed = np.repeat(np.isfinite(matrix), np.minimum(room, len(matrix)), axis=1)
    return explain_infeasible(allowed) or "no full assignment exists within the limits"
