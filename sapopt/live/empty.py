"""Calls at which there is no agent or no task: nothing can be decided, and the session goes on."""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt.dynamics.base import AgentColumns
from sapopt.live.decision import Decision, Outcome
from sapopt.live.names import Roster, checked_names
from sapopt.live.window import Settings, Standing

NO_TASK = ""
"""Id of the forbidden task that stands for none, because a problem has at least one."""


def is_empty(names: Any) -> bool:
    """Whether a call names nobody, or nothing."""
    return names is not None and not isinstance(names, (str, bytes)) and len(names) == 0


def without_tasks(values: Any, idle: bool) -> np.ndarray:
    """Benefits (W, n, 1) that forbid the one task there is, for a call with none.

    Parameters
    ----------
    values : as benefits of `Session.step`, shape (W, n, 0)

    Raises
    ------
    ValueError
        If the benefits have a task, or agents may not idle.
    """
    steps, n = _shape(values, 1, "tasks")
    if not idle:
        raise ValueError(
            f"tasks: there is none, and the {n} agents must each have one; make the session with idle=True"
        )
    return np.full((steps, n, 1), -np.inf)


def without_agents(
    settings: Settings, standing: Standing, values: Any, tasks: Any
) -> tuple[Decision, Standing]:
    """The decision of a call without agents, and what is carried on: the time, the tasks, and the use of limits.

    Raises
    ------
    ValueError
        If the benefits have an agent.
    """
    _, m = _shape(values, 0, "agents")
    names = checked_names(tasks, m, "tasks")
    empty: tuple[dict[Any, Any], ...] = ({},) * settings.announce
    bound = 0.0 if settings.prove else None
    decision = Decision(empty[0], empty, 0.0, bound, 0.0, 0.0, Outcome.FROZEN, standing.step)
    if standing.held is None:  # it has not begun
        return decision, Standing(standing.step + 1)
    columns = standing.columns
    if columns is not None:
        columns = AgentColumns(*({name: part[:0] for name, part in parts.items()} for parts in columns))
    return decision, Standing(
        standing.step + 1, Roster(), standing.tasks.updated(names), np.zeros(0, dtype=np.int64), None, columns,
        None, (), standing.step, empty[1:], standing.used, None,
    )  # fmt: skip


def _shape(values: Any, axis: int, what: str) -> tuple[int, int]:
    """Steps, and the number of those that there are, of benefits without any along an axis of each step."""
    try:
        shapes = {np.shape(step) for step in values}
    except (TypeError, ValueError):  # no list of steps, or no matrix
        shapes = set()
    if len(shapes) != 1 or len(shape := shapes.pop()) != 2 or shape[axis]:
        raise ValueError(
            f"benefits must have the shape (W, n, m) of this call, but there are no {what} and the benefits do not "
            "say so; leave no column for a task that is not there, and no row for an agent"
        )
    return len(values), shape[1 - axis]
