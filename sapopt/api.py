"""The face of the library: solve a problem, bound it, certify a result."""

from __future__ import annotations

import logging
import numbers
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

from sapopt.data.types import FloatArray
from sapopt.formulations.bounds import cancellation, dual_bound, stepwise_bound
from sapopt.formulations.limited.bounds import limited_bound
from sapopt.formulations.limited.building import TooLargeError
from sapopt.formulations.limited.disturbed import needs_limits, undisturbed
from sapopt.problem.result import Result, Status
from sapopt.problem.sap import SAP
from sapopt.proofs.certificate import Bound, Certificate, CertificateError, prove
from sapopt.running.control import Callback, Run, interruptible
from sapopt.running.outlook import Forecast, Policy
from sapopt.running.rollout import rollout
from sapopt.solvers.base import Outcome, Planner, Solver, gap_unit, untaken

log = logging.getLogger(__name__)

_OPTIMAL = 1e-7  # relative: what a plan that counts as optimal may lack because of rounding


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
        Seconds; when they are over the best plan so far is returned. Compiling kernels, at the first call on a
        machine, does not count; the log says how long it took.
    progress : bool
        Show a progress bar on standard error.
    callback : callable, optional
        Called with a `Progress`; returning True ends the run with its incumbent.
    forecast : callable, optional
        For policies: what they see of the future, see `sapopt.running.outlook.Forecast`. The plan is always played
        and scored on the true benefits.
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
    _check_common(problem, time_limit, seed)
    if isinstance(solver, type):
        raise ValueError(f"solver: pass an instance, such as {solver.__name__}(...), not the class")
    is_policy = isinstance(solver, Policy)
    if not is_policy and not isinstance(solver, Planner):
        raise ValueError(f"solver must be a policy or a planner such as HAAL(lookahead=3), got {solver!r}")
    if is_policy and start is not None:
        raise ValueError(f"start: {solver.name} decides step by step and takes no plan to start from")
    if not is_policy and forecast is not None:
        raise ValueError(f"forecast: {solver.name} plans the whole horizon and takes no forecast")
    lacking = untaken(problem, solver)
    if lacking:
        raise ValueError(
            f"solver: {solver.name} does not take problems with {' and '.join(lacking)}; DualDecomposition and "
            "Exact take all of them"
        )
    plan = None if start is None else problem.check_plan(start.plan if isinstance(start, Result) else start)
    if plan is not None and not problem.is_plain:
        problem.evaluate(plan)  # a plan that breaks a hard limit is none to start from
        plan = problem.placed(plan)
    core = problem.core
    with _display(progress, solver.name, callback) as report:
        run = Run(seed, time_limit, report, plan)
        with interruptible(run):
            if isinstance(solver, Policy):
                played = rollout(core, solver, run, forecast)
                outcome = Outcome(played.plan, played.status, trace=played.trace)
            else:
                hidden = cancellation(
                    core
                )  # first, for it may take long, and the planner keeps to what time is left
                outcome = _padded(core, solver.plan(core, run), hidden)
        runtime = run.seconds
    _tell_compiling(run)
    plan = problem.unplaced(outcome.plan)
    columns = problem.model.price_columns(problem.n, problem.m)
    prices = None if outcome.prices is None else outcome.prices[:, :columns]
    return Result(
        plan, problem.evaluate(plan), outcome.status, runtime, solver.name, outcome.bound, outcome.trace, seed,
        prices, problem, outcome.limit_prices, outcome.team_prices,
    )  # fmt: skip


def _padded(problem: SAP, outcome: Outcome, hidden: float) -> Outcome:
    """What a planner proved, with what rounding may have hidden from it; a proof of optimality may not survive that."""
    if outcome.bound is None or hidden == 0.0:
        return outcome
    is_proven = hidden <= _OPTIMAL * max(abs(outcome.bound), gap_unit(problem))
    status = Status.FEASIBLE if outcome.status is Status.OPTIMAL and not is_proven else outcome.status
    return replace(outcome, bound=outcome.bound + hidden, status=status)


def _tell_compiling(run: Run) -> None:
    """Say what the clock of a run has left out."""
    if run.compile_seconds > 0.0:
        log.info(
            "%.1f s went into compiling kernels, besides the %.1f s of the run",
            run.compile_seconds,
            run.seconds,
        )


