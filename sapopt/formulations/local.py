"""The finite local states of a problem's agents, whichever way its dynamics tells of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import LocalModel
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.problem.sap import SAP


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


def local_model(problem: SAP) -> LocalModel | None:
    """The agents' finite states, or None where the dynamics does not say that its state is local to the agents.

    A dynamics tells by a method ``local_model(benefits, state) -> LocalModel``, or by a path oracle that has a
    `LocalModel` in its attribute ``model``; `SwitchingCost` needs neither.
    """
    model = problem.model
    if type(model) is SwitchingCost:
        return SwitchingStates(model, problem.m, problem.initial_state())
    if hasattr(model, "local_model"):
        found = model.local_model(problem.benefits, problem.initial_state())
        return found if isinstance(found, LocalModel) else None
    if hasattr(model, "path_oracle"):
        oracle = model.path_oracle(problem.benefits, problem.initial_state())
        for name in ("model", "_model"):
            found = getattr(oracle, name, None)
            if isinstance(found, LocalModel):
                return found
    return None


def not_local(problem: SAP) -> str | None:
    """Why the problem has no local states, or None if it has."""
    if local_model(problem) is not None:
        return None
    return (
        f"{type(problem.dynamics).__name__} does not say that its state splits into one finite state per agent "
        "(method local_model); Exact(method='dp') takes any dynamics of a tiny problem"
    )
