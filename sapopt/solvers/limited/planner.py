"""The planner of problems with capacities, limits and teams: prices first, then programmes over what they leave.

The dual gives a bound and, for every arc of an agent's graph, how much a plan loses that uses it. A plan that uses an
arc of loss d is worth at most the bound less d, so arcs of a loss above the gap cannot matter. Programmes over the arcs
of small loss find plans; when the loss allowed has reached the gap, the plan is proven.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import Ending, SolverError, maximise
from sapopt.formulations.limited.ascent import Ascent
from sapopt.formulations.limited.building import path_graph, tightened
from sapopt.formulations.limited.conflict import explain
from sapopt.formulations.limited.disturbed import untangled
from sapopt.formulations.limited.dual import LimitedDual, Prices
from sapopt.formulations.limited.graph import PathGraph
from sapopt.formulations.limited.programme import limited_programme
from sapopt.formulations.limited.useful import tidied
from sapopt.kernels import clock
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.running.rollout import rollout
from sapopt.solvers.base import Outcome, gap_unit
from sapopt.solvers.iterated import IteratedAssignment
from sapopt.solvers.limited.dive import dive
from sapopt.solvers.limited.neighbourhoods import improved, worth
from sapopt.solvers.limited.rolling import rolling_plan

_DUAL_SHARE = 0.35
"""Share of the time that the first ascents may take."""
_REACTION_SHARE = 0.1
"""Share of the time for a first plan of a problem in which tasks disturb each other."""
_FIRST_LOSS = 0.05
"""Loss of the arcs of the first programme, relative to the typical gain; each further one takes four times as much."""
_SMALL = 3000
"""Arcs up to which programmes over the whole horizon need no plan to start from."""
_ELASTIC = 10.0
"""What breaking a hard limit costs on the way to a plan, in typical gains, besides twice the dearest multiplier."""
_PART_ARCS = 200_000
"""Arcs of least loss to which the search by parts keeps, where there are more."""
_DIVE_LOSS = 0.5
"""Loss of the arcs that a dive looks at, in typical gains."""
_DIVE_SHARE = 0.4
"""Share of the time left that a dive may take."""
_PART_SHARE = 0.7
"""Share of the time left for improving the plan part by part,"""
_WHOLE_SHARE, _WHOLE_ARCS = 0.2, 100_000
"""and the share where there are so few arcs that a programme of all of them may well be solved."""
_NEARLY_ALL = 0.5
"""Share of the arcs that can matter from which on a programme may as well have all of them, and prove what it finds."""
_EXACT = {"mip_feasibility_tolerance": 1e-9, "primal_feasibility_tolerance": 1e-9}
"""By how much a point may miss its rows: what HiGHS gains by the usual 1e-6 of a soft limit is above the gap."""
_PROGRAMME_SHARE = 0.5
"""Share of the time left that one programme may take, unless it is the last."""


@dataclass
class Search:
    """What is known so far."""

    problem: SAP
    run: Run
    name: str
    tolerance: float
    best: IntArray | None = None
    value: float = -np.inf
    bound: float = np.inf
    trace: list[dict[str, Any]] = field(default_factory=list)

    def offer(self, plan: IntArray, phase: str) -> None:
        """Keep a plan if it is the best; one that breaks a limit by rounding is none."""
        try:
            value = self.problem.evaluate(plan).value
        except ValueError:
            return
        if value > self.value or (value == self.value and phase == "start"):
            self.best, self.value = plan, value
        self.note(phase)

    def note(self, phase: str) -> None:
        """A line for the trace."""
        bound = float(self.bound) if np.isfinite(self.bound) else None
        self.trace.append({"seconds": self.run.seconds, "phase": phase, "value": self.value, "bound": bound})

    @property
    def is_proven(self) -> bool:
        """Whether the gap is within the tolerance."""
        return self.bound - self.value <= self.slack

    @property
    def slack(self) -> float:
        """What the gap may be."""
        return self.tolerance * max(gap_unit(self.problem), abs(self.value)) if self.best is not None else 0.0

    def report(self, value: float, bound: float) -> bool:
        """Tell of the run; whether it is to stop."""
        best, least = max(self.value, value), min(self.bound, bound)
        limit = self.run.time_limit or 0.0
        return self.run.report(
            self.run.seconds, limit, best, least if np.isfinite(least) else None, self.name
        )


def plan_limited(problem: SAP, run: Run, tolerance: float, name: str) -> Outcome:
    """Find a plan of a core problem (`SAP.core`), and prove it as far as time allows.

    Parameters
    ----------
    problem : SAP
    run : Run
    tolerance : float
        Relative gap at which a plan counts as optimal.
    name : str
        Of the method.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local, or its graph too large.
    InfeasibleError
        If no plan exists; names the limits that stand against each other.
    SolverError
        If time ended before any plan was found.
    """
    given, problem = problem, untangled(problem, exact=True)
    whole = path_graph(problem, tight=False)
    graph = tightened(whole)
    search = Search(problem, run, name, tolerance)
    if given is not problem:
        _react(search, given)
    if run.start is not None:
        search.offer(run.start, "start")
        search.offer(tidied(problem, run.start), "start")
    stop_at = clock.now() + _DUAL_SHARE * run.seconds_left

    def ascent(graph: PathGraph, stop_at: float) -> Ascent:
        return Ascent(graph, stop_at, lambda _, bound: search.report(-np.inf, bound), search.value, tolerance)

    # Prices of the whole graph are what a certificate can hold; those of the tight one prove more, and plan better.
    proven = dual = ascent(whole, stop_at if graph is whole else 0.5 * (clock.now() + stop_at)).run()
    if graph is not whole and np.isfinite(proven.bound):
        dual = ascent(graph, stop_at).run(proven.prices)
    search.bound = min(dual.bound, proven.bound)
    search.note("prices")
    if not np.isfinite(dual.bound):
        raise InfeasibleError(explain(whole))
    try:
        if graph.arcs > _SMALL:
            _from_prices(search, graph, dual)
        _programmes(search, graph, whole, dual)
    except KeyboardInterrupt:
        run.stopped = True
    return outcome_of(search, proven.prices)


def _react(search: Search, problem: SAP) -> None:
    """A plan in which the agents react to each other's losses, step by step."""
    part = search.run.part(_REACTION_SHARE * search.run.seconds_left)
    with contextlib.suppress(ValueError):  # limits that nobody can promise to keep who decides step by step
        search.offer(rollout(problem, IteratedAssignment(), part).plan, "start")
    search.run.stopped = search.run.stopped or part.stopped