def _display(progress: bool, name: str, callback: Callback | None) -> AbstractContextManager[Callback | None]:
    if not progress:
        return nullcontext(callback)
    from sapopt.running.display import progress_bar

    return progress_bar(name, callback)


def bound(
    problem: SAP,
    *,
    time_limit: float | None = None,
    progress: bool = False,
    callback: Callback | None = None,
    prices: FloatArray | None = None,
    seed: int = 0,
    device: str = "cpu",
) -> Bound:
    """A proven upper bound of the optimal value of this very problem.

    For agent-local dynamics (every `SwitchingCost`) and copies of agents the Lagrangian dual of the task capacities is
    minimised (`sapopt.formulations.dual`); for others the sum over the steps of alpha(beta_k) is taken. Limits, teams,
    and tasks that disturb each other (`sapopt.dynamics.Interference`) have multipliers in the same dual
    (docs/limits.md).

    Parameters
    ----------
    problem : SAP
    time_limit : float, optional
        Seconds; the best bound so far is returned, and it is as valid as any.
    progress : bool
        Show progress on standard error.
    callback : callable, optional
        Called with a `Progress`; returning True ends the run.
    prices : ndarray, shape (T, m), optional
        Prices to start from, for example those of an earlier bound (of shape (T, m + n) for copies of agents).
    seed : int
    device : str
        Where the agents' paths are computed: "cpu" (compiled kernels), or a torch device such as "cuda", see
        `sapopt.dynamics.switching.torch_paths`.

    Returns
    -------
    Bound

    Raises
    ------
    ValueError
        If nothing can be proven about the dynamics (the message says what it has to declare), or the device is not
        available or does not take the dynamics.
    ImportError
        If the device needs torch and it is not installed.
    """
    _check_common(problem, time_limit, seed)
    with _display(progress, "bound", callback) as report:
        run = Run(seed, time_limit, report)
        with interruptible(run):
            if needs_limits(problem):
                proven = _limited(problem, run, prices, device)
            elif not problem.model.takes_prices:
                proven = stepwise_bound(problem, run)
            else:
                proven = dual_bound(problem, run, prices, device)
    _tell_compiling(run)
    return proven


def _limited(problem: SAP, run: Run, prices: FloatArray | None, device: str) -> Bound:
    """The bound with limits and losses; without the losses where the graph would be too large for nothing but them."""
    try:
        return limited_bound(problem, run, prices)
    except TooLargeError:
        if not problem.is_plain:
            raise
        log.warning("bound: too many arcs for the losses of tasks that disturb each other; they are left out")
        return dual_bound(undisturbed(problem), run, prices, device)


def certify(
    problem: SAP,
    result: Result,
    *,
    prices: FloatArray | None = None,
    time_limit: float | None = None,
    progress: bool = False,
) -> Certificate:
    """Prove how far a result is from the optimum, in a form that anyone can check with `verify`.

    Parameters
    ----------
    problem : SAP
    result : Result
    prices : ndarray, shape (T, m), optional
        Task prices that prove a bound; by default those of the result, and if it has none those of `bound`.
    time_limit : float, optional
        Seconds for `bound`, if it has to be computed.
    progress : bool
        Show progress on standard error.

    Returns
    -------
    Certificate
        Value and bound computed from the definitions.

    Raises
    ------
    CertificateError
        If the plan does not fit the problem, or the dynamics is not agent-local.
    """
    if prices is None:
        prices = result.prices
    limits, teams = result.limit_prices, result.team_prices
    if prices is None or (not problem.is_plain and limits is None):
        proven = bound(problem, time_limit=time_limit, progress=progress, prices=prices)
        prices, limits, teams = proven.prices, proven.limit_prices, proven.team_prices
    if prices is None:
        raise CertificateError(
            f"dynamics: {problem.model.called} is not agent-local, so no prices prove a bound"
        )
    return prove(problem, result.plan, prices, result.solver, limits, teams)


def _check_common(problem: SAP, time_limit: float | None, seed: int) -> None:
    if not isinstance(problem, SAP):
        raise ValueError(
            f"problem must be a SAP, got {type(problem).__name__}; build one with SAP(benefits, cost)"
        )
    if time_limit is not None and not (isinstance(time_limit, numbers.Real) and time_limit > 0):
        raise ValueError(f"time_limit must be a positive number of seconds, got {time_limit!r}")
    if not isinstance(seed, numbers.Integral) or seed < 0:
        raise ValueError(f"seed must be a whole number of at least 0, got {seed!r}")
