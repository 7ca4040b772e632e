"""Robust relatives of the assignment problem (thesis, section 1.4) as `cvxpy` problems.

`RobustAssignment` (eq. 1.5) takes the assignment whose worst value over a finite set of benefit matrices is
greatest. `RecoverableAssignment` chooses a first assignment, and for every matrix that may come a second one that
shares at least k pairs with it; with a single second matrix this is the recoverable robust assignment problem, and
the Lagrangian relaxation of its sharing rule is a sequential assignment problem of two steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sapopt.data.feasibility import InfeasibleError, explain_infeasible
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import SolverError


@dataclass(frozen=True, eq=False)
class Compiled:
    """A robust problem as a `cvxpy.Problem`.

    Attributes
    ----------
    problem : cvxpy.Problem
        Maximise the worst value.
    x : list of cvxpy.Variable, each of shape (n, m)
        The assignments: the one to decide now, then one per scenario where there is recovery.
    """

    problem: Any
    x: list[Any]

    def recover(self) -> list[IntArray]:
        """The assignments (n,) of a solved problem."""
        if any(part.value is None for part in self.x):
            raise ValueError(f"the programme has no solution to recover (status {self.problem.status!r})")
        return [np.argmax(part.value, axis=1) for part in self.x]


@dataclass(frozen=True, eq=False)
class RobustAssignment:
    """``max over assignments x, min over s, of sum_ij matrices[s][i, j] x[i, j]`` (thesis, eq. 1.5).

    Parameters
    ----------
    matrices : array_like of shape (scenarios, n, m)
        Benefits that may come, n <= m; -inf forbids a pair.

    Raises
    ------
    ValueError
        If the matrices are not of this form.
    """

    matrices: Any

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrices", _matrices(self.matrices, "matrices"))

    def value(self, assignment: Any) -> float:
        """Worst value of an assignment (n,)."""
        tasks = _assignment(assignment, self.matrices.shape, "assignment")
        return float(self.matrices[:, np.arange(len(tasks)), tasks].sum(axis=1).min())

    def formulate(self) -> Compiled:
        """The problem in its epigraph form."""
        import cvxpy as cp

        x, rules = _assignment_variable(cp, np.isfinite(self.matrices).all(axis=0), "x")
        worst = cp.Variable(name="worst")
        rules += [worst <= _worth(cp, matrix, x) for matrix in self.matrices]
        return Compiled(cp.Problem(cp.Maximize(worst), rules), [x])

    def solve(self) -> tuple[IntArray, float]:
        """A best assignment (n,) and its worst value."""
        reason = explain_infeasible(np.isfinite(self.matrices).all(axis=0))
        if reason:
            raise InfeasibleError(f"matrices: {reason}; a pair that one scenario forbids cannot be used")
        (tasks,) = _solved(self.formulate())
        return tasks, self.value(tasks)


@dataclass(frozen=True, eq=False)
class RecoverableAssignment:
    """``max first(x) + min_s max second[s](y_s)`` over assignments x and y_s with at least `shared` pairs in common.

    Parameters
    ----------
    first : array_like of shape (n, m)
        Benefits of the assignment decided now.
    second : array_like of shape (n, m) or (scenarios, n, m)
        Benefits of the recovered assignments.
    shared : int
        Pairs that every recovered assignment shares with the first, 0 .. n.

    Raises
    ------
    ValueError
        If an argument is not of this form.
    """

    first: Any
    second: Any
    shared: int

    def __post_init__(self) -> None:
        first = _matrices(np.asarray(self.first, dtype=np.float64)[None], "first")[0]
        second = np.asarray(self.second, dtype=np.float64)
        second = _matrices(second[None] if second.ndim == 2 else second, "second")
        if second.shape[1:] != first.shape:
            raise ValueError(
                f"second holds matrices of shape {second.shape[1:]}, but first has {first.shape}"
            )
        if int(self.shared) != self.shared or not 0 <= self.shared <= first.shape[0]:
            raise ValueError(
                f"shared must be a whole number of pairs, 0 .. {first.shape[0]}, got {self.shared!r}"
            )
        object.__setattr__(self, "first", first)
        object.__setattr__(self, "second", second)

    @classmethod
    def after(cls, previous: Any, benefits: Any, shared: int) -> RecoverableAssignment:
        """The second stage alone, as in section 1.4 of the thesis: the first assignment is given.

        Parameters
        ----------
        previous : array_like of int, shape (n,)
            The assignment of the first stage.
        benefits : array_like of shape (n, m) or (scenarios, n, m)
        shared : int
            Pairs that the new assignment shares with `previous` at least.
        """
        second = np.asarray(benefits, dtype=np.float64)
        if second.ndim not in (2, 3):
            raise ValueError(f"benefits must have shape (n, m) or (scenarios, n, m), got {second.shape}")
        tasks = _assignment(previous, second.shape, "previous")
        first = np.full(second.shape[-2:], -np.inf)
        first[np.arange(len(tasks)), tasks] = 0.0
        return cls(first, second, shared)

    def value(self, now: Any, recovered: Sequence[Any]) -> float:
        """Value of a first assignment and its recoveries, one per scenario; ValueError if they share too few pairs."""
        agents = np.arange(self.first.shape[0])
        x = _assignment(now, self.first.shape, "now")
        if len(recovered) != len(self.second):
            raise ValueError(f"recovered holds {len(recovered)} assignments for {len(self.second)} scenarios")
        worth = []
        for s, choice in enumerate(recovered):
            y = _assignment(choice, self.first.shape, f"recovered[{s}]")
            if (x == y).sum() < self.shared:
                raise ValueError(f"recovered[{s}] shares {(x == y).sum()} pairs, fewer than {self.shared}")
            worth.append(float(self.second[s, agents, y].sum()))
        return float(self.first[agents, x].sum()) + min(worth)

    def formulate(self) -> Compiled:
        """The problem with one number per shared pair."""
        import cvxpy as cp

        x, rules = _assignment_variable(cp, np.isfinite(self.first), "x")
        worst = cp.Variable(name="worst")
        parts = [x]
        for s, matrix in enumerate(self.second):
            y, more = _assignment_variable(cp, np.isfinite(matrix), f"y{s}")
            common = cp.Variable(matrix.shape, nonneg=True, name=f"common{s}")
            rules += [*more, common <= x, common <= y, cp.sum(common) >= self.shared]
            rules.append(worst <= _worth(cp, matrix, y))
            parts.append(y)
        return Compiled(cp.Problem(cp.Maximize(_worth(cp, self.first, x) + worst), rules), parts)

    def solve(self) -> tuple[IntArray, list[IntArray], float]:
        """The first assignment, the recovered ones, and the value."""
        for name, matrix in [
            ("first", self.first),
            *((f"second[{s}]", b) for s, b in enumerate(self.second)),
        ]:
            reason = explain_infeasible(np.isfinite(matrix))
            if reason:
                raise InfeasibleError(f"{name}: {reason}")
        now, *recovered = _solved(self.formulate())
        return now, recovered, self.value(now, recovered)


def _solved(compiled: Compiled) -> list[IntArray]:
    import cvxpy as cp

    try:
        compiled.problem.solve(solver=cp.HIGHS, mip_rel_gap=1e-9)
    except cp.error.SolverError as error:
        raise SolverError(f"HiGHS failed through cvxpy: {error}") from None
    if compiled.problem.status in ("infeasible", "infeasible_or_unbounded"):
        raise InfeasibleError(
            "forbidden pairs leave no assignments that share enough pairs; ask for fewer shared pairs"
        )
    return compiled.recover()


def _matrices(values: Any, name: str) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 3 or 0 in array.shape or array.shape[1] > array.shape[2]:
        raise ValueError(
            f"{name} must be matrices of one shape (n, m) with 0 < n <= m, got an array of shape {array.shape}"
        )
    if np.isnan(array).any() or np.isposinf(array).any():
        raise ValueError(f"{name} contains NaN or +inf; use -inf for a forbidden pair")
    return array


def _assignment(values: Any, shape: tuple[int, ...], name: str) -> IntArray:
    n, m = shape[-2:]
    tasks = np.asarray(values)
    if tasks.shape != (n,) or tasks.dtype.kind not in "iu" or tasks.min() < 0 or tasks.max() >= m:
        raise ValueError(f"{name} must hold the task of each of {n} agents, whole numbers 0 .. {m - 1}")
    if len(np.unique(tasks)) < n:
        raise ValueError(f"{name} gives one task to two agents")
    return tasks.astype(np.int64)


def _assignment_variable(cp: Any, allowed: np.ndarray, name: str) -> tuple[Any, list[Any]]:
    x = cp.Variable(allowed.shape, boolean=True, name=name)
    rules = [cp.sum(x, axis=1) == 1, cp.sum(x, axis=0) <= 1]
    if not allowed.all():
        rules.append(cp.multiply((~allowed).astype(float), x) == 0)
    return x, rules


def _worth(cp: Any, matrix: FloatArray, x: Any) -> Any:
    return cp.sum(cp.multiply(np.where(np.isfinite(matrix), matrix, 0.0), x))
