"""Windows of a plan solved exactly, on the cells of small reduced cost, where agents may take up only so many tasks.

An agent's take-ups are worth its multiplier each: one that a window saves is free to be used in another. So moves cost
what they cost, and the multiplier, and a row for every agent keeps what it has left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.limited.folded import Folded
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import (
    RestrictedFlow,
    near_optimal,
    solve_flow,
)
from sapopt.solvers.dual_decomposition.network_plans.window_search import parking_tasks, typical_benefit

_LEVELS = 8
"""Different multipliers; those in between are brought to the nearest."""
_REGRETS = (0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08, 0.05, 0.03)
"""Ladder of reduced costs, in typical benefits."""
_ARCS = 8_000
"""Most arcs of a window."""
_PARKING = 2
"""Random tasks that every agent may use without seeing them."""


@dataclass(frozen=True, eq=False)
class CountedWindows:
    """The windows of a folded problem at some prices and multipliers.

    Attributes
    ----------
    folded : Folded
    prices : ndarray, shape (T, m)
    levels : sequence of (agents, Arrays)
        The problem as the agents of every level see it.
    """

    folded: Folded
    prices: FloatArray
    levels: tuple[tuple[IntArray, Arrays], ...]

    @classmethod
    def of(cls, folded: Folded, prices: FloatArray, dearer: FloatArray) -> CountedWindows:
        """With the multipliers (n,) brought to a few levels."""
        arrays = Arrays.of(folded.problem)
        grid = float(dearer.max(initial=0.0)) / _LEVELS
        level = np.rint(dearer / grid) if grid > 0 else np.zeros(len(dearer))
        groups = tuple(
            (np.flatnonzero(level == number), replace(arrays, cost=arrays.cost + float(number) * grid))
            for number in np.unique(level)
        )
        return cls(folded, prices, groups)

    def improved(
        self,
        plan: IntArray,
        first: int,
        last: int,
        rng: np.random.Generator,
        seconds: float,
        stop: Callable[[], object],
    ) -> IntArray:
        """The plan (T, n) with the best of the steps first .. last - 1 that is found in it."""
        arrays = self.levels[0][1]
        parking = parking_tasks(arrays, plan, first, last, _PARKING, rng)
        scale = typical_benefit(arrays, first, last)
        flow = self._flow(plan, first, last, _REGRETS[0] * scale, parking)
        for regret in _REGRETS[1:]:
            if len(flow.tail) <= _ARCS:
                break
            flow = self._flow(plan, first, last, regret * scale, parking)
        found = solve_flow(
            flow, plan, arrays.tasks, seconds=seconds, stop=stop, limits=self._limits(flow, plan, first, last)
        )
        return plan if found is None else found

    def _flow(
        self, plan: IntArray, first: int, last: int, regret: float, parking: IntArray
    ) -> RestrictedFlow:
        parts = []
        cells = 0
        for agents, arrays in self.levels:
            agent, step, task, tail, head, value = near_optimal(
                arrays.rows, agents, plan, self.prices, arrays.initial, first, last, last, regret, parking[agents],
                _ARCS,
            )  # fmt: skip
            parts.append((agent, step, task, np.where(tail < 0, -1, tail + cells), head + cells, value))
            cells += len(agent)
        return RestrictedFlow(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def _limits(
        self, flow: RestrictedFlow, plan: IntArray, first: int, last: int
    ) -> tuple[sp.csr_array, FloatArray]:
        """Take-ups of every agent in the window and at the step after it, and how many are left for it.

        An agent that has too many of them may keep those that it has.
        """
        T, n = plan.shape
        agent, task = flow.agent[flow.head], flow.task[flow.head]
        initial = self.folded.problem.initial_assignment
        held = plan[first - 1] if first > 0 else initial
        starts = task if held is None else held[agent]
        taken = (task != np.where(flow.tail < 0, starts, flow.task[flow.tail])).astype(float)
        own = (np.diff(plan[max(first - 1, 0) : last + 1], axis=0) != 0).sum(axis=0)
        if first == 0 and initial is not None:
            own = own + (plan[0] != initial)
        if last < T:
            ends = flow.step[flow.head] == last - 1
            taken[ends] += task[ends] != plan[last, agent[ends]]
        left = np.maximum(self.folded.most - (self.folded.take_ups(plan) - own), own)
        hit = np.flatnonzero(taken)
        rows = sp.csr_array((taken[hit], (agent[hit], hit)), shape=(n, len(taken)))
        return rows, left.astype(float)
