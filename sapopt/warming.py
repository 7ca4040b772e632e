"""Compile what a run needs before its clock starts, by a run on the first steps of the problem."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import fields, is_dataclass
from itertools import count

import numpy as np

from sapopt import api
from sapopt.domains.tiny import contested_benefits, tiny_problems
from sapopt.dynamics.base import Model
from sapopt.kernels.jit import compiled_always
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Policy
from sapopt.solvers.base import Solver

STEPS = 3
"""Steps of the problem that is solved: the second one, which has a past, compiles more than the first."""
_SECONDS = 2.0
"""Time limit of a planner; a policy must run all steps."""
_TINY_SECONDS = 1.0
"""Time limit of a tiny run, compiling not counted; the first look at everything takes far less."""
_ITERATIONS = 3
"""Dual iterations: the first evaluation uses other kernels than those that follow."""


def warm_up(problem: SAP, solver: Solver | None) -> None:
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
    limit = None if isinstance(solver, Policy) else _SECONDS
    if api.solve(small, solver, time_limit=limit).status is Status.INTERRUPTED:
        raise KeyboardInterrupt


def warm_up_tiny(problem: SAP, solver: Solver | None) -> None:
    """Compile what comes only late in a long run: run on the tiny problems whose dynamics is of the problem's kind."""
    kind = _kind(problem.model)
    with compiled_always():
        for _, tiny in tiny_problems():
            if _kind(tiny.model) == kind:
                run_tiny(tiny, solver)
        cost = getattr(problem.dynamics, "cost", None)
        if np.ndim(cost) == 0 and cost:
            run_tiny(SAP(contested_benefits() * (float(cost) / 0.7), problem.dynamics), solver)


def run_tiny(problem: SAP, solver: Solver | None) -> None:
    """Run a solver, or without one the bound, on a tiny problem; nothing happens if it does not take the problem."""
    with suppress(ValueError):
        if solver is None:
            api.bound(problem, time_limit=_TINY_SECONDS)
        else:
            # A policy must run all steps: the second one, which has a past, needs more than the first.
            limit = None if isinstance(solver, Policy) else _TINY_SECONDS
            api.solve(problem, solver, time_limit=limit)


def _kind(model: Model) -> tuple[object, ...]:
    """The class of a dynamics and the form of its parameters: what decides which kernels it needs."""
    if not is_dataclass(model):
        return (type(model),)
    values = (getattr(model, field.name) for field in fields(model))
    return (type(model), *(value if isinstance(value, bool) else np.ndim(value) for value in values))


def first_steps(problem: SAP) -> SAP:
    """The first `STEPS` steps of a problem."""
    return SAP(problem.benefits.slice(0, min(STEPS, problem.T)), problem.dynamics, problem.initial_assignment)
