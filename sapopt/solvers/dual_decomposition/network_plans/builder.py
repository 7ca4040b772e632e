"""The two plan builders of the plain switching rule: with networks of windows, and for thousands of agents without."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.sap import SAP
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.flow_programme import solve_flow
from sapopt.solvers.dual_decomposition.network_plans.path_sweeps import sweep_by_arrays
from sapopt.solvers.dual_decomposition.network_plans.priced_futures import plan_by_futures
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import restricted_flow
from sapopt.solvers.dual_decomposition.network_plans.rolling_windows import rolling_windows
from sapopt.solvers.dual_decomposition.network_plans.rounds import Rounds
from sapopt.solvers.dual_decomposition.network_plans.sparse_rolling import plan_by_first_rows
from sapopt.solvers.dual_decomposition.network_plans.waiting_places import can_wait, wait_anywhere
from sapopt.solvers.dual_decomposition.network_plans.window_search import efforts_for, improved
from sapopt.solvers.dual_decomposition.plans import REPRICED, ROLLING, Found, Search, repriced_rolling

WHOLE = "the whole horizon"
"""A phase: the best plan of all cells that a better plan may use."""

_WIDE_GAP = 0.025
"""Gap of the rolling assignment above which rolling windows, which take longer, are worth their time."""

_WIDE_WAITING = 0.005
"""The same where hardly a task is spare, and there is a clock."""

_NARROW_GAP = 0.01
"""Gap of the rolling assignment below which windows gain more for their time than another one with better prices, where
there is a clock and agents have tasks to spare."""

_WINDOWS_SHARE, _WAITING_SHARE = 0.8, 0.95
"""Share of the time left that rolling windows may take, and where hardly a task is spare."""

_WINDOW_REPRICINGS = 20
"""Dual iterations before each of the rolling windows."""

_REPRICING_SHARE = 0.5
"""Share of the time left that the repricing of a large problem may take."""

_WHOLE_ARCS = 20_000
"""Arcs up to which the whole horizon is solved at once."""

_WHOLE_SHARE = 0.5
"""Share of the time left that it may take."""

_SHRUNK = 0.95
"""It is tried again where the distance between bound and plan has shrunk to this share."""

_REPRICED_WINDOW = 10
"""Steps whose prices are improved before each step of a large problem."""


@dataclass(frozen=True, eq=False)
class NetworkPlans:
    """Plans over flat arrays (a `PlanBuilder`).

    Attributes
    ----------
    arrays : Arrays
        The problem, under a `SwitchingCost`.
    threads : int
        Windows solved at the same time.
    """

    arrays: Arrays
    threads: int
    lives_on_prices: bool = False
    _rounds: Rounds = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_rounds", Rounds(self.arrays.steps, efforts_for(self.arrays)))

    @property
    def has_untried(self) -> bool:
        """See `PlanBuilder`."""
        return self._rounds.has_untried

    def rolling(self, search: Search) -> Iterator[Found]:
        """A rolling assignment; then rolling windows where it left a wide gap, or another one with repricing."""
        plan = plan_by_futures(self.arrays, search.settled_prices, lambda: search.report(ROLLING))
        if plan is not None:
            yield ROLLING, plan
        has_spare = self.arrays.agents < self.arrays.tasks
        waits = wait_anywhere(self.arrays) and math.isfinite(search.seconds_left)
        if (waits and search.gap > _WIDE_WAITING) or (has_spare and search.gap > _WIDE_GAP):
            yield from self._windows_ahead(search)
        elif waits:
            return  # windows gain more for their time than another one with better prices
        elif not has_spare or search.gap > _NARROW_GAP or math.isinf(search.seconds_left):
            yield from repriced_rolling(
                search,
                lambda stop, **options: plan_by_futures(self.arrays, search.settled_prices, stop, **options),
            )

    def _windows_ahead(self, search: Search) -> Iterator[Found]:
        """The plan of rolling windows, which begin from the best one."""
        phase, before, began = "rolling windows", search.value, search.seconds_left
        share = _WAITING_SHARE if wait_anywhere(self.arrays) else _WINDOWS_SHARE
        plan = rolling_windows(
            self.arrays, search.best, search.settled_prices, search.rng,
            reprice=search.repricing(_WINDOW_REPRICINGS), seconds=share * began, stop=lambda: search.report(phase),
            threads=self.threads,
        )  # fmt: skip
        if plan is not None:
            yield phase, plan
        if math.isfinite(began):
            self._rounds.learn_front(search.value - before, began - search.seconds_left)

    def sweep(
        self,
        plan: IntArray,
        prices: FloatArray,
        rng: np.random.Generator,
        seconds_left: Callable[[], float] = lambda: math.inf,
    ) -> IntArray:
        """See `PlanBuilder`."""
        return sweep_by_arrays(self.arrays, plan, prices, rng, seconds_left)

    def improve(self, search: Search, turn: int) -> Iterator[Found]:
        """Solve neighbourhoods exactly: windows, windows shifted by half, few agents over the whole horizon."""
        if math.isfinite(search.seconds_left):
            yield from self._whole(search)
        if can_wait(self.arrays) and self._rounds.wants_front(
            search.bound - search.value, search.seconds_left
        ):
            yield from self._windows_ahead(search)
        yield from _round_of_windows(self.arrays, self._rounds, search, turn, self.threads)

    def _whole(self, search: Search) -> Iterator[Found]:
        """The whole horizon at once, where few cells are left that a better plan may use.

        A plan loses, against the bound, at least the reduced cost of each of its cells. So no plan that is better than
        the best one uses a cell whose reduced cost is above the distance between the two.
        """
        arrays, distance = self.arrays, search.bound - search.value
        if not 0.0 < distance <= _SHRUNK * self._rounds.whole_tried:
            return
        self._rounds.whole_tried = distance
        anywhere = arrays.agents * arrays.tasks * arrays.steps <= _WHOLE_ARCS
        parking = np.tile(np.arange(arrays.tasks if anywhere else 0), (arrays.agents, 1))
        flow = restricted_flow(
            arrays, search.best, search.settled_prices, np.arange(arrays.agents), 0, arrays.steps, distance, parking,
            _WHOLE_ARCS,
        )  # fmt: skip
        if len(flow.tail) > _WHOLE_ARCS:
            return
        plan = solve_flow(
            flow, search.best, arrays.tasks, seconds=_WHOLE_SHARE * search.seconds_left,
            stop=lambda: search.report(WHOLE),
        )  # fmt: skip
        if plan is not None:
            yield WHOLE, plan

    def promises(self, plan: IntArray, value: float) -> bool:
        """By the compiled value of the plan."""
        return self.arrays.value(plan) > value + 1e-9


def _round_of_windows(
    arrays: Arrays, rounds: Rounds, search: Search, turn: int, threads: int
) -> Iterator[Found]:
    """The windows of one round, and what there is to learn from it."""
    began, before = search.seconds_left, search.value
    if math.isinf(began):
        effort, shift = rounds.planned(turn)
    else:
        effort, shift = rounds.paying(search.bound - before, began)
    plans = improved(
        arrays, search.best, search.settled_prices, effort, shift, search.rng,
        threads=threads, seconds_left=lambda: search.seconds_left,
    )  # fmt: skip
    for plan in plans:
        yield f"windows of {effort.length} steps", plan
    if math.isfinite(began):
        rounds.learn(effort, search.value - before, began - search.seconds_left)


@dataclass(frozen=True, eq=False)
class LargeNetworkPlans:
    """Plans where a matrix of all agents and tasks at every step is too much (a `PlanBuilder`).

    Attributes
    ----------
    problem : SAP
        Its dynamics values first tasks in sparse form (`sapopt.dynamics.paths.first_rows.FirstRowsOracle`).
    arrays : Arrays
        The same problem.
    threads : int
        Windows solved at the same time.
    in_windows : bool
        Whether windows improve the best plan once the prices are better; else all is planned again with these.
    at_length : bool
        Whether a round of the search goes on with windows as long as they gain, since rounds are not counted.
    """

    problem: SAP
    arrays: Arrays
    threads: int
    in_windows: bool
    at_length: bool = True
    lives_on_prices: bool = True
    has_untried: bool = False
    _rounds: Rounds = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_rounds", Rounds(self.arrays.steps, efforts_for(self.arrays)))

    def rolling(self, search: Search) -> Iterator[Found]:
        """Rolling assignments that look at a window of steps, without and with improved prices."""

        def seconds(k: int) -> float:
            return _REPRICING_SHARE * search.seconds_left / (self.problem.T - k)

        ways: dict[str, dict[str, Any]] = {ROLLING: {}}
        if search.most_repricings:
            ways[REPRICED] = {
                "window": _REPRICED_WINDOW, "iterations": 2 * search.most_repricings, "seconds": seconds
            }  # fmt: skip
        for phase, options in ways.items():
            plan = plan_by_first_rows(
                self.problem, search.settled_prices, lambda at=phase: search.report(at), **options  # type: ignore[misc]
            )  # fmt: skip
            if plan is None:
                return
            yield phase, plan

    def sweep(
        self,
        plan: IntArray,
        prices: FloatArray,
        rng: np.random.Generator,
        seconds_left: Callable[[], float] = lambda: math.inf,
    ) -> IntArray:
        """See `PlanBuilder`."""
        return sweep_by_arrays(self.arrays, plan, prices, rng, seconds_left)

    def improve(self, search: Search, turn: int) -> Iterator[Found]:
        """Windows where there are places to wait; else plan again with the prices as they are now, which gains more.

        Windows go on as long as they gain. Rolling windows are too slow here: with as many arcs as fit into a quarter
        of an hour, they end in plans that are worse than those of improved prices.
        """
        if not self.in_windows:
            yield from self.rolling(search)
            return
        while search.seconds_left > 0.0:
            before = search.value
            yield from _round_of_windows(self.arrays, self._rounds, search, turn, self.threads)
            if not self.at_length or (search.value <= before and not self._rounds.has_untried):
                return

    def promises(self, plan: IntArray, value: float) -> bool:
        """By the compiled value of the plan."""
        return self.arrays.value(plan) > value + 1e-9
