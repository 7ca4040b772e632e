"""Dives over the whole horizon for a first plan, and over one window of it after another, in several threads."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray, root_mean_square
from sapopt.kernels import clock
from sapopt.problem.sap import SAP
from sapopt.solvers.dual_decomposition.dives.candidates import candidates, work_for
from sapopt.solvers.dual_decomposition.dives.kernels import Pace, dive
from sapopt.solvers.dual_decomposition.exchanges.cells import Cells, good_cells
from sapopt.solvers.dual_decomposition.exchanges.rule import pair_rule
from sapopt.solvers.dual_decomposition.plans import Found, Search

PHASE = "dives"

_REGRET = 0.5
"""Loss of the cells that an agent may come to, in typical benefits."""

_WIDEST = 15
"""Most of them at a step."""

_MOST_CELLS = 1_500_000
"""Most of them altogether; the best are kept."""

_COLD, _HOT = 0.03, 0.1
"""Temperatures, in typical benefits."""

_COLDEST = 0.01
"""Least temperature, as a share of what a move costs: what weighs less leaves the range of numbers."""

_ROUNDS, _SHARE, _SURE = 10, 0.02, 0.98
"""Rounds of settling before a fixing, share that is fixed at least, and likelihood from which on a pair is fixed."""

_LENGTHS = (5, 12)
"""Shortest and longest windows."""

_COUNT = 12
"""Windows of every thread in a round without a clock."""

_SECONDS, _TURN_SHARE = 1.0, 0.05
"""Least time of a round, and its share of what is left."""

_PACE = 8e-9
"""Seconds that a dive takes for every candidate, round and fixing, to begin with."""

_WHOLE_SHARE = 0.15
"""Share of the time left that a dive over the whole horizon may be expected to take."""

_LEAST_PART = 4
"""Steps of a thread's part of the horizon."""


