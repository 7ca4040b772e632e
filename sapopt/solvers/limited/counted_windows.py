"""Parts of a plan solved exactly, on the cells of small reduced cost, where agents may take up only so many tasks.

An agent's take-ups are worth its multiplier each: one that a window saves is free to be used in another. So cells are
chosen where moves cost what they cost, and the multiplier. Over the whole horizon a row for every agent says all about
its limit, and moves cost what they cost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.limited.folded import Folded
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.flow_programme import solve_flow
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import (
    RestrictedFlow,
    near_optimal,
)
from sapopt.solvers.dual_decomposition.network_plans.window_search import (
    GROUP_REGRET,
    REGRETS,
    SHARE_OF_TIME,
    Effort,
    groups_of,
    largest,
    parking_tasks,
    typical_benefit,
)

_LEVELS = 24
"""Different multipliers; those in between are brought to the nearest."""
_THREADS = 2
"""Parts solved at the same time."""
_ALL = 2**62
"""More arcs than any network has."""


@dataclass(frozen=True)
class Count:
    """What a part of a plan has to do with the limits on take-ups.

    Attributes
    ----------
    limited : bool
        Whether no agent may come to have more than it may have, or more than it has.
    priced : bool
        Whether a move costs the agent's multiplier, too.
    """

    limited: bool
    priced: bool


@dataclass(frozen=True, eq=False)
class CountedWindows:
    """The parts of plans of a folded problem at some prices and multipliers.

    Attributes
    ----------
    folded : Folded
    prices : ndarray, shape (T, m)
    dearer : ndarray, shape (n,)
        The multipliers, brought to a few levels.
    levels : sequence of (agents, Arrays)
        The problem as the agents of every level see it.
    """

    folded: Folded
    prices: FloatArray
    dearer: FloatArray
    levels: tuple[tuple[IntArray, Arrays], ...]

    @classmethod
    def of(cls, folded: Folded, prices: FloatArray, dearer: FloatArray) -> CountedWindows:
        """With the multipliers (n,) brought to a few levels."""
        arrays = Arrays.of(folded.problem)
        grid = float(dearer.max(initial=0.0)) / _LEVELS
        near = grid * np.rint(dearer / grid) if grid > 0 else np.zeros(len(dearer))
        levels = tuple(
            (np.flatnonzero(near == more), replace(arrays, cost=arrays.cost + float(more)))
            for more in np.unique(near)
        )
        return cls(folded, prices, near, levels)

    def improved(
        self,
        plan: IntArray,
        effort: Effort,
        shift: int,
        count: Count,
        rng: np.random.Generator,
        seconds_left: Callable[[], float],
    ) -> IntArray:
        """The plan (T, n) with the best of every window that is found in it, every second window at a time.

        What agents have left is dealt out to the windows that are solved at the same time.
        """
        T = self.folded.problem.T
        edges = sorted(
            {min(max(e, 0), T) for e in range(shift - effort.length, T + effort.length, effort.length)}
        )
        windows = list(pairwise(edges))
        for turn in filter(None, (windows[::2], windows[1::2])):  # one window alone has no second turn
            parts = self._dealt(plan, turn, rng)
            with ThreadPoolExecutor(_THREADS) as pool:
                jobs = [
                    pool.submit(self._window, plan, *window, effort, count, more, seed, seconds_left)
                    for window, more, seed in parts
                ]
                plan = plan.copy()
                for (first, last), job in zip(turn, jobs, strict=True):
                    plan[first:last] = job.result()[first:last]
        return plan

    def regrouped(
        self, plan: IntArray, effort: Effort, rng: np.random.Generator, seconds_left: Callable[[], float]
    ) -> IntArray:
        """The plan after groups of agents that compete have found their best paths within their limits.

        Groups that are solved at the same time share no cell: the later one leaves all to the others that they may use.
        """
        problem = self.folded.problem
        T, count = problem.T, Count(limited=True, priced=False)
        parking, groups = self._groups(plan, 0, T, effort, rng)
        with ThreadPoolExecutor(_THREADS) as pool:
            for at in range(0, len(groups), _THREADS):
                if seconds_left() <= 0:
                    break
                closed = np.zeros((T, problem.m), dtype=bool)
                jobs = []
                for group in groups[at : at + _THREADS]:
                    flow = self._fitting(plan, group, 0, T, effort.arcs, parking, closed)
                    closed[flow.step, flow.task] = True
                    jobs.append(
                        (group, pool.submit(self._solved, flow, plan, 0, T, count, None, seconds_left))
                    )
                plan = plan.copy()
                for group, job in jobs:
                    plan[:, group] = job.result()[:, group]
        return plan

    def _dealt(
        self, plan: IntArray, windows: list[tuple[int, int]], rng: np.random.Generator
    ) -> Iterator[tuple[tuple[int, int], IntArray, int]]:
        """The windows, how many take-ups more each agent may have in each of them, and a seed for each."""
        spare = np.maximum(self.folded.most - self.folded.take_ups(plan), 0)
        shares = rng.multinomial(spare, np.full(len(windows), 1.0 / len(windows))).T
        seeds = rng.integers(2**63, size=len(windows))
        return zip(windows, shares, seeds.tolist(), strict=True)

    def _window(
        self,
        plan: IntArray,
        first: int,
        last: int,
        effort: Effort,
        count: Count,
        more: IntArray,
        seed: int,
        seconds_left: Callable[[], float],
    ) -> IntArray:
        """The plan with the best of the steps first .. last - 1 that is found in it."""
        parking, groups = self._groups(plan, first, last, effort, np.random.default_rng(seed))
        for group in groups:
            if seconds_left() <= 0:
                break
            flow = self._fitting(plan, group, first, last, effort.arcs, parking)
            plan = self._solved(flow, plan, first, last, count, more, seconds_left)
        return plan

    def _groups(
        self, plan: IntArray, first: int, last: int, effort: Effort, rng: np.random.Generator
    ) -> tuple[IntArray, list[IntArray]]:
        """Tasks to wait on (n, r), and the agents, in groups that are not too large together."""
        arrays = self.levels[0][1]
        parking = parking_tasks(arrays, plan, first, last, effort.parking, rng)
        everyone = np.arange(arrays.agents)
        regret = GROUP_REGRET * typical_benefit(arrays, first, last)
        flow = self._network(plan, everyone, first, last, regret, parking, self.prices, _ALL)
        return parking, groups_of(flow, arrays.agents, arrays.tasks, effort.arcs, rng)

    def _fitting(
        self,
        plan: IntArray,
        agents: IntArray,
        first: int,
        last: int,
        arcs: int,
        parking: IntArray,
        closed: np.ndarray | None = None,
    ) -> RestrictedFlow:
        """The network of some agents, beside the cells (T, m) that are closed to them and those that others hold."""
        prices = self.prices.copy()
        if closed is not None:
            prices[closed] = np.inf
        others = np.setdiff1d(np.arange(plan.shape[1]), agents)
        window = np.arange(first, last)
        prices[window[:, None], plan[window[:, None], others]] = np.inf

        def network(regret: float, limit: int) -> RestrictedFlow:
            return self._network(plan, agents, first, last, regret, parking, prices, limit)

        return largest(network, REGRETS, typical_benefit(self.levels[0][1], first, last), arcs)

    def _network(
        self,
        plan: IntArray,
        agents: IntArray,
        first: int,
        last: int,
        regret: float,
        parking: IntArray,
        prices: FloatArray,
        limit: int,
    ) -> RestrictedFlow:
        """The network of some agents, agent by agent, at the prices (T, m)."""
        parts = []
        cells = 0
        for members, arrays in self.levels:
            who = np.intersect1d(members, agents)
            agent, step, task, tail, head, value = near_optimal(
                arrays.rows, who, plan, prices, arrays.initial, first, last, last, regret, parking[who], limit
            )
            parts.append((agent, step, task, np.where(tail < 0, -1, tail + cells), head + cells, value))
            cells += len(agent)
        agent, step, task, tail, head, value = (
            np.concatenate(columns) for columns in zip(*parts, strict=True)
        )
        order = np.argsort(agent, kind="stable")
        place = np.empty(cells, dtype=np.int64)
        place[order] = np.arange(cells)
        tail = np.where(tail < 0, -1, place[tail])
        return RestrictedFlow(agent[order], step[order], task[order], tail, place[head], value)

    def _solved(
        self,
        flow: RestrictedFlow,
        plan: IntArray,
        first: int,
        last: int,
        count: Count,
        more: IntArray | None,
        seconds_left: Callable[[], float],
    ) -> IntArray:
        """The plan with the best of a network in it; `more` (n,) is what agents have left for it, None: everything."""
        taken = self._taken(flow, plan, first, last)
        agent = flow.agent[flow.head]
        limits = None
        if count.limited:
            over = self.folded.most - self.folded.take_ups(plan)
            left = self._own(plan, first, last) + np.maximum(
                over if more is None else np.minimum(over, more), 0
            )
            hit = np.flatnonzero(taken)
            rows = sp.csr_array((taken[hit], (agent[hit], hit)), shape=(len(left), len(taken)))
            members = np.unique(flow.agent)
            members = members[self.folded.row[members] >= 0]
            limits = (rows[members], left[members].astype(float)) if len(members) else None
        if not count.priced:
            flow = replace(flow, value=flow.value + taken * self.dearer[agent])
        found = solve_flow(
            flow, plan, self.folded.problem.m, seconds=max(SHARE_OF_TIME * seconds_left(), 0.01),
            stop=lambda: seconds_left() <= 0, limits=limits,
        )  # fmt: skip
        return plan if found is None else found

    def _taken(self, flow: RestrictedFlow, plan: IntArray, first: int, last: int) -> FloatArray:
        """Take-ups of every arc, that at the step after the window with the arc that ends it."""
        agent, task = flow.agent[flow.head], flow.task[flow.head]
        initial = self.folded.problem.initial_assignment
        held = plan[first - 1] if first > 0 else initial
        starts = task if held is None else held[agent]
        taken = (task != np.where(flow.tail < 0, starts, flow.task[flow.tail])).astype(float)
        if last < len(plan):
            ends = flow.step[flow.head] == last - 1
            taken[ends] += task[ends] != plan[last, agent[ends]]
        return taken

    def _own(self, plan: IntArray, first: int, last: int) -> IntArray:
        """Take-ups (n,) of the plan in the window and at the step after it."""
        initial = self.folded.problem.initial_assignment
        own: IntArray = (np.diff(plan[max(first - 1, 0) : last + 1], axis=0) != 0).sum(axis=0)
        return own + (plan[0] != initial) if first == 0 and initial is not None else own
