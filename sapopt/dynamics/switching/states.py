"""The local states of a `SwitchingCost` in plain words: what every compiled recursion is tested against."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sapopt.data.types import FloatArray, IntArray

if TYPE_CHECKING:
    from sapopt.dynamics.switching.model import SwitchingCost


@dataclass(frozen=True, eq=False)
class SwitchingStates:
    """A `SwitchingCost` in plain words: the local state is the task held before (a `LocalModel`).

    ``m`` stands for a first step that is free, ``m + 1`` for an agent that holds nothing and pays for every move.

    Independent of the compiled recursions of `sapopt.dynamics`, so that they can be tested against it.
    """

    dynamics: SwitchingCost
    m: int
    initial: IntArray | None = field(default=None)

    @cached_property
    def _strict(self) -> FloatArray:
        """Handover (m + 2, m) if every move is charged."""
        eta = np.zeros((self.m + 2, self.m))
        cost = np.asarray(self.dynamics.cost, dtype=np.float64)
        eta[self.m + 1] = -cost if cost.ndim == 0 else 0.0
        eta[: self.m] = -(cost * (1.0 - np.eye(self.m)) if cost.ndim == 0 else cost)
        return eta

    def state_count(self) -> int:
        """Every task, and the two kinds of none."""
        return self.m + 2

    def start(self, agent: int) -> int:
        """Task held before the first step."""
        if self.initial is None:
            return self.m
        return int(self.initial[agent]) if self.initial[agent] >= 0 else self.m + 1

    def step(self, k: int, agent: int, benefit: FloatArray) -> tuple[IntArray, FloatArray]:
        """Successor and handover, both (m + 2, m)."""
        successor = np.broadcast_to(np.arange(self.m), (self.m + 2, self.m))
        eta = self._strict * (benefit > 0) if self.dynamics.idle_is_free else self._strict
        return successor, eta
