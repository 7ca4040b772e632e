"""Where a plan takes place: the satellites and places of its scenario, for maps of other programs."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.exchange.forms import owner
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
    positions_km : ndarray, shape (T, satellites, 3)
        Earth-fixed.
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
    positions_km: FloatArray
    satellites: list[str]
    carrier: IntArray
    place: IntArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    priority: FloatArray
    places: list[str]
    starts: list[datetime]
    ends: list[datetime]

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
        If the scenario has no satellites, or is not the one that the problem was made of.
    """
    known = owner(result, problem)
    found = aboard(scenario)
    if found is None:
        raise ValueError(
            f"scenario: a map needs satellites and places, as a Constellation has them, got {type(scenario).__name__}"
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
        known, result.plan, serves, positions,
        list(names) or [f"satellite {i}" for i in range(positions.shape[1])], np.asarray(carrier), np.asarray(place),
        tasks.latitude_deg, tasks.longitude_deg, tasks.priority,
        list(tasks.names) or [f"task {j}" for j in range(tasks.m)], edges[:-1], edges[1:],
    )  # fmt: skip


def stamp(time: datetime) -> str:
    """A time of UTC in ISO 8601, with a Z."""
    return time.isoformat().replace("+00:00", "Z")
