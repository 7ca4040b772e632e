"""First steps that are fixed: what `frozen` means, by places."""

from __future__ import annotations

import numbers
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sapopt.data.types import IntArray
from sapopt.live.course import FREE
from sapopt.live.decision import Assignment
from sapopt.live.names import checked_name
from sapopt.live.window import Standing, Window


def pins_of(frozen: Any, window: Window, standing: Standing) -> list[IntArray]:
    """Places (n,) of the agents for each frozen step, `FREE` for those that may choose.

    Parameters
    ----------
    frozen : int, mapping, sequence of mappings, or None
        See `sapopt.live.session.Session.step`.
    window : Window
    standing : Standing

    Raises
    ------
    ValueError
        If an id is unknown, a task is given to more agents than it takes, or too much is frozen.
    """
    if frozen is None:
        return []
    if isinstance(frozen, numbers.Integral) and not isinstance(frozen, (bool, np.bool_)):
        steps = _announced(int(frozen), standing)
        given = False
    elif isinstance(frozen, Mapping):
        steps, given = [dict(frozen)], True
    elif (
        isinstance(frozen, Sequence)
        and not isinstance(frozen, str)
        and all(isinstance(x, Mapping) for x in frozen)
    ):
        steps, given = [dict(step) for step in frozen], True
    else:
        raise ValueError(
            f"frozen must be a number of announced steps, or a task by agent for one step or a list of steps, got "
            f"{frozen!r}"
        )
    if len(steps) > window.steps:
        raise ValueError(f"frozen: {len(steps)} steps, but the benefits have {window.steps}")
    return [_pins(step, k, window, given) for k, step in enumerate(steps)]


def _announced(count: int, standing: Standing) -> list[Assignment]:
    if count < 0:
        raise ValueError(f"frozen must not be negative, got {count}")
    if standing.held is None:
        return []  # nothing is announced yet
    if count > len(standing.announced):
        raise ValueError(
            f"frozen={count}, but only {len(standing.announced)} steps from here on were announced; make the session "
            f"with announce={count + 1} or more"
        )
    return list(standing.announced[:count])


def _pins(step: Assignment, k: int, window: Window, given: bool) -> IntArray:
    """The pins of a step; what was announced and cannot be any more is free again, what the caller says must fit."""
    n = len(window.agents)
    pins = np.full(n, FREE)
    for key, value in step.items():
        agent = checked_name(key, "frozen")
        task = None if value is None else checked_name(value, "frozen")
        i = window.agents.index.get(agent)
        j = window.idle_place if task is None else window.tasks.index.get(task)
        if given and i is None:
            raise ValueError(f"frozen: the agent {agent!r} is not among the agents of this call")
        if given and j is None:
            raise ValueError(
                f"frozen: the task {task!r} of agent {agent!r} is not among the tasks of this call"
            )
        if given and j == -1:
            raise ValueError(
                f"frozen: agent {agent!r} is to hold nothing, which needs a session with idle=True"
            )
        if i is not None and j is not None and j >= 0:
            pins[i] = j
    fixed = np.flatnonzero(pins != FREE)
    held = np.zeros(n, dtype=np.int64)
    held[fixed] = pins[fixed]
    benefit = window.core.benefits.slice(k, k + 1).at(held[None])[0]
    forbidden = fixed[np.isneginf(benefit[fixed])]
    if len(forbidden) and given:
        agent = window.agents.names[forbidden[0]]
        raise ValueError(
            f"frozen: agent {agent!r} may not take task {step[agent]!r} at step {k} of the window"
        )
    pins[forbidden] = FREE
    if not given:
        return pins
    room = (
        window.core.capacity[k]
        if window.core.capacity is not None
        else np.ones(window.core.m, dtype=np.int64)
    )
    over = np.flatnonzero(np.bincount(pins[fixed], minlength=window.core.m) > room)
    if len(over):
        who = ", ".join(repr(window.agents.names[i]) for i in np.flatnonzero(pins == over[0]))
        raise ValueError(
            f"frozen: task {window.tasks.names[over[0]]!r} is given to agents {who} at step {k} of the window, and "
            f"takes {room[over[0]]}"
        )
    return pins
