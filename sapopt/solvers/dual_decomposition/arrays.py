"""The problem as plain arrays, the form which the compiled kernels of this package read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.problem.sap import SAP

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


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

    indptr: Ints
    indices: npt.NDArray[np.int32]
    data: Floats
    steps: int
    agents: int
    tasks: int
    cost: float
    matrix: Floats
    idle_is_free: bool
    initial: Ints

    @classmethod
    def of(cls, problem: SAP) -> Arrays:
        """Read a problem.

        Raises
        ------
        ValueError
            If its dynamics is not a `SwitchingCost`.
        """
        dynamics = problem.dynamics
        if not isinstance(dynamics, SwitchingCost):
            raise ValueError(
                f"dynamics: {type(dynamics).__name__} has no plan improvement here, DualDecomposition needs a "
                "SwitchingCost; bound(problem) and DualLookahead serve other dynamics"
            )
        flat = problem.benefits.flat()
        number = dynamics.is_uniform
        return cls(
            flat.indptr,
            flat.indices,
            flat.data,
            problem.T,
            problem.n,
            problem.m,
            float(dynamics.cost) if number else 0.0,
            np.zeros((0, 0)) if number else np.ascontiguousarray(dynamics.cost, dtype=np.float64),
            dynamics.idle_is_free,
            np.full(problem.n, -1) if problem.initial_assignment is None else problem.initial_assignment,
        )

    @property
    def kernel(self) -> tuple[Ints, npt.NDArray[np.int32], Floats, int, float, Floats, bool]:
        """The arguments that every kernel starts with."""
        return self.indptr, self.indices, self.data, self.agents, self.cost, self.matrix, self.idle_is_free

    def value(self, plan: Ints) -> float:
        """Return the total benefit less the handover costs of ``plan`` (T, n)."""
        return float(agent_values(self.kernel, self.initial, plan).sum())

    def agent_values(self, plan: Ints) -> Floats:
        """Return each agent's share (n,) of the value of ``plan`` (T, n)."""
        values: Floats = agent_values(self.kernel, self.initial, plan)
        return values


@njit(cache=True, inline="always")
def lookup(kernel, k, i, j):  # type: ignore[no-untyped-def]
    """Return the benefit of agent i on task j at step k."""
    indptr, indices, data, n = kernel[0], kernel[1], kernel[2], kernel[3]
    lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
    while lo < hi:
        mid = (lo + hi) // 2
        if indices[mid] < j:
            lo = mid + 1
        else:
            hi = mid
    if lo < indptr[k * n + i + 1] and indices[lo] == j:
        return data[lo]
    return 0.0


@njit(cache=True, inline="always")
def move_cost(kernel, a, b, benefit):  # type: ignore[no-untyped-def]
    """Return the cost of a move from task a (-1: none) to task b, whose benefit at the new step is given."""
    if a == b or a < 0:
        return 0.0
    if kernel[6] and not benefit > 0.0:
        return 0.0
    return kernel[5][a, b] if kernel[5].shape[0] > 0 else kernel[4]


@njit(cache=True)
def agent_values(kernel, initial, plan):  # type: ignore[no-untyped-def]
    """Return the value of each agent's path (n,)."""
    values = np.zeros(plan.shape[1])
    for i in range(plan.shape[1]):
        previous = initial[i]
        for k in range(plan.shape[0]):
            benefit = lookup(kernel, k, i, plan[k, i])
            values[i] += benefit - move_cost(kernel, previous, plan[k, i], benefit)
            previous = plan[k, i]
    return values
