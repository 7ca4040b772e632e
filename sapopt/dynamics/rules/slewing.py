"""Attitude: a move costs more the farther the satellite has to turn (thesis, section 7.1.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray, checked_cost, real_array
from sapopt.dynamics.base import AgentColumns, Setting
from sapopt.dynamics.rules.agent_local import AgentLocal, LocalStates

NADIR = -1
"""Local state of a satellite that points straight down."""
ANYWHERE = -2
"""Local state before a first step that pays no handover."""


@dataclass(frozen=True, eq=False)
class SlewCost(AgentLocal):
    """Charge a satellite for every turn to a task that it sees: `cost` times the slew angle in radians.

    A satellite that serves a task follows it, without cost, as long as the task is seen (its benefit is positive). To
    serve another one it turns from the direction of the old to that of the new task, both as seen from where it is at
    that step. A satellite that idles goes back to nadir, in its own time and without cost, and turns from there next.
    The local state is the task pointed at, or nadir.

    Parameters
    ----------
    cost : float
        Cost of a slew through one radian, not negative.
    satellites_km : array_like, shape (T, n, 3)
        Positions of the satellites at each step, from the centre of the Earth.
    targets_km : array_like, shape (p, 3)
        Positions of tasks 0 .. p - 1 in the same frame. Tasks from p on have no place and must have no benefit.

    Raises
    ------
    ValueError
        If the cost is negative, or the positions are malformed.
    """

    cost: float
    satellites_km: FloatArray
    targets_km: FloatArray
    handover_limit = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "cost", checked_cost(self.cost))
        for name, axes in (("satellites_km", 3), ("targets_km", 2)):
            array = real_array(getattr(self, name), name)
            if array.ndim != axes or array.shape[-1] != 3 or not np.isfinite(array).all():
                raise ValueError(
                    f"{name} must be finite, of shape {'(T, n, 3)' if axes == 3 else '(p, 3)'}, got {array.shape}"
                )
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        return f"SlewCost(cost={self.cost} per radian)"

    def validate(self, problem: Setting) -> None:
        """Check that the positions fit the problem."""
        steps, n, _ = self.satellites_km.shape
        if steps < problem.T or n != problem.n:
            raise ValueError(
                f"satellites_km has shape {self.satellites_km.shape}, but the problem has {problem.T} steps and "
                f"{problem.n} agents"
            )
        flat = problem.benefits.flat()
        if (flat.data[flat.data > -np.inf] < 0).any():
            raise ValueError(
                "benefits must not be negative here: a task is seen where its benefit is positive"
            )
        if int(flat.indices.max(initial=-1)) >= len(self.targets_km):
            raise ValueError(
                f"targets_km has {len(self.targets_km)} places, but task {flat.indices.max()} has a benefit as well"
            )

    def start(self, problem: Setting) -> IntArray:
        """The initial tasks where they are seen at the first step, else nadir."""
        held = problem.initial_assignment
        if held is None:
            return np.full(problem.n, ANYWHERE)
        seen = problem.benefits.slice(0, 1).at(held[None])[0] > 0
        return np.where(seen, held, NADIR)

    def agent_columns(self, state: LocalStates) -> AgentColumns:
        """The target that every satellite points to, or where it points else."""
        return AgentColumns({"target": np.where(state.local >= 0, state.local, -1)}, {"local": state.local})

    def of_columns(self, columns: AgentColumns) -> LocalStates:
        """Satellites whose target is there no more point down."""
        target, local = columns.tasks["target"], columns.values["local"]
        return LocalStates(0, np.where(target >= 0, target, np.where(local < 0, local, NADIR)))

    def rule(
        self, k: int, agent: IntArray, local: IntArray, task: IntArray, benefit: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Slew from the old to the new direction; idle satellites point down."""
        seen = benefit > 0
        angle = np.zeros(len(agent))
        turns = np.flatnonzero(seen & (local != ANYWHERE) & (local != task))
        here = self.satellites_km[k, agent[turns]]
        before = local[turns]
        old = np.where((before == NADIR)[:, None], 0.0, self.targets_km[before]) - here
        angle[turns] = angle_rad(old, self.targets_km[task[turns]] - here)
        return -self.cost * angle, np.where(seen, task, NADIR)


def angle_rad(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angles (…,) between vectors (…, 3), accurate for small and large ones."""
    across = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.arctan2(across, (a * b).sum(axis=-1)))
