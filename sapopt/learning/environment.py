"""A sequential assignment problem as an environment on arrays: states, assignments, one reward for every agent.

Two reward rules. If conflicts are forbidden (a SAP), agent i earns its entry of beta_hat for its task. If they are
*shared*, any joint choice is allowed, and of the q holders of a task each earns a q-th of its own entry of beta_hat
where that is positive, and pays it in full where it is negative: handovers and batteries are everybody's own. For
assignments without conflicts both rules agree.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.data.windows import WindowSums
from sapopt.learning.observation import Spec
from sapopt.problem.sap import SAP
from sapopt.running.chance import Chance, Seed, follow
from sapopt.running.outlook import Outlook


class Environment:
    """One episode of a problem, step by step.

    Parameters
    ----------
    problem : SAP
    conflicts_shared : bool
        Allow several agents on one task; see the module documentation for the reward.
    chance : Chance, optional
        Draws the state that follows a step, in place of the problem's own transition.
    seed : int or sequence of int
        Of those draws: the same seed and the same assignments make the same episode.

    Raises
    ------
    ValueError
        If the problem has capacities, idleness or limits.
    """

    def __init__(
        self, problem: SAP, conflicts_shared: bool = False, chance: Chance | None = None, seed: Seed = 0
    ) -> None:
        if not problem.is_plain:
            raise ValueError("problem: environments know no capacities, idleness or limits; leave them out")
        self.problem = problem
        self.conflicts_shared = conflicts_shared
        self.chance, self.seed = chance, seed
        self._parking = np.arange(problem.m)
        self.reset()

    def reset(self) -> None:
        """Back to the step before the first."""
        self.k = 0
        self.state: Any = self.problem.initial_state()
        self._windows = WindowSums(self.problem.benefits)

    @property
    def done(self) -> bool:
        """Whether all steps are played."""
        return self.k == self.problem.T

    def outlook(self) -> Outlook:
        """What a policy may know now."""
        self._windows.forget(before=self.k)
        return Outlook(self.k, self.problem.T, self.state, self.problem, self._windows, self._parking)

    def observe(self, spec: Spec) -> tuple[np.ndarray, IntArray]:
        """Observations of all agents now, and the tasks that they list (see `Spec.look`)."""
        problem = self.problem
        return spec.look(problem.benefits, self.k, problem.model, self.state, self.k)

    def step(self, assignment: IntArray) -> FloatArray:
        """Play one assignment.

        Parameters
        ----------
        assignment : ndarray of int64, shape (n,)

        Returns
        -------
        ndarray of float64, shape (n,)
            Reward of every agent; without chance the sum is the step's part of ``SAP.evaluate``.

        Raises
        ------
        ValueError
            If the episode is over, a task is out of range, or two agents share a task and that is forbidden.
        """
        if self.done:
            raise ValueError("the episode is over; call reset()")
        problem = self.problem
        if not self.conflicts_shared:
            assignment = problem.check_assignment(assignment, self.k)
        rewards = self._entries(assignment)
        if self.conflicts_shared:
            holders = np.bincount(assignment, minlength=problem.m)[assignment]
            rewards = np.where(rewards > 0, rewards / holders, rewards)
        self.state = follow(problem, self.chance, self.seed, self.k, self.state, assignment)
        self.k += 1
        return rewards

    def _entries(self, assignment: IntArray) -> FloatArray:
        """beta_hat of every agent's task."""
        problem, k = self.problem, self.k
        benefit = problem.benefits.slice(k, k + 1).at(assignment[None])[0]
        return np.asarray(benefit + problem.model.handover_at(k, self.state, assignment))
