"""The observation of small problems with one state for all: everything, one-hot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sapopt.data.benefits import Benefits
from sapopt.data.types import IntArray
from sapopt.dynamics.base import Model
from sapopt.solvers.base import check_lookahead


@dataclass(frozen=True)
class GlobalSpec:
    """Number of the state, of the agent, and of the step, each one-hot; all tasks can be chosen.

    Parameters
    ----------
    states, agents, tasks : int
        How many there are of each. The state must be a whole number in ``0 .. states - 1``, as that of `Dictator`.
    horizon : int
        Number of steps; 0: the step is not shown, and agents know the state alone.
    """

    states: int = 3
    agents: int = 3
    tasks: int = 3
    horizon: int = 10

    def __post_init__(self) -> None:
        for name in ("states", "agents", "tasks"):
            check_lookahead(getattr(self, name), name)
        if isinstance(self.horizon, bool) or int(self.horizon) != self.horizon or self.horizon < 0:
            raise ValueError(f"horizon must be a whole number of at least 0, got {self.horizon!r}")

    @property
    def size(self) -> int:
        """Numbers in one observation."""
        return self.states + self.agents + self.horizon

    @property
    def steps(self) -> int:
        """Only the present step is looked at."""
        return 1

    @property
    def actions(self) -> int:
        """The tasks, and idling, which is never open: every task is listed."""
        return self.tasks + 1

    def look(
        self, benefits: Benefits, k: int, model: Model, state: Any, step: int
    ) -> tuple[NDArray[np.float32], IntArray]:
        """Observations of all agents, see `sapopt.learning.observation.Spec`."""
        n, m = benefits.shape[1:]
        if (n, m) != (self.agents, self.tasks) or 0 < self.horizon <= step:
            raise ValueError(
                f"this observation is for {self.agents} agents, {self.tasks} tasks and {self.horizon} steps, "
                f"not for {n}, {m} and step {step}"
            )
        if not isinstance(state, (int, np.integer)) or not 0 <= state < self.states:
            raise ValueError(f"this observation needs a state in 0..{self.states - 1}, got {state!r}")
        out = np.zeros((n, self.size), np.float32)
        out[:, int(state)] = 1.0
        out[np.arange(n), self.states + np.arange(n)] = 1.0
        if self.horizon:
            out[:, self.states + self.agents + step] = 1.0
        return out, np.tile(np.arange(m), (n, 1))
