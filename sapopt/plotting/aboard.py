"""Who rides on which satellite, and which task lies where, for scenarios that make several of one."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sapopt.data.types import IntArray


class Aboard(NamedTuple):
    """What a map needs to know of a scenario.

    Attributes
    ----------
    base : object
        The scenario itself, or the constellation that it wraps (``constellation`` or ``satellites``).
    carrier : ndarray of int64, shape (n,)
        Satellite of every agent of the scenario's problem: several beams may ride on one.
    place : ndarray of int64, shape (m,), or None
        Task of `base` that every task lies at: one region may take several observers. None: each at its own. Numbers
        beyond the tasks of `base` are idle tasks, which lie nowhere.
    """

    base: Any
    carrier: IntArray
    place: IntArray | None


def aboard(scenario: Any) -> Aboard | None:
    """Satellites and places behind a scenario, None if it has none."""
    base = getattr(scenario, "constellation", getattr(scenario, "satellites", scenario))
    positions, tasks = getattr(base, "positions_km", None), getattr(base, "tasks", None)
    if positions is None or tasks is None or not hasattr(tasks, "latitude_deg"):
        return None
    copied = scenario.synthetic() if hasattr(scenario, "synthetic") else None
    carrier = getattr(copied, "agent_of", np.arange(positions.shape[1]))
    return Aboard(base, carrier, getattr(copied, "task_of", None))
