"""The sequential assignment problem as an ordinary mixed-integer programme: a `cvxpy.Problem` to take away.

Booleans ``x[k][i, j]`` say who holds what. A uniform switching cost needs one more number per pair and step, the
share in which the pair was already held; a cost matrix needs the transport between two assignments; any other
agent-local dynamics the product of local state and task.

A `sapopt.formulations.reduction.Formulation`; `recover` also reads the plan of a `cvxpy.Problem` that was solved.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import LocalModel
from sapopt.formulations.highs import Programme
from sapopt.formulations.local import local_model, not_local
from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class MILP:
    """A problem as cvxpy writes it.

    Attributes
    ----------
    problem : cvxpy.Problem
        Maximise the value of the plan. Solve it with any solver that knows integers.
    x : list of T cvxpy.Variable, each of shape (n, m)
    """

    problem: Any
    x: list[Any]

    @cached_property
    def _cones(self) -> Any:
        """The problem in cvxpy's canonical form, minimise ``c @ v + d`` subject to ``A v + b`` in a cone."""
        import cvxpy as cp

        return self.problem.get_problem_data(cp.HIGHS)[0]["param_prob"]

    def programme(self) -> Programme:
        """The same as plain arrays. All its variables are at least 0, the assignments' also at most 1."""
        cost, constant, matrix, right = self._cones.apply_parameters()
        equal = self._cones.cone_dims.zero
        rows = sp.csr_array(matrix)
        low, high = -np.asarray(right), np.full(len(right), np.inf)
        high[:equal] = low[:equal]
        whole = np.zeros(len(cost), dtype=bool)
        for x in self.x:
            first = self._cones.var_id_to_col[x.id]
            whole[first : first + x.size] = True
        upper = np.where(whole, 1.0, np.inf)
        return Programme(-np.asarray(cost), rows, low, high, upper, whole, -float(constant))

    def assignments(self, point: FloatArray) -> list[FloatArray]:
        """Values of `x`, T arrays (n, m), at a point of `programme`; cvxpy stores columns one after another."""
        starts = [self._cones.var_id_to_col[x.id] for x in self.x]
        return [
            point[first : first + x.size].reshape(x.shape, order="F")
            for first, x in zip(starts, self.x, strict=True)
        ]


def refusal(problem: SAP) -> str | None:
    """None, or the reason why the problem cannot be written so."""
    return not_local(problem)


def formulate(problem: SAP, *, relaxed: bool = False) -> MILP:
    """The problem as a `cvxpy.Problem`; with `relaxed`, its linear relaxation.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local.
    """
    import cvxpy as cp  # takes about a second: only those who need it pay for it

    reason = refusal(problem)
    if reason:
        raise ValueError(f"dynamics: {reason}")
    T, n, m = problem.benefits.shape
    x = [cp.Variable((n, m), boolean=not relaxed, name=f"x{k}") for k in range(T)]
    rules: list[Any] = []
    value: Any = 0.0
    for k in range(T):
        worth, forbidden = finite(dense_step(problem.benefits.step(k)))
        rules += [cp.sum(x[k], axis=1) == 1, cp.sum(x[k], axis=0) <= 1, x[k] >= 0]
        if forbidden.any():
            rules.append(cp.multiply(forbidden.astype(float), x[k]) == 0)
        value += cp.sum(cp.multiply(worth, x[k]))
    rule = problem.model.switching()
    if rule is not None:
        if problem.initial_assignment is not None:
            value += cp.sum(cp.multiply(problem.handover(0, problem.initial_state()), x[0]))
        for k in range(1, T):
            charged = np.ones((n, m))
            if rule.idle_is_free:
                charged = (dense_step(problem.benefits.step(k)) > 0).astype(float)
            move = _uniform if rule.uniform_cost is not None else moves_by_matrix
            value += move(cp, x[k - 1], x[k], charged, rule.cost, rules)
    else:
        states = local_model(problem)
        assert states is not None
        value += moves_by_state(cp, problem, states, x, rules)
    return MILP(cp.Problem(cp.Maximize(value), rules), x)


def recover(form: MILP, x: FloatArray | None = None) -> IntArray:
    """Plan (T, n) of a point of ``form.programme()``, or without one, of the `cvxpy.Problem` that was solved.

    Raises
    ------
    ValueError
        If it was not solved.
    """
    if x is not None:
        return np.array([np.argmax(step, axis=1) for step in form.assignments(x)])
    if any(step.value is None for step in form.x):
        raise ValueError(
            f"the programme has no solution to recover a plan from (status {form.problem.status!r})"
        )
    return np.array([np.argmax(step.value, axis=1) for step in form.x])


def finite(benefit: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Benefits with zeros for those of forbidden pairs, and the mask of these pairs."""
    forbidden = np.isneginf(benefit)
    return np.where(forbidden, 0.0, benefit), forbidden


def _uniform(cp: Any, before: Any, now: Any, charged: FloatArray, cost: Any, rules: list[Any]) -> Any:
    kept = cp.Variable(now.shape, nonneg=True)
    rules += [kept <= now, kept <= before]
    return -float(cost) * cp.sum(cp.multiply(charged, now - kept))


def moves_by_matrix(cp: Any, before: Any, now: Any, charged: FloatArray, cost: Any, rules: list[Any]) -> Any:
    """What the moves of a step cost by a matrix, as an expression; its variables are bound to `rules`."""
    value: Any = 0.0
    m = now.shape[1]
    for i in range(now.shape[0]):
        moved = cp.Variable((m, m), nonneg=True)
        rules += [cp.sum(moved, axis=1) == before[i], cp.sum(moved, axis=0) == now[i]]
        value -= cp.sum(cp.multiply(np.asarray(cost) * charged[i][None, :], moved))
    return value


def moves_by_state(cp: Any, problem: SAP, states: LocalModel, x: list[Any], rules: list[Any]) -> Any:
    """Product of local state and task, linked to the state before and the state after."""
    value: Any = 0.0
    S = states.state_count()
    for i in range(problem.n):
        before: Any = np.eye(S)[states.start(i)]
        for k in range(problem.T):
            successor, handover = states.step(k, i, dense_step(problem.benefits.step(k))[i])
            eta, closed = finite(np.array(handover, dtype=np.float64))
            both = cp.Variable((S, problem.m), nonneg=True)
            rules += [cp.sum(both, axis=1) == before, cp.sum(both, axis=0) == x[k][i]]
            if closed.any():
                rules.append(cp.multiply(closed.astype(float), both) == 0)
            value += cp.sum(cp.multiply(eta, both))
            # 0/1 matrices pick the pairs that lead to each state
            onward = np.asarray(successor)
            before = cp.hstack([cp.sum(cp.multiply((onward == s).astype(float), both)) for s in range(S)])
    return value
