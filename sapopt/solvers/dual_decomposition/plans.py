"""What the search of `DualDecomposition` asks of whatever makes plans from prices, and what that may ask of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.sap import SAP

Found = tuple[str, IntArray]
"""A plan (T, n), feasible but not yet scored, and the phase of the search that made it."""

Reprice = Callable[[int, Any, FloatArray], FloatArray]
"""``reprice(k, state, prices of the steps k..T-1)``: better prices for what is left of the problem at step k."""

_SWEEPING_SHARE, _FEWEST_SWEEPS = 0.3, 3
"""Share of the time left that a round of sweeps may take, and how many it has at least."""

ROLLING, REPRICED, SWEEPS = "rolling assignment", "repriced assignment", "path sweeps"
"""Phases that every builder has."""

_BLOCK = 3
"""Steps between two repricings."""

_REPRICING_SHARE = 0.5
"""Share of the time left that repricing may take."""

_FEWEST_REPRICINGS = 10
"""Dual iterations below which a repricing does more harm than good."""


class Search(Protocol):
    """The state of a search, as far as it concerns those who make plans for it."""

    @property
    def problem(self) -> SAP:
        """What is to be planned."""

    @property
    def best(self) -> IntArray:
        """The best plan (T, n) so far."""

    @property
    def value(self) -> float:
        """Value of the best plan so far."""

    @property
    def bound(self) -> float:
        """The proven bound so far."""

    @property
    def settled_prices(self) -> FloatArray:
        """The best prices (T, m) so far."""

    @property
    def gap(self) -> float:
        """The proven gap so far, relative to the bound."""

    @property
    def rng(self) -> np.random.Generator:
        """The run's random numbers."""

    @property
    def sweep_count(self) -> int:
        """Sweeps of a round."""

    @property
    def most_repricings(self) -> int:
        """Dual iterations that a repricing may take when there is time."""

    @property
    def iteration_seconds(self) -> float:
        """Time that a dual iteration over the whole horizon took."""

    @property
    def seconds_left(self) -> float:
        """Time left, infinite without a limit; none once the run was stopped."""

    def repricing(self, count: int) -> Reprice:
        """A repricing of `count` dual iterations."""

    def report(self, phase: str) -> bool:
        """Tell of a phase; whether the run is to stop."""


class PlanBuilder(Protocol):
    """Makes plans from prices for one problem. The search scores them and keeps the best."""

    @property
    def lives_on_prices(self) -> bool:
        """Whether a round gains more from better prices, planned with anew, than from work on the best plan."""

    @property
    def has_untried(self) -> bool:
        """Whether a round may do what none has done yet, where a clock decides what it does."""

    def rolling(self, search: Search) -> Iterator[Found]:
        """Plans from the prices alone, the quick ones first; ends early where the run does."""

    def sweep(
        self,
        plan: IntArray,
        prices: FloatArray,
        rng: np.random.Generator,
        seconds_left: Callable[[], float] = lambda: math.inf,
    ) -> IntArray:
        """The plan (T, n) after the agents, in random order, moved to their best paths under `prices` (T, m)."""

    def improve(self, search: Search, turn: int) -> Iterator[Found]:
        """The work of round number `turn` on the best plan."""

    def promises(self, plan: IntArray, value: float) -> bool:
        """Whether a plan may be worth more than `value`: a quick look that spares most plans a full evaluation."""


def repriced_rolling(search: Search, rolling: Callable[..., IntArray | None]) -> Iterator[Found]:
    """The plan of ``rolling(stop, block=, reprice=)`` with prices that are improved every few steps, if time allows."""
    count = _affordable(search)
    if not count or search.report(REPRICED):
        return
    plan = rolling(
        lambda: search.report(REPRICED), block=_BLOCK, reprice=_in_time(search, search.repricing(count))
    )
    if plan is not None:
        yield REPRICED, plan


def _in_time(search: Search, reprice: Reprice) -> Reprice:
    """A repricing that leaves blocks out, so that all together take no more than their share of the time left."""
    if math.isinf(search.seconds_left):
        return reprice
    reserve = (1.0 - _REPRICING_SHARE) * search.seconds_left
    credit = last = 0.0

    def at(k: int, state: Any, prices: FloatArray) -> FloatArray:
        nonlocal credit, last
        before = search.seconds_left
        credit += (before - reserve) / math.ceil((search.problem.T - k) / _BLOCK)
        if credit < last:
            return prices
        better = reprice(k, state, prices)
        last = before - search.seconds_left
        credit = max(credit - last, 0.0)
        return better

    return at


def _affordable(search: Search) -> int:
    """How many dual iterations every repricing may take: 0 if there is no time for enough of them."""
    left = search.seconds_left
    if math.isinf(left):
        return search.most_repricings
    once = search.iteration_seconds * search.problem.T / _BLOCK / 2
    count = min(search.most_repricings, int(_REPRICING_SHARE * left / max(once, 1e-9)))
    return count if count >= _FEWEST_REPRICINGS else 0


def path_sweeps(search: Search, builder: PlanBuilder) -> Iterator[Found]:
    """Plans of a round of sweeps, under prices that fall to nothing."""
    problem = search.problem
    if problem.n == problem.m:
        return  # every task is taken: no agent can move by itself
    plan, prices, count = search.best, search.settled_prices, search.sweep_count
    done, began = 0, search.seconds_left
    while done < count:
        share = 1.0 - done / max(count - 1, 1)
        plan = builder.sweep(plan, prices * share, search.rng, lambda: search.seconds_left)
        yield SWEEPS, plan
        done += 1
        if done == 1 and math.isfinite(began):  # the prices have to come down to nothing in the time there is
            took = max(began - search.seconds_left, 1e-9)
            count = min(count, max(_FEWEST_SWEEPS, int(_SWEEPING_SHARE * began / took)))


def closed_prices(prices: FloatArray, plan: IntArray) -> FloatArray:
    """Return ``prices`` (T, m) with +inf at the cells which ``plan`` (T, n) holds."""
    closed = prices.copy()
    closed[np.arange(len(plan))[:, None], plan] = np.inf
    return closed
