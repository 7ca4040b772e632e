"""The local states of a `Battery` in plain words: what every compiled recursion is tested against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sapopt.data.types import FloatArray, IntArray

if TYPE_CHECKING:
    from sapopt.dynamics.battery.model import Battery, BatteryState


@dataclass(frozen=True, eq=False)
class BatteryStates:
    """`LocalModel` of a `Battery`: charge level, and the task that the agent may work on without paying.

    State ``level * (m + 2) + ready``, where `ready` is a task, ``m`` for none, or ``m + 1`` for any (before a first
    step that is free).
    """

    dynamics: Battery
    m: int
    state: BatteryState

    def state_count(self) -> int:
        """Levels times tasks."""
        return (self.dynamics.units.capacity + 1) * (self.m + 2)

    def start(self, agent: int) -> int:
        """State before the first step."""
        ready = int(self.dynamics.serving(self.state)[agent])
        if self.state.held is None:
            ready = self.m + 1
        elif ready < 0:
            ready = self.m
        return int(self.state.levels[agent]) * (self.m + 2) + ready

    def step(self, k: int, agent: int, benefit: FloatArray) -> tuple[IntArray, FloatArray]:
        """Successor and handover, both (states, m)."""
        m, units = self.m, self.dynamics.units
        level, ready = np.divmod(np.arange(self.state_count())[:, None], m + 2)
        task = np.arange(m)[None, :]
        works = (benefit > 0)[None, :] & (level > 0)
        after = np.where(
            works, np.maximum(level - units.drain, 0), np.minimum(level + units.charge, units.capacity)
        )
        after = np.where(level > 0, after, 0)
        stays = works if self.dynamics.pay_for == "entries" else np.ones_like(works)
        successor = after * (m + 2) + np.where(stays, task, m)
        pays = works & (ready != task) & (ready != m + 1)
        handover = np.where(pays, -self.dynamics.cost, 0.0)
        handover = np.where((level == 0) & (benefit > 0)[None, :], -benefit[None, :], handover)
        return successor, handover
