"""A problem as solvers see it: every agent holds a place, and every place has room.

Idleness becomes a last task that holds everybody, and the pairs of closed tasks are forbidden.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from sapopt.data.closing import closing
from sapopt.dynamics.capabilities import adapt
from sapopt.dynamics.idle import IdlePlace
from sapopt.dynamics.switching.model import SwitchingCost


def made_core(problem: Any) -> Any:
    """The core of a `sapopt.problem.sap.SAP` that asks for more than one task for each agent.

    It is a problem itself, with ``capacity`` (T, m) of at least 1, the rows of the limits, and no idleness.

    Raises
    ------
    ValueError
        If a matrix of costs has no place for idleness, or the dynamics does not take a further task.
    """
    _check_cost_matrix(problem)
    core = copy.copy(problem)
    idle = int(problem.idle)
    core.m, core.idle, core.tasks, core.core = problem.m + idle, False, None, core
    ones = np.ones((problem.T, problem.m), dtype=np.int64)
    room = ones if problem.capacity is None else np.maximum(problem.capacity, 1)
    core.capacity = np.hstack([room, np.full((problem.T, idle), problem.n)])
    initial = problem.initial_assignment
    core.initial_assignment = None if initial is None else problem.placed(initial)
    core.benefits = closing(problem.benefits, None, idle)
    model = adapt(problem.dynamics, core)  # which may not like forbidden pairs, and never plays one
    core.model = IdlePlace(model) if idle and not model.idles_freely else model
    core.benefits = closing(problem.benefits, problem.capacity, idle)
    return core


def _check_cost_matrix(problem: Any) -> None:
    cost = problem.dynamics.cost if isinstance(problem.dynamics, SwitchingCost) else 0.0
    shape = problem.m + 1, problem.m + 1
    if problem.idle and np.ndim(cost) == 2 and (np.shape(cost) != shape or np.any(np.asarray(cost)[:, -1])):
        raise ValueError(
            f"dynamics: with idle=True a matrix of costs needs shape {shape}, the last row for taking up a task from "
            f"idleness and a last column of zeros for going idle; got {np.shape(cost)}"
        )
