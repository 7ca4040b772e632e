"""The planner of folded problems whose agents may take up only so many tasks.

Prices and multipliers first, then one assignment a step by the agents' best ways on, at what moves cost with the
multipliers. Windows of that plan are solved exactly, while the multipliers of agents that have too many take-ups rise.
What is still too much is repaired at last: agent by agent, the best free path within the limit.
"""

from __future__ import annotations

import contextlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from sapopt.data.assignment import best_assignment
from sapopt.data.benefits import dense_step
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.limited.folded import Folded
from sapopt.formulations.limited.folded_dual import FoldedDual, FoldedPaths, descend
from sapopt.formulations.limited.joint_descent import descend_jointly
from sapopt.kernels import clock
from sapopt.kernels.blocks import in_blocks, work_array
from sapopt.running.control import Run
from sapopt.solvers.base import Outcome
from sapopt.solvers.dual_decomposition.plans import closed_prices
from sapopt.solvers.limited.counted_kernels import counted_scratch, counted_sweep, priced_firsts, priced_moves
from sapopt.solvers.limited.counted_windows import CountedWindows
from sapopt.solvers.limited.planner import Search, outcome_of

_DUAL_SHARE = 0.35
"""Share of the time that the prices may take."""
_LENGTH, _SHIFTS = 10, 3
"""Steps of a window, and how many ways there are to cut the horizon into windows."""
_RISE = 0.02
"""By which a multiplier rises after a round for every take-up that is too much, in typical benefits."""
_EVERY = 4
"""Rounds between two repairs."""
_FREE_SHARE, _FREE_ROUNDS = 0.75, 40
"""Share of the time after the prices, and most rounds, in which plans may have too many take-ups."""
_QUIET = 6
"""Rounds of plans within the limits without a better one after which the search ends."""
_REPAIRS = (1.0, 0.5, 0.0)
"""Shares of the prices under which the agents take their best free paths, one sweep after another."""
_WINDOW_SHARE = 0.1
"""Share of the time left that one window may take."""


def plan_counted(folded: Folded, run: Run, tolerance: float, name: str) -> Outcome:
    """Find a plan of a folded problem, and prove it as far as time allows.

    Raises
    ------
    SolverError
        If time ended before any plan was found.
    """
    search = Search(folded.given, run, name, tolerance)
    if run.start is not None:
        search.offer(run.start, "start")
    with contextlib.suppress(InfeasibleError):  # forbidden pairs may leave no such plan
        search.offer(_standing(folded), "start")
    paths = FoldedPaths(folded)
    prices = descend if folded.is_plain else descend_jointly
    dual = prices(
        folded, paths, clock.now() + _DUAL_SHARE * run.seconds_left,
        lambda _, bound: search.report(-np.inf, bound),
    )  # fmt: skip
    search.bound = dual.bound
    search.note("prices")
    with contextlib.suppress(KeyboardInterrupt):
        _Rounds(folded, paths, search, dual).go()
    return outcome_of(search, dual.all_prices(folded))


def _standing(folded: Folded) -> IntArray:
    """The best plan (T, n) in which nobody takes up anything."""
    problem = folded.problem
    held = problem.initial_assignment
    if held is None:
        held = best_assignment(dense_step(problem.benefits.window(0, problem.T)), np.arange(problem.m)).tasks
    return np.tile(held, (problem.T, 1))


