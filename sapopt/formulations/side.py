"""A problem as a cvxpy model to which a user adds constraints of their own, each in one line.

    model = open_model(problem)
    answer = model.solve([cp.sum(model.handover[3]) <= 2])

The variables are the plan and its handovers; capacities, idleness, limits, teams and any agent-local dynamics are in
the model. What is proven about it holds for the plans that keep the side constraints, and says nothing of the others:
the answer has that bound apart from the result.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import dense_step
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.bounds import cancellation
from sapopt.formulations.highs import SolverError, objective_factor
from sapopt.formulations.limited.useful import switching_rule
from sapopt.formulations.local import local_model, not_local
from sapopt.formulations.milp import finite, moves_by_matrix, moves_by_state
from sapopt.problem.result import Result, Status
from sapopt.problem.rows import Weights
from sapopt.problem.sap import SAP

_TOLERANCE = 1e-9
"""Relative gap at which HiGHS may stop."""
_PADDING = 1e-6
"""Of a bound, relative to it: HiGHS computes with tolerances of this size."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What a model with side constraints gave.

    Attributes
    ----------
    result : Result
        The plan, scored. Its bound is about the problem itself: None if there are side constraints, for without them
        there may be better plans.
    bound : float or None
        No plan that keeps the side constraints is worth more, as far as the solver's arithmetic goes; None if the
        solver does not tell.
    """

    result: Result
    bound: float | None

    @property
    def gap(self) -> float | None:
        """``(bound - value) / |bound|``, among the plans that keep the side constraints; None without a bound."""
        if self.bound is None:
            return None
        if self.bound == 0:
            return 0.0 if self.result.value == 0 else float("inf")
        return (self.bound - self.result.value) / abs(self.bound)


@dataclass(frozen=True, eq=False)
class OpenModel:
    """A problem as variables, constraints and an objective of cvxpy.

    Attributes
    ----------
    problem : SAP
    x : list of T cvxpy.Variable, each of shape (n, m)
        1 where an agent holds a task, else 0; called ``x_0``, ``x_1``, ...
    handover : list of T cvxpy.Variable or Expression, each of shape (n, m)
        1 where an agent holds a task that it did not hold at the step before, else 0; called ``handover_1``, ... At the
        first step an expression: zero without an initial assignment.
    value : cvxpy.Expression
        Value of the plan.
    constraints : list of cvxpy.Constraint
    """

    problem: SAP
    x: list[Any]
    handover: list[Any]
    value: Any
    constraints: list[Any]

    def programme(self, side: Any = ()) -> Any:
        """The model with side constraints as a ``cvxpy.Problem``, for any solver that knows integers.

        Solve it, and pass `plan` to `Result.from_plan`.
        """
        import cvxpy as cp

        return cp.Problem(cp.Maximize(self.value), [*self.constraints, *_listed(side)])

    def plan(self) -> IntArray:
        """The plan (T, n) of the values that the variables have, -1 for nothing.

        Raises
        ------
        ValueError
            If the model was not solved.
        """
        if any(x.value is None for x in self.x):
            raise ValueError("the model has no solution to read a plan from; solve it first")
        values = np.array([x.value for x in self.x])
        return np.where(values.max(axis=2) > 0.5, values.argmax(axis=2), -1)

    def solve(
        self, side: Any = (), *, time_limit: float | None = None, solver: str = "HIGHS", **options: Any
    ) -> Answer:
        """Solve the model with side constraints.

        Parameters
        ----------
        side : cvxpy.Constraint or list of them
            Constraints on `x`, `handover`, and variables of your own.
        time_limit : float, optional
            Seconds, for HiGHS; then the best plan so far is returned.
        solver : str
            A solver of cvxpy that knows integers. Only HiGHS tells a bound.
        **options
            Passed to the solver.

        Returns
        -------
        Answer

        Raises
        ------
        InfeasibleError
            If no plan keeps the side constraints.
        SolverError
            If the solver finds no plan in time, fails, or does not take the constraints.
        """
        import cvxpy as cp

        extra = _listed(side)
        if time_limit is not None and not 0 < time_limit < float("inf"):
            raise ValueError(f"time_limit must be a positive number of seconds, got {time_limit!r}")
        own = {"mip_rel_gap": _TOLERANCE} if solver == "HIGHS" else {}
        if time_limit is not None:
            if solver != "HIGHS":
                raise ValueError(f"time_limit: pass {solver} the option that it has for it")
            own["time_limit"] = time_limit
        # The tolerances of solvers are absolute, so the objective is brought to a size at which they mean something.
        factor = objective_factor(np.array([self._largest()]))
        programme = cp.Problem(cp.Maximize(factor * self.value), [*self.constraints, *extra])
        try:
            programme.solve(solver=solver, **(own | options))
        except cp.error.SolverError as error:
            raise SolverError(f"{solver}: {error}") from None
        if programme.status in ("infeasible", "infeasible_or_unbounded"):
            raise InfeasibleError("side: no plan keeps all the side constraints")
        if any(x.value is None for x in self.x):
            raise SolverError(f"{solver} found no plan ({programme.status}); give it more time")
        plan = self.plan()
        named = f"cvxpy with {solver}" + (f" and {len(extra)} side constraints" if extra else "")
        score = self.problem.evaluate(plan)
        bound = self._bound(programme, factor, score.value)
        is_proven = bound is not None and programme.status == "optimal" and not extra
        status = (
            Status.OPTIMAL if is_proven else
            Status.FEASIBLE if programme.status == "optimal" else Status.TIME_LIMIT
        )  # fmt: skip
        seconds = float(programme.solver_stats.solve_time or 0.0)
        result = Result(plan, score, status, seconds, named, None if extra else bound, problem=self.problem)
        return Answer(result, bound)

    def _largest(self) -> float:
        """The greatest size of a benefit, or of a cost where those are all zero."""
        size = max(float(np.abs(step[np.isfinite(step)]).max(initial=0.0)) for step in self._steps())
        rule = switching_rule(self.problem.core)
        return size or (0.0 if rule is None else rule.largest_cost)

    def _steps(self) -> Iterable[FloatArray]:
        return (dense_step(self.problem.benefits.step(k)) for k in range(self.problem.T))

    def _bound(self, programme: Any, factor: float, value: float) -> float | None:
        info = programme.solver_stats.extra_stats
        if programme.solver_stats.solver_name != "HIGHS" or info is None:
            return None
        bound = -float(info.mip_dual_bound) / factor
        if not np.isfinite(bound):
            return None
        size = max(abs(bound), min(1.0, self._largest() or 1.0))
        return max(bound, value) + _PADDING * size + cancellation(self.problem.core)


def _listed(side: Any) -> list[Any]:
    import cvxpy as cp

    constraints = [side] if isinstance(side, cp.Constraint) else list(side)
    for number, constraint in enumerate(constraints):
        if not isinstance(constraint, cp.Constraint):
            raise ValueError(
                f"side: entry {number} is {constraint!r}, not a constraint of cvxpy such as cp.sum(model.x[0]) <= 2"
            )
    return constraints


def open_model(problem: SAP) -> OpenModel:
    """The cvxpy model of a problem, to add side constraints to.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local.
    """
    import cvxpy as cp  # takes about a second: only those who need it pay for it

    core = problem.core
    reason = not_local(core)
    if reason:
        raise ValueError(f"dynamics: {reason}")
    T, n, m = problem.T, problem.n, problem.m
    x = [cp.Variable((n, m), boolean=True, name=f"x_{k}") for k in range(T)]
    handover, rules = _handovers(cp, problem, x)
    value: Any = 0.0
    places = []
    for k in range(T):
        worth, closed = finite(dense_step(core.benefits.step(k))[:, :m])
        room = np.ones(m) if problem.capacity is None else problem.capacity[k]
        held = cp.sum(x[k], axis=1)
        rules += [held <= 1 if problem.idle else held == 1, cp.sum(x[k], axis=0) <= room]
        if closed.any():
            rules.append(cp.multiply(closed.astype(float), x[k]) == 0)
        value += cp.sum(cp.multiply(worth, x[k]))
        places.append(cp.hstack([x[k], cp.reshape(1 - held, (n, 1), order="C")]) if problem.idle else x[k])
    value += _moves(cp, problem, places, handover, rules)
    value += _limits(cp, problem, x, handover, rules)
    return OpenModel(problem, x, handover, value, rules)


def _handovers(cp: Any, problem: SAP, x: list[Any]) -> tuple[list[Any], list[Any]]:
    """What every agent takes up, and the rules that make it so: 0/1 wherever the plan is."""
    n, m, initial = problem.n, problem.m, problem.initial_assignment
    out: list[Any] = [cp.Constant(np.zeros((n, m)))]
    if initial is not None:
        free = np.ones((n, m))
        free[np.flatnonzero(initial >= 0), initial[initial >= 0]] = 0.0
        out = [cp.multiply(free, x[0])]
    rules = []
    for k in range(1, problem.T):
        taken = cp.Variable((n, m), nonneg=True, name=f"handover_{k}")
        rules += [taken >= x[k] - x[k - 1], taken <= x[k], taken <= 1 - x[k - 1]]
        out.append(taken)
    return out, rules


def _moves(cp: Any, problem: SAP, places: list[Any], handover: list[Any], rules: list[Any]) -> Any:
    """The handover terms of all steps."""
    core, m = problem.core, problem.m
    rule = switching_rule(core)
    if rule is None:
        states = local_model(core)
        assert states is not None
        return moves_by_state(cp, core, states, places, rules)
    value: Any = 0.0
    if core.initial_assignment is not None:
        first = core.handover(0, core.initial_state())
        value += cp.sum(cp.multiply(first, places[0]))
    for k in range(1, problem.T):
        benefit = dense_step(core.benefits.step(k))
        charged = (benefit > 0).astype(float) if rule.idle_is_free else np.ones(benefit.shape)
        if rule.uniform_cost is not None:
            value -= cp.sum(cp.multiply(rule.uniform_cost * charged[:, :m], handover[k]))
        else:
            value += moves_by_matrix(cp, places[k - 1], places[k], charged, rule.cost, rules)
    return value


def _limits(cp: Any, problem: SAP, x: list[Any], handover: list[Any], rules: list[Any]) -> Any:
    """What limits cost and teams earn; hard limits become rules."""
    rows, (_T, n, m) = problem.rows, (problem.T, problem.n, problem.m)
    value: Any = 0.0
    if rows.count:
        held = _flat(cp, x)
        first = handover[0] if problem.initial_assignment is not None else x[0]
        taken = _flat(cp, [first, *handover[1:]])
        use: Any = _matrix(rows.pair, rows.shape, m, rows.count) @ held
        use += _matrix(rows.taken, rows.shape, m, rows.count) @ taken
        use += _matrix(rows.stayed, rows.shape, m, rows.count) @ (held - taken)
        if len(rows.taken_by.row):
            by = sp.csr_array(
                (rows.taken_by.weight, (rows.taken_by.row, rows.taken_by.agent)), shape=(rows.count, n)
            )
            use += by @ sum(cp.sum(step, axis=1) for step in handover)
        over, under = (cp.Variable(rows.count, nonneg=True) for _ in range(2))
        hard = np.isinf(rows.penalty).astype(float)
        rules += [cp.multiply(hard, over + under) == 0]
        for bound, sign, beyond in ((rows.high, 1.0, over), (rows.low, -1.0, under)):
            told = np.flatnonzero(np.isfinite(bound))
            if len(told):
                rules.append(sign * use[told] - beyond[told] <= sign * bound[told])
        value -= np.where(hard > 0, 0.0, rows.penalty) @ (over + under)
    if len(rows.team_cell):
        earned = cp.Variable(len(rows.team_cell), boolean=True)
        step, task = np.divmod(rows.team_cell, rows.shape[2])
        for number, (k, j) in enumerate(zip(step.tolist(), task.tolist(), strict=True)):
            rules.append(int(rows.team_needs[number]) * earned[number] <= cp.sum(x[k][:, j]))
        value += rows.team_reward @ earned
    return value


def _flat(cp: Any, steps: list[Any]) -> Any:
    return cp.hstack([cp.vec(step, order="C") for step in steps])


def _matrix(weights: Weights, shape: tuple[int, int, int], m: int, count: int) -> sp.csr_array:
    """Weights of rows for the pairs ``(k * n + i) * m + j``."""
    pair, task = np.divmod(weights.cell, shape[2])
    return sp.csr_array(
        (weights.weight, (weights.row, pair * m + task)), shape=(count, shape[0] * shape[1] * m)
    )
