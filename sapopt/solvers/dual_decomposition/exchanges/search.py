"""One annealing after another from the best plan, in several threads, each hotter or colder than the next."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray, root_mean_square
from sapopt.kernels import clock
from sapopt.problem.sap import SAP
from sapopt.solvers.dual_decomposition.exchanges.cells import Cells, good_cells
from sapopt.solvers.dual_decomposition.exchanges.kernels import anneal
from sapopt.solvers.dual_decomposition.exchanges.rule import pair_rule
from sapopt.solvers.dual_decomposition.plans import Found, Search

PHASE = "exchanges"

_HEATS = (0.35, 0.2, 0.1, 0.05)
"""First temperatures, in typical benefits. The hottest forgets most of the plan: it is for poor plans and much time."""

_COLDER, _GOOD_GAP = 2, 0.01
"""Where the temperatures begin if the plan is good already (its gap small), or time is short."""

_COLD = 0.15
"""The last temperature, as a share of the first."""

_QUENCH = 0.06
"""Share of the moves that are made last, without taking a loss."""

_REGRET = 0.2
"""Loss of the cells that moves lead to, in typical benefits."""

_WANDERING = 0.1
"""Share of the moves to free tasks of no promise: where to wait."""

_MOVES_PER_CELL = 100
"""Moves of the first annealing for every cell; later ones are longer."""

_LONGEST = 8
"""Without a time limit no annealing is longer than so many first ones."""

_LONGEST_BY_THE_CLOCK = 1e9
"""The same with one, which ends it long before; doubling goes on for ever where rounds are cut short."""

_SLICE = 0.02
"""Seconds between two looks at the clock."""

_CHUNK = 10_000
"""Moves between two changes of the temperature where no clock counts."""

_FIRST_SHARE, _LARGEST_SHARE = 0.1, 0.5
"""Shares of the time left that the first annealing may take, of which nothing is known, and any other one."""


@dataclass(eq=False)
class Exchanges:
    """The annealings of a run, with what they have learnt: how long and how hot.

    Attributes
    ----------
    problem : SAP
    rule : PairRule
        Its rule (see `pair_rule`).
    threads : int
        Annealings side by side, at different temperatures; the best plan of them is kept.
    quiet : int
        Annealings since the last better plan; each was twice as long as the one before.
    """

    problem: SAP
    rule: Any
    threads: int
    quiet: int = 0
    _heat: int | None = None
    _factor: float = 1.0
    _pace: float = 1e6  # moves a second of one thread
    _prices: FloatArray | None = None
    _cells: Cells = field(default_factory=lambda: np.empty((0, 3), np.int32))

    @classmethod
    def of(cls, problem: SAP, threads: int) -> Exchanges | None:
        """For a problem whose rule allows for them, else None."""
        rule = pair_rule(problem)
        return None if rule is None else cls(problem, rule, threads)

    def improve(self, search: Search) -> Iterator[Found]:
        """One annealing in every thread; the better plan, if there is one."""
        scale = root_mean_square(self.rule.data)
        if self._prices is not search.settled_prices:
            self._prices = search.settled_prices
            self._cells = good_cells(self.problem, self._prices, _REGRET * scale)
        moves = int(self._factor * _MOVES_PER_CELL * max(len(self._cells), 100))
        share = _FIRST_SHARE if self._heat is None else _LARGEST_SHARE
        seconds = min(moves / self._pace, share * search.seconds_left)
        hurried = seconds < moves / self._pace
        if math.isinf(search.seconds_left):
            seconds = math.inf
        if self._heat is None:
            self._heat = _COLDER if hurried or search.gap < _GOOD_GAP else 0
        heats = [(self._heat + thread) % len(_HEATS) for thread in range(self.threads)]
        jobs = [
            _Annealing(self, search.best.copy(), search.rng.integers(1, 2**31 - 400, size=2), _HEATS[heat] * scale)
            for heat in heats
        ]  # fmt: skip
        over = threading.Event()
        with ThreadPoolExecutor(self.threads) as pool:
            asked = [pool.submit(job.run, moves, seconds, over) for job in jobs]
            try:
                while wait(asked, timeout=0.1).not_done:
                    if search.report(PHASE):
                        over.set()
            finally:
                over.set()
        for one in asked:
            one.result()
        best = max(range(self.threads), key=lambda t: jobs[t].gained)
        if jobs[best].gained > 1e-9 * scale:
            self.quiet, self._heat = 0, heats[best]
            yield PHASE, jobs[best].plan
        else:
            self.quiet += 0 if hurried else 1
            self._heat = (self._heat + self.threads) % len(_HEATS)
            most = float(_LONGEST) if math.isinf(seconds) else _LONGEST_BY_THE_CLOCK
            self._factor = min(2.0 * self._factor, most)
        self._pace = max(job.pace for job in jobs)


@dataclass(eq=False)
class _Annealing:
    """One of them: what it works on, and what came of it."""

    parent: Exchanges
    plan: IntArray
    dice: IntArray
    hot: float
    gained: float = 0.0
    pace: float = 1e6

    def run(self, moves: int, seconds: float, over: threading.Event) -> None:
        """Make so many moves, or as many as fit into the seconds."""
        rule, cells = self.parent.rule, self.parent._cells
        plan, problem = self.plan, self.parent.problem
        owner = np.full((problem.T, problem.m), -1, dtype=np.int32)
        owner[np.arange(problem.T)[:, None], plan] = np.arange(problem.n)
        wandering = _WANDERING if problem.n < problem.m else 0.0  # else no task is ever free
        began, made, chunk = clock.now(), 0, _CHUNK
        while True:
            spent = clock.now() - began
            done = made / moves if math.isinf(seconds) else spent / max(seconds, 1e-9)
            if done >= 1.0 or over.is_set():
                break
            cooling = done / (1.0 - _QUENCH)
            temperature = self.hot * _COLD**cooling if cooling < 1.0 else 0.0
            if math.isinf(seconds):
                chunk = min(_CHUNK, moves - made)
            self.gained += anneal(rule, cells, plan, owner, self.dice, temperature, chunk, wandering)
            made += chunk
            if math.isfinite(seconds):
                self.pace = made / max(clock.now() - began, 1e-9)
                chunk = max(100, int(self.pace * _SLICE))
