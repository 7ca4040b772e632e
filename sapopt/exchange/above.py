"""Where a plan takes place: the satellites and places of its scenario, for maps of other programs."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sapopt.data.times import step_ends
from sapopt.data.types import FloatArray, IntArray
from sapopt.exchange.forms import owner
from sapopt.exchange.places import Located, Places
from sapopt.plotting.aboard import aboard
from sapopt.problem.result import Result
from sapopt.problem.sap import SAP

_UNDATED = datetime(2000, 1, 1, 12, tzinfo=UTC)
"""The first step of a constellation without a date (the epoch J2000)."""


@runtime_checkable
class _Known(Protocol):
    """A constellation that knows its satellites' names and its date."""

    @property
    def satellite_names(self) -> tuple[str, ...]:
        """Names."""

    @property
    def start(self) -> datetime | None:
        """Time of the first step."""


@dataclass(frozen=True, eq=False)
class Above:
    """A plan with its satellites and places.

    Attributes
    ----------
    problem : SAP
    plan : ndarray of int64, shape (T, n)
    serves : ndarray of bool, shape (T, n)
        Whether the agent holds a task of positive benefit that lies somewhere.
    positions_km : ndarray, shape (T, satellites, 3), or None
        Earth-fixed; None where agents stay at `fixed`.
    fixed : Located or None
        Places of agents that do not move; they then stand for the satellites.
    satellites : list of str
        Their names.
    carrier : ndarray of int64, shape (n,)
        Satellite of every agent.
    place : ndarray of int64, shape (m,)
        Place of every task; numbers beyond the places are tasks that lie nowhere.
    latitude_deg, longitude_deg, priority : ndarray, shape (places,)
    places : list of str
        Their names.
    starts, ends : list of T datetime
        Of the steps, UTC.
    """

    problem: SAP
    plan: IntArray
    serves: np.ndarray
    positions_km: FloatArray | None
    fixed: Located | None
    satellites: list[str]
    carrier: IntArray
    place: IntArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    priority: FloatArray
    places: list[str]
    starts: list[datetime]
    ends: list[datetime]

    @property
    def kind(self) -> str:
        """What serves: a satellite, or an agent that does not move."""
        return "satellite" if self.fixed is None else "agent"

    def runs(self) -> list[tuple[int, int, int, int]]:
        """Satellite, place, first step and stop of every time that a satellite serves a place without a break."""
        step, agent = np.nonzero(self.serves)
        pairs = np.stack([self.carrier[agent], self.place[self.plan[step, agent]], step], axis=1)
        pairs = np.unique(pairs, axis=0)  # several beams of one satellite may serve one place
        breaks = np.ones(len(pairs), dtype=bool)
        if len(pairs) > 1:
            same = (pairs[1:, :2] == pairs[:-1, :2]).all(axis=1)
            breaks[1:] = ~(same & (pairs[1:, 2] == pairs[:-1, 2] + 1))
        first = np.flatnonzero(breaks)
        last = np.append(first[1:], len(pairs)) - 1
        return [
            (int(pairs[a, 0]), int(pairs[a, 1]), int(pairs[a, 2]), int(pairs[b, 2]) + 1)
            for a, b in zip(first, last, strict=True)
        ]


def above(result: Result, scenario: Any, problem: SAP | None = None) -> Above:
    """The plan of a result above the Earth.

    Raises
    ------
    ValueError
        If the scenario has no places, or is not the one that the problem was made of.
    """
    known = owner(result, problem)
    if isinstance(scenario, Places):
        return _on_the_ground(known, result, scenario)
    found = aboard(scenario)
    if found is None:
        raise ValueError(
            f"scenario: a map needs places, and a {type(scenario).__name__} has none; a Constellation has them, and "
            "sapopt.exchange.Places tells where agents are that do not move. Without places take the report, or a "
            "table (Result.to_csv, sapopt.exchange.write_excel, write_json)"
        )
    base, carrier, place = found
    tasks, positions = base.tasks, base.positions_km
    if place is None:
        place = np.arange(max(tasks.m, known.m))
    if len(carrier) != known.n or len(place) != known.m or positions.shape[0] != known.T:
        raise ValueError(
            f"scenario: it has {positions.shape[0]} steps, {len(carrier)} agents and {len(place)} tasks, the problem "
            f"{known.T}, {known.n} and {known.m}; pass the scenario that the problem was made from"
        )
    names = base.satellite_names if isinstance(base, _Known) else ()
    start: Any = base.start if isinstance(base, _Known) else None
    if known.times is not None:
        start = known.times[0]
    if not isinstance(start, datetime):
        start = _UNDATED
    start = start.replace(tzinfo=UTC) if start.tzinfo is None else start.astimezone(UTC)
    edges = [start + timedelta(seconds=base.step_s * k) for k in range(known.T + 1)]
    held = place[np.where(result.plan < 0, 0, result.plan)]
    serves = (known.held_benefits(result.plan) > 0) & (result.plan >= 0) & (held < tasks.m)
    return Above(
        known, result.plan, serves, positions, None,
        list(names) or [f"satellite {i}" for i in range(positions.shape[1])], np.asarray(carrier), np.asarray(place),
        tasks.latitude_deg, tasks.longitude_deg, tasks.priority,
        list(tasks.names) or [f"task {j}" for j in range(tasks.m)], edges[:-1], edges[1:],
    )  # fmt: skip


def _on_the_ground(problem: SAP, result: Result, given: Places) -> Above:
    """The same where agents stay at places."""
    agents, tasks = given.agents, given.tasks
    for name, place, count in (("agents", agents, problem.n), ("tasks", tasks, problem.m)):
        if len(place.latitude_deg) != count:
            raise ValueError(
                f"scenario: it has places for {len(place.latitude_deg)} {name}, the problem {count}"
            )
    start = given.start or _UNDATED
    times: list[Any] = [start + timedelta(seconds=given.step_s * k) for k in range(problem.T + 1)]
    if problem.times is not None and isinstance(problem.times[0], datetime):
        last = step_ends(problem.times)[-1]
        times = list(problem.times)
        times.append(times[-1] + timedelta(seconds=given.step_s) if last is None else last)
    edges = [time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC) for time in times]
    names = [list(agents.names or problem.agents or []), list(tasks.names or problem.tasks or [])]
    return Above(
        problem, result.plan, (problem.held_benefits(result.plan) > 0) & (result.plan >= 0), None, agents,
        names[0] or [f"agent {i}" for i in range(problem.n)], np.arange(problem.n), np.arange(problem.m),
        tasks.latitude_deg, tasks.longitude_deg, tasks.priority,
        names[1] or [f"task {j}" for j in range(problem.m)], edges[:-1], edges[1:],
    )  # fmt: skip


def stamp(time: datetime) -> str:
    """A time of UTC in ISO 8601, with a Z."""
    return time.isoformat().replace("+00:00", "Z")
