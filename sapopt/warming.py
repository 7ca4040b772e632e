"""Compile what a run needs before its clock starts, by a run on the first steps of the problem."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from itertools import count

from sapopt import api
from sapopt.problem.limit import Limit
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.running.outlook import Policy
from sapopt.solvers.base import Solver
from sapopt.solvers.dual_decomposition.solver import DualDecomposition

STEPS = 3
"""Steps of the problem that is solved: the second one, which has a past, compiles more than the first."""
_SECONDS = 2.0
"""Time limit of a planner; a policy must run all steps."""
_TINY_SECONDS = 1.0
"""Time limit of a tiny run, compiling not counted; the first look at everything takes far less."""
_ITERATIONS = 3
"""Dual iterations: the first evaluation uses other kernels than those that follow."""


@dataclass(frozen=True)
class Others:
    """What a run of `DualDecomposition` may turn to later: a job of its own, which another process may take."""

    solver: DualDecomposition


@dataclass(frozen=True)
class Windows:
    """The exact windows, by which a run of `DualDecomposition` improves its plans: likewise."""

    solver: DualDecomposition


Part = Solver | Others | Windows | None
"""A solver, a part of its work, or the bound (None)."""


def parts(solver: Solver | None, problem: SAP) -> list[Part]:
    """What `warm_up` is to be called with so that all is compiled that a run may need."""
    if isinstance(solver, DualDecomposition) and problem.is_plain:
        return [Others(solver), solver]
    return [solver]


def warm_up(problem: SAP, solver: Part) -> None:
    """Run a solver, or without one the bound, on the first `STEPS` steps of a problem.

    Raises
    ------
    KeyboardInterrupt
        If the user interrupted it: nothing is worth keeping.
    """
    small = first_steps(problem)
    if solver is None:
        iterations = count(1)
        api.bound(small, callback=lambda progress: next(iterations) >= _ITERATIONS)
        return
    if isinstance(solver, Others):
        solver.solver.exercise_others(small, Run(time_limit=_SECONDS))
        return
    if isinstance(solver, Windows):
        solver.solver.exercise_windows(small, Run(time_limit=_SECONDS))
        return
    if isinstance(solver, DualDecomposition) and problem.is_plain:
        solver.exercise(small, Run(time_limit=_SECONDS))
        return
    limit = None if isinstance(solver, Policy) else _SECONDS
    if api.solve(small, solver, time_limit=limit).status is Status.INTERRUPTED:
        raise KeyboardInterrupt


def run_tiny(problem: SAP, solver: Solver | None) -> None:
    """Run a solver, or without one the bound, on a tiny problem; nothing happens if it does not take the problem."""
    with suppress(ValueError):
        if solver is None:
            api.bound(problem, time_limit=_TINY_SECONDS)
        elif isinstance(solver, DualDecomposition) and problem.is_plain:
            solver.exercise(problem, Run(time_limit=_TINY_SECONDS))
            solver.exercise_others(problem, Run(time_limit=_TINY_SECONDS))
        else:
            # A policy must run all steps: the second one, which has a past, needs more than the first.
            limit = None if isinstance(solver, Policy) else _TINY_SECONDS
            api.solve(problem, solver, time_limit=limit)


def first_steps(problem: SAP) -> SAP:
    """The first `STEPS` steps of a problem.

    Limits are about the whole horizon, so a problem that has some gets a harmless one, for which the same is compiled.
    """
    steps = min(STEPS, problem.T)
    benefits = problem.benefits.slice(0, steps)
    capacity = 1 if problem.capacity is None else problem.capacity[:steps]
    harmless = [Limit.work(at_most=steps)] if problem.limits else []
    return SAP(
        benefits,
        problem.dynamics,
        problem.initial_assignment,
        capacity=capacity,
        idle=problem.idle,
        limits=harmless,
    )