def _from_prices(search: Search, graph: PathGraph, dual: LimitedDual) -> None:
    """A plan by prices, step by step, and better ones from it, part by part."""
    run, rows = search.run, search.problem.rows
    scale = graph.scale
    elastic = 2.0 * float(np.abs(dual.prices.limits).max(initial=0.0)) + _ELASTIC * scale
    loss = graph.through(graph.priced(dual.prices.effective(rows), dual.prices.limits))
    plans = [search.best, rolling_plan(graph, dual.prices)]
    if all(plan is None or worth(graph, plan, np.inf) == -np.inf for plan in plans):
        plans.append(dive(graph, loss, _DIVE_LOSS * scale, elastic, run.part(_DIVE_SHARE * run.seconds_left)))
    known = [plan for plan in plans if plan is not None]
    if not known:
        return
    plan = max(known, key=lambda plan: worth(graph, plan, elastic))
    search.offer(plan, "prices")
    _by_parts(search, graph, plan, loss, elastic)


def _by_parts(search: Search, graph: PathGraph, plan: IntArray, loss: FloatArray, elastic: float) -> None:
    """Better plans from a plan, part by part."""
    run = search.run
    share = _WHOLE_SHARE if _SMALL < graph.arcs <= _WHOLE_ARCS else _PART_SHARE
    graph, loss = _promising(graph, plan, loss)
    part = run.part(share * run.seconds_left)
    for found in improved(graph, plan, loss, elastic, part, run.rng):
        search.offer(found, "parts")
        search.report(search.value, search.bound)
        if search.is_proven:
            return
    run.stopped = run.stopped or part.stopped


def _promising(graph: PathGraph, plan: IntArray, loss: FloatArray) -> tuple[PathGraph, FloatArray]:
    """A graph of the arcs of least loss, and those of a plan: a part then takes in much more of the plan at once."""
    used = graph.follow(plan)
    if graph.arcs <= _PART_ARCS or used is None:
        return graph, loss
    keep = loss < np.partition(loss, _PART_ARCS)[_PART_ARCS]
    keep[used] = True
    return graph.restricted(keep), loss[keep]


def _programmes(search: Search, graph: PathGraph, full: PathGraph, dual: LimitedDual) -> None:
    rows, run = search.problem.rows, search.run
    loss = graph.through(graph.priced(dual.prices.effective(rows), dual.prices.limits))
    allowed = _FIRST_LOSS * graph.scale
    used = None if search.best is None else graph.follow(search.best)
    while not search.is_proven and not run.expired:
        gap = dual.bound - search.value
        if (loss <= allowed).sum() >= _NEARLY_ALL * (loss <= gap).sum():
            allowed = max(allowed, gap)
        whole = allowed >= gap or bool((loss[np.isfinite(loss)] <= allowed).all())
        keep = loss <= (gap if allowed >= gap else allowed)
        if used is not None:
            keep[used] = True
        made = limited_programme(graph, keep)
        answer = maximise(
            made.programme, seconds=run.seconds_left if whole else _PROGRAMME_SHARE * run.seconds_left,
            tolerance=search.tolerance, watch=search.report,
            start=None if used is None else made.point(used), options=_EXACT,
        )  # fmt: skip
        before = search.value
        if answer.x is not None:
            search.offer(made.recover(answer.x), "programme")
        inside = -np.inf if answer.ending is Ending.INFEASIBLE else answer.bound
        outside = -np.inf if whole else dual.bound - allowed
        search.bound = min(search.bound, max(inside, outside, search.value))
        search.note("programme")
        if whole and answer.ending is Ending.INFEASIBLE and search.best is None:
            raise InfeasibleError(explain(full))
        if whole:
            return
        if search.value > before and graph.arcs > _SMALL and search.best is not None:
            _by_parts(search, graph, search.best, loss, np.inf)
        if search.value > before and search.best is not None:
            used = graph.follow(search.best)
        allowed *= 4.0


def outcome_of(search: Search, prices: Prices) -> Outcome:
    """What was found, with the prices that prove its bound.

    Raises
    ------
    SolverError
        If no plan was found.
    """
    run = search.run
    if search.best is None:
        raise SolverError(f"{search.name} found no plan in {run.seconds:.3g} s; give it more time")
    if search.is_proven:
        status = Status.OPTIMAL
    elif run.stopped:
        status = Status.INTERRUPTED
    else:
        status = Status.TIME_LIMIT if run.expired else Status.FEASIBLE
    bound = float(max(search.bound, search.value)) if np.isfinite(search.bound) else None
    outcome = Outcome(search.best, status, bound, prices.tasks, search.trace)
    return replace(outcome, limit_prices=prices.limits, team_prices=prices.teams)
