"""The verbs of the library: solve a problem, bound it."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from sapopt.assignment import best_assignment
from sapopt.benefits import dense_step
from sapopt.certificate import Bound
from sapopt.control import Callback, Run
from sapopt.matrices import GainMatrix
from sapopt.outlook import Forecast, Policy, rollout
from sapopt.problem import SAP
from sapopt.result import Result
from sapopt.solvers.base import Outcome, Planner, Solver
from sapopt.types import FloatArray


def solve(
    problem: SAP,
    solver: Solver,
    *,
    seed: int = 0,
    time_limit: float | None = None,
    progress: bool = False,
    callback: Callback | None = None,
    forecast: Forecast | None = None,
    start: Any = None,
) -> Result:
    """Solve a problem with one method.

    Parameters
    ----------
    problem : SAP
    solver : Policy or Planner
        For example ``HAAL(lookahead=6)``.
    seed : int
        Seed of everything random in the solver.
    time_limit : float, optional
        Seconds; when they are over the best plan so far is returned.
    progress : bool
        Show a progress bar on standard error.
    callback : callable, optional
        Called with a `Progress`; returning True ends the run with its incumbent.
    forecast : callable, optional
        For policies: what they see of the future, see `sapopt.outlook.Forecast`. The plan is always played and scored
        on the true benefits.
    start : array_like of shape (T, n) or Result, optional
        For planners: a plan to start from; the result is never worse.

    Returns
    -------
    Result
        Checked and scored by `SAP.evaluate`.

    Raises
    ------
    ValueError
        If an argument does not fit the problem or the solver.
    """
    if time_limit is not None and not time_limit > 0:
        raise ValueError(f"time_limit must be a positive number of seconds, got {time_limit!r}")
    is_policy = isinstance(solver, Policy)
    if not is_policy and not isinstance(solver, Planner):
        raise ValueError(f"solver must be a policy or a planner such as HAAL(lookahead=3), got {solver!r}")
    if is_policy and start is not None:
        raise ValueError(f"start: {solver.name} decides step by step and takes no plan to start from")
    if not is_policy and forecast is not None:
        raise ValueError(f"forecast: {solver.name} plans the whole horizon and takes no forecast")
    plan = None if start is None else problem.check_plan(start.plan if isinstance(start, Result) else start)
    with _display(progress, solver.name, callback) as report:
        run = Run(seed, time_limit, report, plan)
        if isinstance(solver, Policy):
            played = rollout(problem, solver, run, forecast)
            outcome = Outcome(played.plan, played.status, trace=played.trace)
        else:
            outcome = solver.plan(problem, run)
        runtime = run.seconds
    return Result(
        outcome.plan, problem.evaluate(outcome.plan), outcome.status, runtime, solver.name, outcome.bound,
        outcome.trace, seed, outcome.prices,
    )  # fmt: skip


def _display(progress: bool, name: str, callback: Callback | None) -> AbstractContextManager[Callback | None]:
    if not progress:
        return nullcontext(callback)
    from sapopt.display import progress_bar

    return progress_bar(name, callback)


def stepwise_bound(problem: SAP) -> Bound:
    """The sum over the steps of alpha(beta_k): what could be had if no handover ever cost anything.

    Raises
    ------
    ValueError
        If the dynamics does not declare the largest entry that its handover matrix can have (``handover_limit``;
        0 for costs), without which nothing is proven.
    """
    limit = getattr(problem.dynamics, "handover_limit", None)
    if limit is None:
        raise ValueError(
            f"dynamics: {type(problem.dynamics).__name__} must declare handover_limit, the largest entry its handover "
            "matrix can have (0.0 for costs), or path_oracle, before anything can be proven"
        )
    order = np.arange(problem.m)
    total = 0.0
    for k in range(problem.T):
        total += best_assignment(_matrix(problem, k), order).value
    padding = 1e-12 * max(1.0, abs(total))
    return Bound(total + problem.T * problem.n * float(limit) + padding, None, "sum of alpha(beta_k)")


def _matrix(problem: SAP, k: int) -> Any:
    step = problem.benefits.step(k)
    if isinstance(step, np.ndarray) or (step.nnz and step.data.min() < 0):
        dense: FloatArray = dense_step(step)
        return dense
    return GainMatrix.from_matrix(step)


def bound(problem: SAP) -> Bound:
    """A proven upper bound of the optimal value of this very problem."""
    return stepwise_bound(problem)
