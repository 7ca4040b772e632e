"""Tasks that take several agents."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.data.types import IntArray, index_array
from sapopt.dynamics.copies.model import SyntheticSwitching
from sapopt.formulations.synthetic.copies import Forecast, check_decay, copied_labels, copied_tasks, counts
from sapopt.problem.result import Evaluation
from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class SyntheticTasks:
    """A SAP whose tasks are copies; made by `synthetic_tasks`.

    Attributes
    ----------
    base : SAP
        The problem of the real tasks.
    problem : SAP
        The plain problem with their copies: solve this one.
    copies : ndarray of int, shape (base.m,)
        Number of agents that every task takes; its copies are adjacent.
    decay : float
        The r-th agent on a task (from 0) earns ``decay ** r`` of its benefit.
    """

    base: SAP
    problem: SAP
    copies: IntArray
    decay: float

    @property
    def task_of(self) -> IntArray:
        """Real task of every copy, shape ``(problem.m,)``."""
        return np.repeat(np.arange(self.base.m), self.copies)

    def original(self, plan: Any) -> IntArray:
        """Real task of every agent at every step, shape ``(T, n)``; a task may appear several times: the way back."""
        return self.task_of[self.problem.check_plan(plan)]

    def agents_of(self, plan: Any) -> list[list[tuple[int, ...]]]:
        """Agents on every real task at every step: ``agents_of(plan)[k][j]``."""
        return [
            [tuple(np.flatnonzero(row == j).tolist()) for j in range(self.base.m)]
            for row in self.original(plan)
        ]

    def plan(self, tasks: Any) -> IntArray:
        """A plan of the copies in which every agent holds the given real task, ordered so that the value is greatest.

        Of the agents on a task the one that earns most (nothing, if it forfeits its benefit) takes the first copy, and
        so on; no other order is worth more, because the state does not depend on it.

        Parameters
        ----------
        tasks : array_like of int, shape (T, n)
            Real task of every agent.

        Raises
        ------
        ValueError
            If more agents are on a task than it takes.
        """
        real = index_array(tasks, "tasks")
        if real.shape != (self.base.T, self.base.n):
            raise ValueError(f"tasks must have shape {(self.base.T, self.base.n)}, got {real.shape}")
        if real.min() < 0 or real.max() >= self.base.m:
            raise ValueError(f"tasks must hold tasks 0..{self.base.m - 1}")
        first = np.concatenate([[0], np.cumsum(self.copies)])
        benefit = self.base.benefits.at(real)
        out = np.empty_like(real)
        state = self.problem.initial_state()
        rule = self.base.model.entering()
        forfeit = 0.0 if rule is None else rule.forfeit
        for k, row in enumerate(real):
            count = np.bincount(row, minlength=self.base.m)
            if (count > self.copies).any():
                j = int(np.argmax(count - self.copies))
                raise ValueError(
                    f"tasks: {count[j]} agents are on {self.base.naming.task(j)} at {self.base.naming.step(k)}; it "
                    f"takes {self.copies[j]}"
                )
            moved = np.zeros(len(row), dtype=bool) if state is None else state != row
            worth = benefit[k] - np.where(moved, forfeit * np.maximum(benefit[k], 0.0), 0.0)
            order = np.lexsort((np.arange(len(row)), -worth, row))
            ranked = row[order]
            rank = np.arange(len(row)) - np.searchsorted(ranked, ranked)
            out[k, order] = first[ranked] + rank
            state = self.problem.transition(k, state, out[k])
        return out

    def tidied(self, plan: Any) -> IntArray:
        """The same agents on the same tasks in the best order; never worth less."""
        return self.plan(self.original(plan))

    def evaluate(self, tasks: Any) -> Evaluation:
        """Value of the agents' real tasks, scored by `SAP.evaluate` in the best order (see `plan`)."""
        return self.problem.evaluate(self.plan(tasks))

    def forecast(self, forecast: Forecast) -> Forecast:
        """A forecast of the base problem's benefits as one of this problem's."""

        def copied(k: int, steps: int) -> Benefits:
            return copied_tasks(Benefits(forecast(k, steps)), self.copies, self.decay)

        return copied


def synthetic_tasks(problem: SAP, copies: Any, decay: float = 1.0) -> SyntheticTasks:
    """Let every task take several agents.

    Parameters
    ----------
    problem : SAP
        With a `SwitchingCost` of one number, or a `SyntheticSwitching` without copies.
    copies : int or array_like of int, shape (m,)
        How many agents a task takes at most.
    decay : float
        The r-th agent on a task (from 0, best first) earns ``decay ** r`` of its benefit; above 0, at most 1.

    Raises
    ------
    ValueError
        If the problem has another dynamics, or an argument is out of range.
    """
    rule = problem.model.entering()
    if rule is None:
        raise ValueError(
            "problem: synthetic_tasks takes a SwitchingCost of one number or a SyntheticSwitching without copies"
        )
    count = counts(copies, problem.m, "task")
    check_decay(decay)
    start = problem.initial_assignment
    first = np.concatenate([[0], np.cumsum(count)])
    copied = SAP(
        copied_tasks(problem.benefits, count, decay),
        SyntheticSwitching(task_of=np.repeat(np.arange(problem.m), count), **asdict(rule)),
        None if start is None else first[start],
        agents=problem.agents,
        tasks=copied_labels(problem.tasks, count),
        times=problem.times,
    )
    return SyntheticTasks(problem, copied, count, float(decay))
