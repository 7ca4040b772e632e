"""A problem as solvers see it: every agent holds a place, and every place has room.

Idleness becomes a last task that holds everybody, and the pairs of closed tasks are forbidden.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from sapopt.data.closing import closing
from sapopt.dynamics.base import Model
from sapopt.dynamics.capabilities import adapt
from sapopt.dynamics.idle import IdlePlace


def made_core(problem: Any) -> Any:
    """The core of a `sapopt.problem.sap.SAP` that asks for more than one task for each agent.

    It is a problem itself, with ``capacity`` (T, m) of at least 1, the rows of the limits, and no idleness.

    Raises
    ------
    ValueError
        If a matrix of costs has no place for idleness, or the dynamics does not take a further task.
    """
    core = copy.copy(problem)
    idle = int(problem.idle)
    core.m, core.idle, core.core = problem.m + idle, False, core
    if problem.tasks is not None and idle:
        core.tasks = (*problem.tasks, "nothing")
    ones = np.ones((problem.T, problem.m), dtype=np.int64)
    room = ones if problem.capacity is None else np.maximum(problem.capacity, 1)
    core.capacity = np.hstack([room, np.full((problem.T, idle), problem.n)])
    initial = problem.initial_assignment
    core.initial_assignment = None if initial is None else problem.placed(initial)
    core.benefits = closing(problem.benefits, None, idle)
    model = _adapted(problem, core)  # which may not like forbidden pairs, and never plays one
    core.model = IdlePlace(model, core.m - 1) if idle and not model.idles_freely else model
    core.benefits = closing(problem.benefits, problem.capacity, idle)
    return core


def _adapted(problem: Any, core: Any) -> Model:
    """The model of the dynamics for the core's places."""
    try:
        model = adapt(problem.dynamics, core)
    except ValueError as error:
        if not problem.idle:
            raise
        raise ValueError(
            f"{error}; with idle=True, holding nothing is a further task for it, the last one"
        ) from None
    rule = model.switching()
    if (
        problem.idle
        and rule is not None
        and rule.uniform_cost is None
        and np.any(np.asarray(rule.cost)[:, -1])
    ):
        raise ValueError(
            "dynamics: with idle=True the last column of a matrix of costs is for going idle, which is free: zeros"
        )
    return model
