"""Who rides on which satellite, and which task lies where, for scenarios that make several of one."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from sapopt.data.types import FloatArray, IntArray


@runtime_checkable
class OnEarth(Protocol):
    """Satellites above places on the ground, such as a `Constellation`."""

    @property
    def positions_km(self) -> FloatArray:
        """Earth-fixed positions (T, n, 3) of the satellites."""

    @property
    def tasks(self) -> Any:
        """The tasks' places, such as `GroundTasks`."""

    @property
    def field_of_view(self) -> Any:
        """What a satellite sees, such as `FieldOfView`."""

    @property
    def step_s(self) -> float:
        """Seconds from one step to the next."""


class Aboard(NamedTuple):
    """What a map needs to know of a scenario.

    Attributes
    ----------
    base : OnEarth
        The scenario itself, or the constellation that it wraps.
    carrier : ndarray of int64, shape (n,)
        Satellite of every agent of the scenario's problem: several beams may ride on one.
    place : ndarray of int64, shape (m,), or None
        Task of `base` that every task lies at: one region may take several observers. None: each at its own. Numbers
        beyond the tasks of `base` are idle tasks, which lie nowhere.
    """

    base: OnEarth
    carrier: IntArray
    place: IntArray | None


@runtime_checkable
class Carried(Protocol):
    """A scenario whose agents are satellites of a constellation, or ride on them."""

    def on_earth(self) -> Aboard:
        """Which satellites, and which places."""


def aboard(scenario: Any) -> Aboard | None:
    """Satellites and places behind a scenario, None if it has none."""
    if isinstance(scenario, Carried):
        return scenario.on_earth()
    return every_satellite(scenario) if isinstance(scenario, OnEarth) else None


def every_satellite(base: OnEarth) -> Aboard:
    """Each agent is a satellite, and each task lies at its own place."""
    return Aboard(base, np.arange(base.positions_km.shape[1]), None)
