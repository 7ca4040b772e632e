"""The planner of folded problems whose agents may take up only so many tasks.

Prices and multipliers first, then one assignment a step by the agents' best ways on, at what moves cost with the
multipliers. From there three stages: windows of that plan at those costs, whatever is taken up; windows in which nobody
comes to take up more than it may, while the multipliers follow what the agents take up; and once the rest is repaired,
agent by agent, by the best free path within the limit, windows and groups of agents over the whole horizon by turns.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from sapopt.data.assignment import best_assignment
from sapopt.data.benefits import dense_step
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.limited.folded import Folded
from sapopt.formulations.limited.folded_dual import FoldedDual, FoldedPaths
from sapopt.formulations.limited.joint_descent import descend
from sapopt.kernels import clock
from sapopt.kernels.blocks import in_blocks, work_array
from sapopt.running.control import Run
from sapopt.solvers.base import Outcome
from sapopt.solvers.dual_decomposition.network_plans.window_search import EFFORTS, Effort
from sapopt.solvers.dual_decomposition.plans import closed_prices
from sapopt.solvers.limited.counted_kernels import counted_scratch, counted_sweep, priced_firsts, priced_moves
from sapopt.solvers.limited.counted_windows import Count, CountedWindows
from sapopt.solvers.limited.planner import Search, outcome_of

_DUAL_SHARE = 0.35
"""Share of the time that the prices may take."""
_SHIFTS = 3
"""Ways to cut the horizon into windows."""
_FREE = (0, 0, 0, 1, 1, 2, 2, 3)
"""Efforts of the rounds in which it does not matter what is taken up."""
_FREE_SHARE = 0.4
"""Share of the time after the prices that they may take."""
_FOLLOWING, _FOLLOWING_SHARE = 24, 0.5
"""Most rounds in which the multipliers follow, and the share of the time left that they may take."""
_EFFORTS_AT_A_TIME = 3
"""Efforts that these rounds go through in turn, and those of a cycle of the last stage."""
_RISE, _FALL = 0.02, 0.005
"""By which a multiplier rises for every take-up that is too much, and falls for every one left, in typical benefits."""
_GROUP_ARCS = 20_000
"""Size of the networks of few agents over the whole horizon."""
_QUIET = 2
"""Cycles of the last stage without a better plan after which the search ends."""
_REPAIRS = (1.0, 0.5, 0.0)
"""Shares of the prices under which the agents take their best free paths, one sweep after another."""
_LIKE_PRICES = Count(limited=False, priced=True)
_KEPT = Count(limited=True, priced=True)
_ALONE = Count(limited=True, priced=False)


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
    dual = descend(
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
        """Stage by stage, until the time is over or nothing is gained."""
        plan = self._rolled()
        if plan is None:
            plan = self.search.best
        if plan is None:
            return
        self._offer(plan)
        plan = self._following(self._free(plan))
        self._offer(plan)
        if self.search.best is not None:
            self._within(self.search.best)

    def _free(self, plan: IntArray) -> IntArray:
        """The plan after windows at the multipliers, whatever is taken up."""
        stop_at = (1.0 - _FREE_SHARE) * self.search.run.seconds_left
        for number, effort in enumerate(_FREE):
            if self._is_over() or self.search.run.seconds_left < stop_at:
                break
            plan = self._windows(plan, self.dual.dearer, effort, number, _LIKE_PRICES)
        return plan

    def _following(self, plan: IntArray) -> IntArray:
        """The plan after windows that keep the limits, or what is above them, while the multipliers follow."""
        stop_at = (1.0 - _FOLLOWING_SHARE) * self.search.run.seconds_left
        dearer, scale, most = self.dual.dearer, self.paths.plain.scale, self.folded.most
        for number in range(_FOLLOWING):
            beyond = self.folded.take_ups(plan) - most
            if not (beyond > 0).any() or self._is_over() or self.search.run.seconds_left < stop_at:
                break
            changed = dearer + scale * np.where(beyond > 0, _RISE, _FALL) * beyond
            dearer = np.where(self.folded.row >= 0, np.maximum(changed, 0.0), 0.0)
            effort, turn = number % _EFFORTS_AT_A_TIME, number // _EFFORTS_AT_A_TIME
            plan = self._windows(plan, dearer, effort, turn, _KEPT)
        return plan

    def _within(self, plan: IntArray) -> None:
        """Improve a plan within the limits by windows and groups at what moves cost, until cycles gain nothing.

        After a cycle that gained nothing, windows at the multipliers save take-ups first, for groups to use them.
        """
        run, dearer = self.search.run, self.dual.dearer
        windows = CountedWindows.of(self.folded, self.dual.prices, dearer)
        quiet, cycle = 0, 0
        while not self._is_over() and quiet < _QUIET:
            before = self.search.value
            first = min(cycle // 2, len(EFFORTS) - _EFFORTS_AT_A_TIME)
            for count in (_KEPT, _ALONE) if quiet else (_ALONE,):
                for number in range(first, first + _EFFORTS_AT_A_TIME):
                    plan = self._windows(plan, dearer, number, cycle, count)
                    self._offer(plan)
            effort = Effort(self.folded.problem.T, _GROUP_ARCS)
            plan = windows.regrouped(plan, effort, run.rng, lambda: run.seconds_left)
            self._offer(plan, "groups")
            quiet = quiet + 1 if self.search.value <= before else 0
            cycle += 1

    def _is_over(self) -> bool:
        """Whether to stop, after the search has told where it stands."""
        search = self.search
        return search.report(search.value, search.bound) or search.run.expired or search.is_proven

    def _offer(self, plan: IntArray, phase: str = "windows") -> None:
        """The plan repaired, if it has to be."""
        folded, prices = self.folded, self.dual.prices
        taken = folded.take_ups(plan)
        if (taken <= folded.most).all():
            self.search.offer(plan, phase)
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

    def _windows(self, plan: IntArray, dearer: FloatArray, effort: int, turn: int, count: Count) -> IntArray:
        """The plan after a round of windows at some multipliers (n,)."""
        run = self.search.run
        if run.expired:
            return plan
        windows = CountedWindows.of(self.folded, self.dual.prices, dearer)
        shift = turn % _SHIFTS * EFFORTS[effort].length // _SHIFTS
        return windows.improved(plan, EFFORTS[effort], shift, count, run.rng, lambda: run.seconds_left)
