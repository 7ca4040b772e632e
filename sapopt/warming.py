"""Compile what a run needs before its clock starts, by a run on the first steps of the problem."""

from __future__ import annotations

from itertools import count

from sapopt import api
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Policy
from sapopt.solvers.base import Solver

STEPS = 3
"""Steps of the problem that is solved: the second one, which has a past, compiles more than the first."""
_SECONDS = 2.0
"""Time limit of a planner; a policy must run all steps."""
_ITERATIONS = 3
"""Dual iterations: the first evaluation uses other kernels than those that follow."""


def warm_up(problem: SAP, solver: Solver | None) -> None:
    """Run a solver, or without one the bound, on the first `STEPS` steps of a problem.

    Raises
    ------
    KeyboardInterrupt
        If the user interrupted it: nothing is worth keeping.
    """
    steps = min(STEPS, problem.T)
    small = SAP(problem.benefits.slice(0, steps), problem.dynamics, problem.initial_assignment)
    if solver is None:
        iterations = count(1)
        api.bound(small, callback=lambda progress: next(iterations) >= _ITERATIONS)
        return
    limit = None if isinstance(solver, Policy) else _SECONDS
    if api.solve(small, solver, time_limit=limit).status is Status.INTERRUPTED:
        raise KeyboardInterrupt
