"""The simple handover model of the thesis: changing task costs, and the state is the previous assignment."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.types import FloatArray, IntArray, real_array
from sapopt.dynamics.base import AgentColumns, Entering, Model, Setting, Switching

if TYPE_CHECKING:
    from sapopt.data.matrices import Matrix
    from sapopt.data.windows import WindowSums
    from sapopt.dynamics.paths.oracles import PathOracle
    from sapopt.dynamics.switching.plain import PlainSwitching
    from sapopt.dynamics.switching.states import SwitchingStates

Held = IntArray | None
"""State: the previous assignment, shape (n,); None before a first step that pays no handover.

-1 stands for an agent that holds nothing that still is there (`sapopt.Session`): whatever it takes up, it pays the cost
of a move. Under a matrix of costs, which has none for that, it pays nothing.
"""


@dataclass(frozen=True, eq=False)
class SwitchingCost(Model):
    """Charge every change of task (thesis, section 4.2: eta(s)_ij = -cost unless agent i held task j).

    A subclass that changes the rule is a rule of its own. Nothing that this class says beyond its rule is believed of
    it: solvers take the generic way, and bounds need a ``local_model`` of the new rule.

    Parameters
    ----------
    cost : float or array_like of shape (m, m)
        Not negative. Entry ``[a, b]`` of a matrix is the cost of moving from task a to task b; its diagonal is zero.
    idle_is_free : bool
        Charge only a move to a task whose benefit at that step is positive (thesis, section 6.3). An idle agent may
        then take the task it will serve next before that task is worth anything, and never pays for it.

    Raises
    ------
    ValueError
        If a cost is negative or not finite, or the matrix is not square with a zero diagonal.
    """

    handover_limit = 0.0
    """Largest entry that the handover matrix can have."""

    cost: float | FloatArray
    idle_is_free: bool = False
    benefits: Benefits | None = field(default=None, repr=False, kw_only=True)

    def __post_init__(self) -> None:
        cost = real_array(self.cost, "cost")
        if cost.ndim == 2 and cost.shape[0] == cost.shape[1]:
            if np.diagonal(cost).any():
                raise ValueError(
                    "cost: the diagonal must be zero, since staying on a task is no change of task"
                )
        elif cost.ndim != 0:
            raise ValueError(f"cost must be a number or an (m, m) matrix, got shape {cost.shape}")
        if not isinstance(self.idle_is_free, (bool, np.bool_)):
            raise ValueError(f"idle_is_free must be True or False, got {self.idle_is_free!r}")
        if not np.isfinite(cost).all() or (cost < 0).any():
            raise ValueError("cost must be finite and not negative (it is subtracted from the benefit)")
        object.__setattr__(self, "cost", float(cost) if cost.ndim == 0 else cost)

    @property
    def is_uniform(self) -> bool:
        """Whether every charged move costs the same."""
        return isinstance(self.cost, float)

    def validate(self, problem: Setting) -> None:
        """Check that the cost fits the number of tasks."""
        if not self.is_uniform and np.shape(self.cost) != (problem.m, problem.m):
            raise ValueError(f"cost has shape {np.shape(self.cost)}, but the benefits have {problem.m} tasks")

    def bind(self, benefits: Benefits) -> SwitchingCost:
        """A copy that knows the benefits, for their shape and, if idling is free, their signs."""
        return replace(self, benefits=benefits)

    def initial_state(self, problem: Setting) -> Held:
        """The initial assignment, or None."""
        return problem.initial_assignment

    def transition(self, k: int, state: Held, assignment: IntArray) -> Held:
        """The assignment itself."""
        return assignment

    def key(self, state: Held) -> bytes:
        """Fingerprint of a state."""
        return b"" if state is None else state.tobytes()

    def agent_columns(self, state: Held) -> AgentColumns | None:
        """What every agent holds."""
        return None if state is None else AgentColumns({"held": state}, {})

    def of_columns(self, columns: AgentColumns) -> Held:
        """What every agent holds."""
        return columns.tasks["held"]

    def handover(self, k: int, state: Held) -> FloatArray:
        """Handover matrix, shape ``(n, m)``; zero if `state` is None."""
        benefits = self._bound()
        _, n, m = benefits.shape
        if state is None:
            return np.zeros((n, m))
        if self.is_uniform:
            eta = np.full((n, m), -float(self.cost))
            holds = np.flatnonzero(state >= 0)
            eta[holds, state[holds]] = 0.0
        else:
            eta = np.where((state >= 0)[:, None], -np.asarray(self.cost)[state], 0.0)
        if self.idle_is_free:
            eta = np.where(dense_step(benefits.step(k)) > 0, eta, 0.0)
        return eta + 0.0  # no negative zeros

    def handover_at(self, k: int, state: Held, assignment: IntArray) -> FloatArray:
        """Handover of every agent under an assignment, shape ``(n,)``."""
        if state is None:
            return np.zeros(len(assignment))
        if self.is_uniform:
            eta = np.where(assignment == state, 0.0, -float(self.cost))
        else:
            eta = np.where(state >= 0, -np.asarray(self.cost)[state, assignment], 0.0) + 0.0
        if self.idle_is_free:
            worth = self._bound().slice(k, k + 1).at(assignment[None])[0]
            eta = np.where(worth > 0, eta, 0.0)
        return eta

    def interval(self, windows: WindowSums, start: int, stop: int, state: Held) -> Matrix:
        """Benefit of holding one assignment over ``start .. stop - 1``: window sum plus the handover at `start`."""
        from sapopt.data.matrices import GainMatrix

        if not windows.is_sparse or not self.is_uniform:
            return windows.dense(start, stop) + self._dense_handover(windows, start, state)
        from sapopt.kernels.windows import listed_gain

        cost = float(self.cost)
        n, m = windows.n, windows.m
        if state is None:
            rows = windows.gains(start, stop, 0.0)
            return GainMatrix(*rows.arrays, np.full(n, -1), np.zeros(n), 0.0, m, rows.has_negative)
        plain = windows.gains(start, stop, 0.0)
        if self.idle_is_free:
            held_gain = listed_gain(*plain.arrays, state, 0.0)
            rows = windows.gains(start, stop, cost)
            return GainMatrix(*rows.arrays, state, held_gain, 0.0, m, rows.has_negative)
        held_gain = listed_gain(*plain.arrays, state, cost)
        return GainMatrix(*plain.arrays, state, held_gain, -cost, m, plain.has_negative)

    def path_oracle(self, benefits: Benefits, state: Held) -> PathOracle:
        """Longest priced paths of the agents (`sapopt.dynamics.paths.oracles.PathOracle`)."""
        from sapopt.dynamics.switching.paths import oracle

        return oracle(benefits, self, state)

    def local_model(self, benefits: Benefits, state: Held) -> SwitchingStates:
        """The agents' finite states in plain form (`sapopt.dynamics.paths.oracles.LocalModel`)."""
        from sapopt.dynamics.switching.states import SwitchingStates

        return SwitchingStates(self, int(benefits.shape[2]), state)

    def switching(self) -> Switching:
        """The parameters."""
        return Switching(self.cost, self.idle_is_free)

    def entering(self) -> Entering | None:
        """The parameters, if there is one cost."""
        cost = self.switching().uniform_cost
        return None if cost is None else Entering(cost, idle_is_free=self.idle_is_free)

    def plain(self, problem: Setting) -> PlainSwitching:
        """The rule once more, for verifying."""
        from sapopt.dynamics.switching.plain import PlainSwitching

        return PlainSwitching(self.switching(), problem)

    def _dense_handover(self, windows: WindowSums, start: int, state: Held) -> FloatArray:
        if state is None:
            return np.zeros((windows.n, windows.m))
        strict = replace(self, idle_is_free=False, benefits=windows.benefits).handover(start, state)
        return strict * (windows.dense(start, start + 1) > 0) if self.idle_is_free else strict

    def _bound(self) -> Benefits:
        if self.benefits is None:
            raise ValueError("this SwitchingCost belongs to no problem yet; ask problem.handover(k, state)")
        return self.benefits