@dataclass(eq=False)
class Dives:
    """The dives of a run.

    Attributes
    ----------
    problem : SAP
    rule : PairRule
        Its rule (see `pair_rule`).
    threads : int
        Windows of different parts of the horizon are worked on side by side.
    quiet : int
        Rounds since the last better plan.
    """

    problem: SAP
    rule: Any
    threads: int
    quiet: int = 0
    _whole: bool = True  # whether the whole horizon is still to come
    _prices: FloatArray | None = None
    _cells: Cells = field(default_factory=lambda: np.empty((0, 3), np.int32))
    _works: list[Any] = field(default_factory=list)

    @classmethod
    def of(cls, problem: SAP, threads: int) -> Dives | None:
        """For a problem whose rule allows for them, else None."""
        rule = pair_rule(problem)
        return None if rule is None else cls(problem, rule, threads)

    @property
    def is_full(self) -> bool:
        """Whether most pairs are worth something: then a dive beats a rolling assignment."""
        return bool(self.rule.table.shape[0])

    def glance(self, search: Search) -> Iterator[Found]:
        """A dive over the whole horizon under early prices, if there is time for it; another one may follow."""
        if self._takes_whole(search):
            yield from self.improve(search)
            self._whole = True

    def improve(self, search: Search) -> Iterator[Found]:
        """A round in every thread; the better plan, if there is one."""
        scale = root_mean_square(self.rule.data)
        self._list(search)
        listed = candidates(self.rule, self._cells, search.best, _WIDEST)
        shape = self.problem.T, self.problem.n, self.problem.m
        if not self._works or len(self._works[0].dropped) < len(listed.task):
            self._works = [work_for(listed, shape) for _ in range(self.threads)]
        left = search.seconds_left
        whole = self._whole and self._takes_whole(search)
        self._whole = False
        seconds = math.inf if math.isinf(left) else min(max(_SECONDS, _TURN_SHARE * left), left)
        jobs = self._jobs(search, listed, whole, scale)
        over = np.zeros(1, np.int64)
        until = clock.now() + seconds
        with ThreadPoolExecutor(len(jobs)) as pool:
            asked = [pool.submit(job.whole if whole else job.windows, over, until) for job in jobs]
            try:
                while wait(asked, timeout=0.05).not_done:
                    if search.report(PHASE) or search.seconds_left <= 0.0:
                        over[0] = 1
            finally:
                over[0] = 1
        gains = [one.result() for one in asked]
        if max(gains) > 1e-9 * scale:
            self.quiet = 0
            yield PHASE, jobs[int(np.argmax(gains))].plan
        else:
            self.quiet += 1

    def _list(self, search: Search) -> None:
        """The good cells under the best prices."""
        if self._prices is not search.settled_prices:
            self._prices = search.settled_prices
            regret = _REGRET * root_mean_square(self.rule.data)
            self._cells = good_cells(self.problem, self._prices, regret, _MOST_CELLS)

    def _takes_whole(self, search: Search) -> bool:
        """Whether there is time for a dive over the whole horizon."""
        self._list(search)
        return _PACE * len(self._cells) * _ROUNDS / _SHARE < _WHOLE_SHARE * search.seconds_left

    def _jobs(self, search: Search, listed: Any, whole: bool, scale: float) -> list[_Job]:
        """Whole horizons, each with a plan of its own, or disjoint parts of the horizon of one plan."""
        T, rng = self.problem.T, search.rng
        parts = max(1, min(self.threads, T // (_LEAST_PART + 1)))
        if whole:
            edges = [(0, T)] * self.threads
        else:  # a step between two parts stays as it is, since both look at it
            cuts = np.sort(_LEAST_PART + rng.choice(max(T - 2 * _LEAST_PART, 1), parts - 1, replace=False))
            edges = list(zip([0, *(cuts + 1)], [*cuts, T], strict=True))
        plan = search.best.copy()
        owner = np.full((T, self.problem.m), -1, dtype=np.int32)
        owner[np.arange(T)[:, None], plan] = np.arange(self.problem.n)
        jobs = []
        for number, (first, last) in enumerate(edges):
            own = whole and number > 0
            jobs.append(
                _Job(
                    self, listed, plan.copy() if own else plan, owner.copy() if own else owner, int(first),
                    int(last), np.random.default_rng(rng.integers(2**63)), scale, self._works[number],
                )
            )  # fmt: skip
        return jobs


@dataclass(eq=False)
class _Job:
    """The work of one thread."""

    parent: Dives
    listed: Any
    plan: IntArray
    owner: Any
    first: int
    last: int
    rng: np.random.Generator
    scale: float
    work: Any

    def whole(self, over: Any, until: float) -> float:
        """One dive over all steps; the gain."""
        return max(self._dive(self.first, self.last, over), 0.0)

    def windows(self, over: Any, until: float) -> float:
        """Dives over random windows of the part, till the time is over; what they gained."""
        gained, done = 0.0, 0
        while done < _COUNT if math.isinf(until) else clock.now() < until:
            length = int(self.rng.integers(_LENGTHS[0], _LENGTHS[1] + 1))
            begin = int(self.rng.integers(self.first - length + 2, self.last - 1))
            gained += max(self._dive(max(begin, self.first), min(begin + length, self.last), over), 0.0)
            done += 1
            if over[0]:
                break
        return gained

    def _dive(self, first: int, last: int, over: Any) -> float:
        rule, parent = self.parent.rule, self.parent
        temperature = self.rng.uniform(_COLD, _HOT) * self.scale
        highest = float(rule.matrix.max(initial=0.0)) if rule.matrix.size else rule.cost
        temperature = max(temperature, _COLDEST * highest)
        pace = Pace(temperature, np.exp(-rule.matrix / temperature), _ROUNDS, _SHARE, _SURE)
        assert parent._prices is not None
        return float(
            dive(
                rule, self.listed, pace, self.plan, self.owner, np.arange(parent.problem.n), first, last,
                parent._prices, 0.0, over, self.work,
            )
        )  # fmt: skip