@dataclass
class _Rounds:
    """The search for plans after the prices."""

    folded: Folded
    paths: FoldedPaths
    search: Search
    dual: FoldedDual

    def go(self) -> None:
        """Round by round, until the time is over or nothing is gained."""
        run, folded = self.search.run, self.folded
        plan = self._rolled()
        if plan is None:
            plan = self.search.best
        if plan is None:
            return
        self._offer(plan)
        began, within, quiet, number = run.seconds_left, False, 0, 0
        dearer = self.dual.dearer
        while not run.expired and not self.search.is_proven and quiet < _QUIET:
            before = self.search.value
            plan = self._windows(plan, CountedWindows.of(folded, self.dual.prices, dearer), number)
            over = np.maximum(folded.take_ups(plan) - folded.most, 0)
            dearer = dearer + _RISE * self.paths.plain.scale * over
            number += 1
            if within or number % _EVERY == 0 or run.expired:
                self._offer(plan)
            late = number >= _FREE_ROUNDS or run.seconds_left < (1.0 - _FREE_SHARE) * began
            if not within and (late or not over.any()) and self.search.best is not None:
                self._offer(plan)
                plan, within, dearer = self.search.best, True, self.dual.dearer
            quiet = quiet + 1 if within and self.search.value <= before else 0
            if self.search.report(self.search.value, self.search.bound):
                break

    def _offer(self, plan: IntArray) -> None:
        """The plan repaired, if it has to be."""
        folded, prices = self.folded, self.dual.prices
        taken = folded.take_ups(plan)
        if (taken <= folded.most).all():
            self.search.offer(plan, "windows")
            return
        order = np.flatnonzero(taken > folded.most)
        for share in _REPAIRS:
            plan = self._swept(plan, share * prices, order)
            self.search.offer(plan, "repair")
            order = self.search.run.rng.permutation(folded.problem.n)

    def _swept(self, plan: IntArray, prices: FloatArray, order: IntArray) -> IntArray:
        """The plan after some agents have moved to their best free paths within the limits, one by one."""
        problem, most = self.folded.problem, self.folded.most
        layers = int(most[most < problem.T].max(initial=0))
        out = plan.copy()
        counted_sweep(
            order, self.paths.plain.window, most, closed_prices(prices, plan), prices, out,
            counted_scratch(problem.T, layers, problem.m),
        )  # fmt: skip
        return out

    def _rolled(self) -> IntArray | None:
        """A plan (T, n) by one assignment a step; it may have too many take-ups. None if agents run into a dead end."""
        problem, prices = self.folded.problem, self.dual.prices
        T, n, m = problem.T, problem.n, problem.m
        window, costs = self.paths.plain.window, self.paths.plain.cost + self.dual.dearer
        moves, values, order = np.empty((n, T + 1)), np.empty((n, m)), np.arange(m)
        in_blocks(
            priced_moves,
            n,
            window,
            costs,
            prices,
            moves,
            scratch=lambda: (work_array(m),),
            turns=2.0 * T * n * m,
        )
        held, plan = window.held.copy(), np.empty((T, n), dtype=np.int64)
        for k in range(T):
            turns = 2.0 * (T - k) * n * m
            in_blocks(priced_firsts, n, window, costs, k, held, prices, moves, values, turns=turns)
            try:
                held = best_assignment(values, order).tasks
            except InfeasibleError:
                return None
            plan[k] = held
        return plan

    def _windows(self, plan: IntArray, windows: CountedWindows, number: int) -> IntArray:
        """The plan after a round of windows, every second one at a time, side by side."""
        run, T = self.search.run, self.folded.problem.T
        first = number % _SHIFTS * _LENGTH // _SHIFTS - _LENGTH
        edges = [(max(a, 0), min(a + _LENGTH, T)) for a in range(first, T, _LENGTH) if a + _LENGTH > 0]
        seeds = run.rng.integers(2**63, size=len(edges))
        with ThreadPoolExecutor(2) as pool:
            for turn in (0, 1):
                base, seconds = plan, max(_WINDOW_SHARE * run.seconds_left, 0.01)
                jobs = [
                    pool.submit(
                        windows.improved,
                        base,
                        *edge,
                        np.random.default_rng(seed),
                        seconds,
                        lambda: run.expired,
                    )
                    for edge, seed in list(zip(edges, seeds, strict=True))[turn::2]
                ]
                for (a, b), job in zip(edges[turn::2], jobs, strict=True):
                    joined = plan.copy()
                    joined[a:b] = job.result()[a:b]
                    # two windows may both have used what an agent had left
                    allowed = np.maximum(self.folded.most, self.folded.take_ups(plan))
                    if (self.folded.take_ups(joined) <= allowed).all():
                        plan = joined
                if run.expired:
                    break
        return plan
