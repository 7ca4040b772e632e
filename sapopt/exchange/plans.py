"""Plans that come from elsewhere: arrays, stays, or a table in any of the forms that plans go out in."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from datetime import datetime
from typing import Any

import numpy as np

from sapopt.data.tables import Table, missing
from sapopt.data.times import Time, as_text, instant, moment, step_ends
from sapopt.data.types import IntArray
from sapopt.problem.sap import SAP
from sapopt.problem.stays import Stay

_STAY = ("agent", "task", "start", "stop")


def plan_of(problem: SAP, given: Any) -> IntArray:
    """The plan (T, n) that an array, a list of stays or a table stands for; checked but for limits and forbidden pairs.

    Raises
    ------
    ValueError
        If it names an agent, a task or a time that the problem does not have, says two things of one agent at one
        step, or leaves an agent without a task where all must hold one. Rows are counted from 0.
    """
    if isinstance(given, (list, tuple)) and all(isinstance(stay, Stay) for stay in given):
        told = {name: [getattr(stay, name) for stay in given] for name in _STAY}
        plan = _of_stays(problem, told)
    elif isinstance(given, (np.ndarray, list, tuple)) and not (
        isinstance(given, np.ndarray) and given.dtype.names
    ):
        return problem.check_plan(given)
    else:
        plan = _of_table(problem, Table(given))
    if not problem.idle and (plan < 0).any():
        k, i = (int(x) for x in np.argwhere(plan < 0)[0])
        raise ValueError(
            f"plan: {_named(problem, i)} has no task at {_when(problem, k)}; only a problem with idle=True lets "
            "agents hold nothing"
        )
    return problem.check_plan(plan)


def _named(problem: SAP, i: int) -> str:
    label = problem.agent_label(i)
    return f"agent {label}" if isinstance(label, int) else repr(label)


def _when(problem: SAP, k: int) -> str:
    return f"step {k}" if problem.times is None else f"step {k} ({as_text(problem.times[k])})"


def _of_table(problem: SAP, table: Table) -> IntArray:
    heads = [_head(name) for name in table.names]
    if set(_STAY) <= set(heads):
        return _of_stays(problem, {head: table.values(name) for head, name in zip(heads, table.names, strict=True)
                                   if head in _STAY})  # fmt: skip
    if "step" not in heads:
        table = table.with_index()
        heads = [_head(name) for name in table.names]
        if "step" not in heads:
            raise ValueError(
                "plan: the table must have the columns agent, task, start and stop, or step, agent and task, or step "
                f"and one for each agent; it has {', '.join(map(repr, table.names[:12]))}"
            )
    step_of, task_of, agent_of = _Steps(problem), _tasks(problem), _agents(problem)
    steps = [
        step_of.start(value, row) for row, value in enumerate(table.values(table.names[heads.index("step")]))
    ]
    plan = np.full((problem.T, problem.n), -1, dtype=np.int64)
    said = np.zeros(plan.shape, dtype=bool)
    if {"agent", "task"} <= set(heads):
        agents, tasks = (table.values(table.names[heads.index(name)]) for name in ("agent", "task"))
        for row, (k, agent, task) in enumerate(zip(steps, agents, tasks, strict=True)):
            _say(problem, plan, said, range(k, k + 1), agent_of(agent, row), task_of(task, row), row)
        return plan
    for place, name in enumerate(table.names):
        if heads[place] == "step":
            continue
        agent = agent_of(name, None)
        for row, (k, task) in enumerate(zip(steps, table.values(name), strict=True)):
            _say(problem, plan, said, range(k, k + 1), agent, task_of(task, row), row)
    return plan


def _head(name: Any) -> Any:
    """The name of a column without the zone that Excel's columns of times have in brackets."""
    bare = name.partition(" (")[0] if isinstance(name, str) else name
    return bare if bare in ("step", "start", "stop") else name


def _of_stays(problem: SAP, table: dict[Any, list[Any]]) -> IntArray:
    step_of, task_of, agent_of = _Steps(problem), _tasks(problem), _agents(problem)
    plan = np.full((problem.T, problem.n), -1, dtype=np.int64)
    said = np.zeros(plan.shape, dtype=bool)
    for row, (agent, task, start, stop) in enumerate(zip(*(table[name] for name in _STAY), strict=True)):
        first, end = step_of.start(start, row), step_of.stop(stop, row)
        if end <= first:
            raise ValueError(f"plan: row {row} (counted from 0) stops before it starts")
        _say(problem, plan, said, range(first, end), agent_of(agent, row), task_of(task, row), row)
    return plan


