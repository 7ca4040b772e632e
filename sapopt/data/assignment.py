"""The assignment problem alpha: from a benefit matrix to the assignment of greatest total benefit.

Backends
--------
``"kernel"``
    Our sparse kernel: shortest augmenting paths over the listed pairs, every agent with a private idle option, idle
    agents then parked. For a `GainMatrix`, and for arrays and sparse matrices without negative entries.
``"scipy-sparse"``
    The same problem through `scipy.sparse.csgraph.min_weight_full_bipartite_matching`.
``"scipy-dense"``
    The same problem through `scipy.optimize.linear_sum_assignment`; for arrays it also takes negative entries and
    forbidden pairs, where idling has no common value.

``"auto"`` takes the kernel wherever its input allows it and the matrix is sparse (at most a quarter of the pairs
positive) and ``"scipy-dense"`` otherwise.

The plan does not depend on the backend: among equally good assignments of positive gain the lexicographically
smallest is taken, and idle agents are then parked in ascending index, each on the first free task of the parking order
(by default the lowest-numbered). Where an idle agent must not take any free task (all of them forbidden or charged),
idling is not free, and the full matrix is solved by ``"scipy-dense"``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import scipy.sparse as sp

from sapopt.data.feasibility import InfeasibleError, explain_infeasible
from sapopt.data.matrices import GainMatrix, Matrix, checked_matrix
from sapopt.data.transport import transported
from sapopt.data.types import FloatArray, IntArray, index_array

Backend = Literal["auto", "kernel", "scipy-sparse", "scipy-dense"]

_SPARSE_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class Assignment:
    """An assignment and its total benefit."""

    tasks: IntArray
    value: float


def assign(
    matrix: Any,
    *,
    backend: Backend = "auto",
    parking: IntArray | None = None,
    capacity: Any = 1,
    idle: bool = False,
) -> IntArray:
    """Assign every agent one task, no task to two agents, at the greatest total benefit (alpha of the thesis).

    Parameters
    ----------
    matrix : ndarray or sparse matrix of shape (n, m), or GainMatrix
        Benefits, n <= m. ``-inf`` forbids a pair (dense only).
    backend : {"auto", "kernel", "scipy-sparse", "scipy-dense"}
        See the module documentation.
    parking : ndarray of int, shape (m,), optional
        Order in which idle agents try the tasks; ascending by default.
    capacity : int or array_like of int, shape (m,)
        How many agents a task may take; 0 closes it. The assignment is then solved by scipy over copies of the tasks.
    idle : bool
        Whether an agent that would gain nothing may be left without a task: -1, worth 0.

    Returns
    -------
    ndarray of int64, shape (n,)
        Task of every agent.

    Raises
    ------
    InfeasibleError
        If forbidden pairs leave no full assignment.
    ValueError
        If the matrix has a wrong shape, NaN or +inf, or the backend cannot take it.
    """
    if backend not in get_args(Backend):
        raise ValueError(f"backend must be one of {', '.join(get_args(Backend))}, got {backend!r}")
    checked = checked_matrix(matrix)
    n, m = checked.shape
    room = checked_room(capacity, m)
    if room is not None or idle:
        if backend != "auto" or parking is not None:
            raise ValueError(
                "backend, parking: they are for one agent to a task; leave them out with capacity or idle"
            )
        dense = checked.toarray() if isinstance(checked, GainMatrix) else checked
        return _with_room(dense, np.ones(m, dtype=np.int64) if room is None else room, idle)
    if n > m:
        raise ValueError(f"{n} agents cannot each have one of {m} tasks; add idle tasks (zero columns)")
    order = _parking_order(parking, m)
    return best_assignment(checked, order, backend).tasks


def _with_room(matrix: FloatArray, room: IntArray, idle: bool) -> IntArray:
    """The assignment where tasks take several agents, and agents may take none."""
    n, m = matrix.shape
    if not idle:
        return transported(matrix, room)
    tasks = transported(np.hstack([matrix, np.zeros((n, 1))]), np.append(room, n))
    gains_nothing = (tasks == m) | (matrix[np.arange(n), np.minimum(tasks, m - 1)] <= 0)
    return np.where(gains_nothing, -1, tasks)


def checked_room(capacity: Any, m: int) -> IntArray | None:
    """Capacities (m,) of one step, None where all are 1.

    Raises
    ------
    ValueError
        If they are no whole numbers of at least 0.
    """
    counts = index_array(capacity, "capacity")
    if counts.shape not in ((), (m,)) or (counts < 0).any():
        raise ValueError(f"capacity must be a whole number of at least 0, or {m} of them, got {capacity!r}")
    return None if (counts == 1).all() else np.broadcast_to(counts, (m,)).copy()


def best_assignment(matrix: Matrix, order: IntArray, backend: Backend = "auto") -> Assignment:
    """`assign` without the checks, with the value; for solvers, which build valid matrices."""
    if not isinstance(matrix, GainMatrix):
        converted = _as_gains(matrix, backend)
        if converted is None:
            return _dense(matrix, order, backend)
        matrix = converted
    chosen: IntArray | None
    if backend in ("auto", "kernel"):
        from sapopt.kernels.matching import assign_and_park

        chosen, gain, parked = assign_and_park(
            matrix.row_start,
            matrix.tasks,
            matrix.gains,
            matrix.held,
            matrix.held_gain,
            order,
            matrix.has_negative,
        )
        if parked:
            return Assignment(chosen, gain + len(chosen) * matrix.rest)
    else:
        from sapopt.kernels.matching import park

        chosen, owner = _scipy_matching(matrix, backend)
        rows = (matrix.row_start, matrix.tasks, matrix.gains, matrix.held, matrix.held_gain)
        if park(*rows, chosen, owner, order, matrix.has_negative):
            return Assignment(chosen, matrix.value(chosen))
    # Idling is not free here: every agent needs a task for which it is not charged, so solve the matrix as it is.
    return _full(matrix.toarray())


def _as_gains(matrix: FloatArray, backend: Backend) -> GainMatrix | None:
    if matrix.size and matrix.min() < 0:
        return None
    if backend == "auto" and np.count_nonzero(matrix) > _SPARSE_SHARE * matrix.size:
        return None
    return GainMatrix.from_matrix(matrix)


def _dense(matrix: FloatArray, order: IntArray, backend: Backend) -> Assignment:
    """A dense array: as it is if it has negative entries, else by gains so that all backends park alike."""
    if matrix.size and matrix.min() < 0:
        if backend not in ("auto", "scipy-dense"):
            raise ValueError(
                f"backend {backend!r} needs a matrix without negative entries; use 'scipy-dense'"
            )
        return _full(matrix)
    return best_assignment(GainMatrix.from_matrix(matrix), order, "scipy-dense")


def _full(matrix: FloatArray) -> Assignment:
    from scipy.optimize import linear_sum_assignment

    try:
        rows, columns = linear_sum_assignment(matrix, maximize=True)
    except ValueError:
        raise InfeasibleError(explain_infeasible(np.isfinite(matrix))) from None
    return Assignment(columns.astype(np.int64), float(matrix[rows, columns].sum()))


def _scipy_matching(matrix: GainMatrix, backend: Backend) -> tuple[IntArray, IntArray]:
    """The matching of positive gains through scipy, brought to the canonical choice among ties."""
    from sapopt.kernels.matching import duals, settle_ties

    n, m = matrix.shape
    weights = GainMatrix(
        matrix.row_start, matrix.tasks, np.maximum(matrix.gains, 0.0),
        matrix.held, np.maximum(matrix.held_gain, 0.0), 0.0, m,
    )  # fmt: skip
    if backend == "scipy-dense":
        from scipy.optimize import linear_sum_assignment

        dense = weights.toarray()
        chosen = linear_sum_assignment(dense, maximize=True)[1].astype(np.int64)
        chosen[dense[np.arange(n), chosen] <= 0] = -1
    else:
        rows = np.repeat(np.arange(n), np.diff(weights.row_start))
        keep = (weights.gains > 0) & (weights.tasks != weights.held[rows])
        holds = np.flatnonzero(weights.held_gain > 0)
        row = np.concatenate([rows[keep], holds, np.arange(n)])
        column = np.concatenate([weights.tasks[keep], weights.held[holds], m + np.arange(n)])
        gain = np.concatenate([weights.gains[keep], weights.held_gain[holds], np.zeros(n)])
        chosen = _heaviest(gain, row, column, (n, m + n))
        chosen[chosen >= m] = -1
    owner = np.full(m, -1)
    owner[chosen[chosen >= 0]] = np.flatnonzero(chosen >= 0)
    rows_of = (weights.row_start, weights.tasks, weights.gains, weights.held, weights.held_gain)
    u, p = duals(*rows_of, chosen, owner)
    settle_ties(*rows_of, chosen, owner, u, p)
    return chosen, owner


def _heaviest(gain: FloatArray, row: IntArray, column: IntArray, shape: tuple[int, int]) -> IntArray:
    """Column of every row in the matching of greatest total gain, by scipy; gains are not negative."""
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    # A power of two changes no bit of a gain, and far from both ends of float64 no sum under- or overflows.
    scaled = np.ldexp(gain, 100 - int(np.frexp(gain.max())[1])) if gain.max() > 0 else gain
    # scipy drops entries of weight zero, so an idle agent gains the least number there is.
    weight = np.maximum(scaled, np.nextafter(0.0, 1.0))
    graph = sp.csr_array((weight, (row, column)), shape=shape)
    found: IntArray = min_weight_full_bipartite_matching(graph, maximize=True)[1].astype(np.int64)
    return found


def _parking_order(parking: IntArray | None, m: int) -> IntArray:
    if parking is None:
        return np.arange(m)
    order = index_array(parking, "parking")
    if order.shape != (m,) or not np.array_equal(np.sort(order), np.arange(m)):
        raise ValueError(f"parking must be a permutation of the {m} tasks")
    return order
