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
    """A `SwitchingCost` in plain words: the local state is the task held before, or ``m`` for none (a `LocalModel`).

    Independent of the compiled recursions of `sapopt.dynamics`, so that they can be tested against it.
    """

    dynamics: SwitchingCost
    m: int
    initial: IntArray | None = field(default=None)

    @cached_property
    def _strict(self) -> FloatArray:
        """Handover (m + 1, m) if every move is charged."""
        eta = np.zeros((self.m + 1, self.m))
        cost = np.asarray(self.dynamics.cost, dtype=np.float64)
        eta[: self.m] = -(cost * (1.0 - np.eye(self.m)) if cost.ndim == 0 else cost)
        return eta

    def state_count(self) -> int:
        """Every task, and none."""
        return self.m + 1

    def start(self, agent: int) -> int:
        """Task held before the first step."""
        return self.m if self.initial is None else int(self.initial[agent])

    def step(self, k: int, agent: int, benefit: FloatArray) -> tuple[IntArray, FloatArray]:
        """Successor and handover, both (m + 1, m)."""
        successor = np.broadcast_to(np.arange(self.m), (self.m + 1, self.m))
        eta = self._strict * (benefit > 0) if self.dynamics.idle_is_free else self._strict
        return successor, eta