def _say(problem: SAP, plan: IntArray, said: Any, steps: range, i: int, task: int, row: int) -> None:
    for k in steps:
        if said[k, i]:
            raise ValueError(
                f"plan: row {row} (counted from 0) says again what {_named(problem, i)} does at {_when(problem, k)}"
            )
        plan[k, i], said[k, i] = task, True


class _Numbers:
    """From names, or numbers where there are no names, to numbers."""

    def __init__(self, labels: tuple[str, ...] | None, count: int, kind: str, nothing: bool) -> None:
        if labels is not None and len(set(labels)) < len(labels):
            raise ValueError(f"{kind}s: two have one name, so a table cannot tell them apart")
        self.known = (
            {str(i): i for i in range(count)} if labels is None else {x: i for i, x in enumerate(labels)}
        )
        self.labels, self.kind, self.nothing = labels, kind, nothing

    def __call__(self, value: Any, row: int | None) -> int:
        if self.nothing and (
            missing(value) or (isinstance(value, str) and value == "" and "" not in self.known)
        ):
            return -1
        if isinstance(value, numbers.Real) and float(value).is_integer():
            value = int(float(value))  # whole numbers beside missing ones are read as 3.0
        text = str(value)
        if text in self.known:
            return self.known[text]
        if self.nothing and text == "-1":
            return -1
        place = "" if row is None else f"row {row} (counted from 0): "
        like = (
            f"the first one is {self.labels[0]!r}" if self.labels else f"they are 0 to {len(self.known) - 1}"
        )
        raise ValueError(f"plan: {place}there is no {self.kind} {value!r}; {like}")


def _agents(problem: SAP) -> _Numbers:
    return _Numbers(problem.agents, problem.n, "agent", False)


def _tasks(problem: SAP) -> _Numbers:
    return _Numbers(problem.tasks, problem.m, "task", True)


class _Steps:
    """From times, or numbers where there are no times, to steps."""

    def __init__(self, problem: SAP) -> None:
        self.T = problem.T
        self.starts: dict[Time, int] | None = None
        if problem.times is not None:
            ends = step_ends(problem.times)
            self.starts = {instant(time): k for k, time in enumerate(problem.times)}
            self.stops = {instant(end): k + 1 for k, end in enumerate(ends) if end is not None}
            # by the clock on the wall, where a table has lost the zone; twice in the night when clocks are set back
            self.wall_starts = self._walls(list(problem.times), 0)
            self.wall_stops = self._walls(ends, 1)

    @staticmethod
    def _walls(times: Sequence[Time | None], more: int) -> dict[Time, int]:
        out: dict[Time, int] = {}
        for k, time in enumerate(times):
            if isinstance(time, datetime) and time.tzinfo is not None:
                wall = time.replace(tzinfo=None, fold=0)
                out[wall] = -1 if wall in out else k + more
        return out

    def start(self, value: Any, row: int) -> int:
        """The step that begins at a time."""
        if self.starts is None:
            return self._number(value, row, 0)
        return self._found(value, row, self.starts, self.wall_starts, "begins")

    def stop(self, value: Any, row: int) -> int:
        """The step after the one that ends at a time."""
        if self.T == 1 and missing(value):
            return self.T
        if self.starts is None:
            return self._number(value, row, 1)
        return self._found(value, row, self.stops, self.wall_stops, "ends")

    def _number(self, value: Any, row: int, least: int) -> int:
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not (number.is_integer() and least <= number < self.T + least):
            raise ValueError(
                f"plan: row {row} (counted from 0): {value!r} is no step from {least} to {self.T - 1 + least}"
            )
        return int(number)

    def _found(self, value: Any, row: int, known: dict[Time, int], walls: dict[Time, int], does: str) -> int:
        try:
            time = moment(value)
        except ValueError as error:
            raise ValueError(f"plan: row {row} (counted from 0): {error}") from None
        k = known.get(instant(time))
        if k is None:
            k = walls.get(time)
        if k is None:
            raise ValueError(f"plan: row {row} (counted from 0): no step {does} at {as_text(time)}")
        if k < 0:
            raise ValueError(
                f"plan: row {row} (counted from 0): two steps of the problem begin or end at {as_text(time)} on the "
                "wall; give the time with its offset from UTC"
            )
        return k
