"""What an agent sees where the state is more than the previous assignment: beta_hat in its state, for any dynamics.

`ThesisObservation` shows static benefits and who held what, which says nothing of where a driver is or for how long a
unit has been on. Here the present step is shown as beta_hat(s_k), so that every handover is seen, whatever it depends
on; and the numbers that a model declares of its agents' states (`sapopt.dynamics.base.Model.features`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Model
from sapopt.problem.sap import SAP
from sapopt.solvers.base import check_lookahead


@dataclass(frozen=True)
class StateObservation:
    """Sizes of an observation for dynamics of any kind. `StateObservation.of` fits them to a problem.

    ======================  ======================================================================================
    numbers                 content
    ======================  ======================================================================================
    M L                     beta_hat of the M best tasks now, their benefits at the next L - 1 steps
    N M L                   the same of the N neighbours for those same tasks
    1                       beta_hat of a task that is worth nothing to the agent, such as an idle one
    (1 + N) F               features of the agent and of the neighbours
    ======================  ======================================================================================

    An agent's tasks are those whose benefit is not zero at one of the L steps, best sum first; a task that costs
    something is listed too, so that it can be told from idling. Its neighbours have the largest positive sum for one of
    them. Pairs that are forbidden now are not listed.

    Parameters
    ----------
    tasks, neighbours, steps : int
        M, N and L.
    features : int
        F, the numbers that the model declares of an agent's state.
    unit : float
        Benefits are shown in this unit, positive.

    Raises
    ------
    ValueError
        If a size is out of range.
    """

    tasks: int = 10
    neighbours: int = 5
    steps: int = 3
    features: int = 0
    unit: float = 1.0

    def __post_init__(self) -> None:
        for name in ("tasks", "neighbours", "steps"):
            check_lookahead(getattr(self, name), name)
        if isinstance(self.features, bool) or int(self.features) != self.features or self.features < 0:
            raise ValueError(f"features must be a whole number of at least 0, got {self.features!r}")
        if not 0 < self.unit < np.inf:
            raise ValueError(f"unit must be positive, got {self.unit!r}")

    @classmethod
    def of(cls, problem: SAP, tasks: int = 10, neighbours: int = 5, steps: int = 3) -> StateObservation:
        """The observation for a problem: its model's features, and the mean size of its benefits as the unit."""
        shown = problem.model.features(problem.initial_state())
        entries = np.abs(problem.benefits.flat().data)
        entries = entries[np.isfinite(entries) & (entries > 0)]
        unit = float(entries.mean()) if len(entries) else 1.0
        return cls(tasks, neighbours, steps, 0 if shown is None else shown.shape[1], unit)

    @property
    def size(self) -> int:
        """Numbers in one observation."""
        return (1 + self.neighbours) * (self.tasks * self.steps + self.features) + 1

    @property
    def actions(self) -> int:
        """Outputs of a network: the M tasks, and any other task."""
        return self.tasks + 1

    def look(
        self, benefits: Benefits, k: int, model: Model, state: Any, step: int
    ) -> tuple[NDArray[np.float32], IntArray]:
        """Observations of all agents, see `sapopt.learning.observation.Spec.look`.

        Raises
        ------
        ValueError
            If the model declares another number of features.
        """
        n, m = benefits.shape[1:]
        shown = self._features(model, state, n)
        window = np.zeros((self.steps, n, m))
        last = min(k + self.steps, benefits.shape[0])
        for at in range(k, last):
            window[at - k] = dense_step(benefits.step(at))
        known = (window != 0).any(axis=0)
        window[0] += model.handover(step, state)
        allowed = np.isfinite(window[0])
        window = np.where(np.isfinite(window), window, 0.0)
        total = window.sum(axis=0)
        listed = _best(np.where(known & allowed, total, -np.inf), self.tasks)
        near = _neighbours(np.where(known & allowed, total, 0.0), listed, self.neighbours)

        agents = np.concatenate([np.arange(n)[:, None], near], axis=1)  # (n, 1 + N), -1 for none
        seen = window[:, agents[:, :, None], listed[:, None, :]].transpose(1, 2, 3, 0) / self.unit
        seen = np.where((agents >= 0)[:, :, None, None] & (listed >= 0)[:, None, :, None], seen, 0.0)
        others = ~known & allowed
        idle = np.where(others, window[0], 0.0).sum(axis=1) / np.maximum(others.sum(axis=1), 1)
        facts = np.where((agents >= 0)[:, :, None], shown[agents], 0.0)
        parts = [seen.reshape(n, -1), idle[:, None] / self.unit, facts.reshape(n, -1)]
        return np.concatenate(parts, axis=1).astype(np.float32), listed

    def _features(self, model: Model, state: Any, n: int) -> FloatArray:
        found = model.features(state)
        shown = np.zeros((n, 0)) if found is None else found
        if shown.shape != (n, self.features):
            raise ValueError(
                f"this observation has {self.features} features of an agent's state, but {model.called} declares "
                f"{shown.shape[1]}; StateObservation.of(problem) fits it"
            )
        return shown


def _best(score: FloatArray, count: int) -> IntArray:
    """The `count` tasks (n, count) of the highest score, ties by number; -1 where there are no more."""
    order = np.argsort(-score, axis=1, kind="stable")[:, :count]
    found = np.where(np.take_along_axis(score, order, axis=1) > -np.inf, order, -1)
    return np.pad(found, ((0, 0), (0, count - found.shape[1])), constant_values=-1)


def _neighbours(total: FloatArray, listed: IntArray, count: int) -> IntArray:
    """Other agents (n, count) with the largest positive sum for one of an agent's tasks, ties by number."""
    n = len(total)
    rivalry = np.full((n, n), -np.inf)
    for i in range(n):
        tasks = listed[i][listed[i] >= 0]
        if len(tasks):
            rivalry[i] = total[:, tasks].max(axis=1)
    rivalry[rivalry <= 0] = -np.inf
    np.fill_diagonal(rivalry, -np.inf)
    return _best(rivalry, count)
