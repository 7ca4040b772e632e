"""The problem as plain arrays, the form which the compiled kernels of this package read."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit
from sapopt.problem.sap import SAP

Rows = namedtuple("Rows", "indptr indices data agents cost matrix idle_is_free")
"""What the kernels know of a problem, the fields of `Arrays` of these names: compressed sparse rows ``(indptr, indices,
data)``, of which row ``k * agents + i`` holds the benefits of agent i at step k; ``cost``, a number, or where it is not
empty ``matrix`` (m, m), the cost of every move; and whether a move to a task without benefit is free."""


@dataclass(frozen=True)
class Arrays:
    """A sequential assignment problem with switching costs, flattened.

    Row ``k * n + i`` of the compressed sparse rows ``(indptr, indices, data)`` holds the benefits of agent ``i`` at
    step ``k``; entries that are not stored are 0, and -inf forbids a pair.

    Attributes
    ----------
    matrix : (m, m) or (0, 0)
        Cost of each move; empty when every move costs ``cost``.
    initial : (n,)
        The assignment before the first step, or -1 where the first step is free.
    """

    indptr: IntArray
    indices: npt.NDArray[np.int32]
    data: FloatArray
    steps: int
    agents: int
    tasks: int
    cost: float
    matrix: FloatArray
    idle_is_free: bool
    initial: IntArray

    @classmethod
    def of(cls, problem: SAP) -> Arrays:
        """Read a problem.

        Raises
        ------
        ValueError
            If its dynamics is not a `SwitchingCost`.
        """
        rule = problem.model.switching()
        if rule is None:
            raise ValueError(
                f"dynamics: {problem.model.called} has no plan improvement here, DualDecomposition needs a "
                "SwitchingCost; bound(problem) and DualLookahead serve other dynamics"
            )
        flat = problem.benefits.flat()
        return cls(
            flat.indptr,
            flat.indices,
            flat.data,
            problem.T,
            problem.n,
            problem.m,
            rule.uniform_cost or 0.0,
            np.ascontiguousarray(rule.cost, dtype=np.float64)
            if rule.uniform_cost is None
            else np.zeros((0, 0)),
            rule.idle_is_free,
            np.full(problem.n, -1) if problem.initial_assignment is None else problem.initial_assignment,
        )

    @property
    def rows(self) -> Any:
        """The problem as the kernels take it, a `Rows`."""
        return Rows(
            self.indptr, self.indices, self.data, self.agents, self.cost, self.matrix, self.idle_is_free
        )

    def value(self, plan: IntArray) -> float:
        """Return the total benefit less the handover costs of ``plan`` (T, n)."""
        return float(agent_values(self.rows, self.initial, plan).sum())

    def agent_values(self, plan: IntArray) -> FloatArray:
        """Return each agent's share (n,) of the value of ``plan`` (T, n)."""
        values: FloatArray = agent_values(self.rows, self.initial, plan)
        return values


@njit(cache=True, inline="always")
def lookup(rows, k, i, j):  # type: ignore[no-untyped-def]
    """Return the benefit of agent i on task j at step k."""
    row = k * rows.agents + i
    lo, hi = rows.indptr[row], rows.indptr[row + 1]
    while lo < hi:
        mid = (lo + hi) >> 1
        if rows.indices[mid] < j:
            lo = mid + 1
        else:
            hi = mid
    if lo < rows.indptr[row + 1] and rows.indices[lo] == j:
        return rows.data[lo]
    return 0.0


@njit(cache=True, inline="always")
def move_cost(rows, a, b, benefit):  # type: ignore[no-untyped-def]
    """Return the cost of a move from task a (-1: none) to task b, whose benefit at the new step is given."""
    if a == b or a < 0:
        return 0.0
    if rows.idle_is_free and not benefit > 0.0:
        return 0.0
    return rows.matrix[a, b] if rows.matrix.shape[0] > 0 else rows.cost


@njit(cache=True)
def agent_values(rows, initial, plan):  # type: ignore[no-untyped-def]
    """Return the value of each agent's path (n,)."""
    values = np.zeros(plan.shape[1])
    for i in range(plan.shape[1]):
        previous = initial[i]
        for k in range(plan.shape[0]):
            benefit = lookup(rows, k, i, plan[k, i])
            values[i] += benefit - move_cost(rows, previous, plan[k, i], benefit)
            previous = plan[k, i]
    return values
