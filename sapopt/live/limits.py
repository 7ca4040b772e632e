"""Limits of a session: they name ids, and what is used so far is carried from call to call."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from sapopt.data.types import IntArray
from sapopt.live.names import Name, Roster, checked_name
from sapopt.problem.limit import Limit, Team, checked_limits

Used = dict[int, dict[Name, float]]
"""Use of every limit by the id that it counts for (`TOGETHER` where it counts for all of them together)."""

TOGETHER = ""

_BY = {"once": "tasks", "work": "agents", "handovers": "agents", "cover": "tasks"}
"""What the kinds of limits that a session takes are about."""


def session_limits(limits: Any) -> tuple[Limit | Team, ...]:
    """The limits of a session, checked.

    Raises
    ------
    ValueError
        If one is of a kind that cannot be kept from call to call.
    """
    out = checked_limits(limits)
    for number, limit in enumerate(out):
        where = f"limits: number {number} ({limit.called})"
        if limit.steps is not None:
            raise ValueError(
                f"{where}: steps have no meaning in a session, which has no first and no last one"
            )
        if isinstance(limit, Team):
            checked_name(limit.task, where)
            continue
        if limit.kind not in _BY:
            raise ValueError(
                f"{where}: a session takes once, work, handovers and cover, which name ids, not {limit.kind!r}"
            )
        if limit.kind != "cover" and limit.at_least is not None:
            raise ValueError(
                f"{where}: at_least needs a last step, and a session has none; only cover takes it"
            )
        named(limit)
    return out


def named(limit: Limit) -> tuple[Name, ...] | None:
    """The ids that a limit names; None for all that ever come."""
    values = limit.tasks if _BY[limit.kind] == "tasks" else limit.agents
    if values is None:
        return None
    several: Iterable[Any] = (
        values if isinstance(values, (list, tuple, set, frozenset, range, np.ndarray)) else [values]
    )
    return tuple(dict.fromkeys(checked_name(name, limit.called) for name in several))


def limits_left(
    limits: tuple[Limit | Team, ...], used: Used, agents: Roster, tasks: Roster
) -> tuple[Limit | Team, ...]:
    """The limits of one window by indices, with what is left of each."""
    out: list[Limit | Team] = []
    for number, limit in enumerate(limits):
        if isinstance(limit, Team):
            if limit.task in tasks.index:
                out.append(replace(limit, task=tasks.index[limit.task]))
            continue
        here = _present(limit, agents, tasks)
        count = used.get(number, {})
        options: dict[str, Any] = {"name": limit.called, "penalty": limit.penalty}
        if limit.kind == "cover":
            assert limit.at_least is not None
            out.append(Limit.cover([i for _, i in here], limit.at_least, served=limit.served, **options))
            continue
        assert limit.at_most is not None
        if limit.kind == "handovers" and not limit.each:
            left = max(limit.at_most - count.get(TOGETHER, 0.0), 0.0)
            out.append(Limit.handovers(left, [i for _, i in here], **options))
            continue
        groups: dict[float, list[int]] = {}
        for name, place in here:
            groups.setdefault(max(limit.at_most - count.get(name, 0.0), 0.0), []).append(place)
        for left, places in groups.items():
            if limit.kind == "once":
                out.append(Limit.once(places, left, **options))
            elif limit.kind == "work":
                out.append(Limit.work(places, left, **options))
            else:
                out.append(Limit.handovers(left, places, each=True, **options))
    return tuple(out)


def _present(limit: Limit, agents: Roster, tasks: Roster) -> list[tuple[Name, int]]:
    index = (tasks if _BY[limit.kind] == "tasks" else agents).index
    names = named(limit)
    return list(index.items()) if names is None else [(name, index[name]) for name in names if name in index]


def used_after(
    limits: tuple[Limit | Team, ...],
    used: Used,
    agents: Roster,
    tasks: Roster,
    chosen: IntArray,
    served: np.ndarray,
    taken: np.ndarray,
) -> Used:
    """What is used after one more step.

    Parameters
    ----------
    chosen : ndarray of int64, shape (n,)
        Task of every agent, -1 for none.
    served, taken : ndarray of bool, shape (n,)
        Whether the agent serves its task, and whether it took it up at this step.
    """
    out = {number: dict(count) for number, count in used.items()}
    for number, limit in enumerate(limits):
        if isinstance(limit, Team) or limit.kind == "cover":
            continue
        names = named(limit)
        wanted = None if names is None else set(names)
        count = out.setdefault(number, {})
        by_task, happens = limit.kind == "once", taken if limit.kind == "handovers" else served
        for i in np.flatnonzero(happens):
            name = tasks.names[chosen[i]] if by_task else agents.names[i]
            if wanted is None or name in wanted:
                key = TOGETHER if limit.kind == "handovers" and not limit.each else name
                count[key] = count.get(key, 0.0) + 1.0
    return out
