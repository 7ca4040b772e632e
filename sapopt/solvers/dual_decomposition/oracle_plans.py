"""Plans from prices for any dynamics with a path oracle: what `network_plans` do, without their kernels.

Where an oracle can place a whole sequence of agents by itself (`sapopt.dynamics.paths.oracles.PlacingOracle`) the
sweeps are compiled all the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from sapopt.data.types import FloatArray, IntArray
from sapopt.data.windows import WindowSums
from sapopt.dynamics.paths.first_rows import FirstRowsOracle
from sapopt.dynamics.paths.oracles import (
    FirstGainsOracle,
    FirstValueOracle,
    PathOracle,
    PlacingOracle,
    SteppingOracle,
    path_oracle,
)
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.dual_decomposition.plans import (
    ROLLING,
    Found,
    Reprice,
    Search,
    closed_prices,
    path_sweeps,
    repriced_rolling,
)
from sapopt.solvers.dual_lookahead import assign_first, values_first_tasks

_CELLS_AT_ONCE = 20_000
"""Path cells between two looks at the clock, some tenths of a second."""

_ROLLING_SHARE = 0.3
"""Share of the time left that the first rolling assignment may take, if it is to look to the end of the horizon."""

_MANY_PAIRS = 100_000
"""Pairs of agents and tasks from which on a matrix of first values is left to scipy (a tenth of the time)."""

_NEAR_FUTURE = 12
"""Steps that it looks at where that would take too long."""


@dataclass(frozen=True, eq=False)
class OraclePlans:
    """Plans by the paths of an oracle (a `PlanBuilder`).

    Attributes
    ----------
    problem : SAP
        With an agent-local dynamics.
    oracle : PathOracle
        Paths over all steps of the problem.
    """

    problem: SAP
    oracle: PathOracle
    lives_on_prices: bool = False
    has_untried: bool = False

    def rolling(self, search: Search) -> Iterator[Found]:
        """A rolling assignment, and another one with repricing."""
        prices = search.settled_prices
        began = search.seconds_left
        looks = 0

        def stop() -> bool:
            nonlocal looks
            looks += 1
            # the first step looks furthest ahead and takes longest; half of that is the mean
            takes = (began - search.seconds_left) * self.problem.T / 2
            return search.report(ROLLING) or (looks == 1 and takes > _ROLLING_SHARE * began)

        plan = plan_by_first_values(self.problem, prices, stop)
        if plan is None and not search.report(ROLLING):
            plan = plan_by_first_values(
                self.problem, prices, lambda: search.report(ROLLING), window=_NEAR_FUTURE
            )
        if plan is None:
            return
        yield ROLLING, plan
        yield from repriced_rolling(
            search,
            lambda stop, **options: plan_by_first_values(
                self.problem, search.settled_prices, stop, **options
            ),
        )

    def sweep(
        self,
        plan: IntArray,
        prices: FloatArray,
        rng: np.random.Generator,
        seconds_left: Callable[[], float] = lambda: math.inf,
    ) -> IntArray:
        """See `PlanBuilder`."""
        moved = plan.copy()
        order = rng.permutation(plan.shape[1])
        closed = closed_prices(prices, plan)
        for part in np.array_split(order, 1 + plan.size // _CELLS_AT_ONCE):
            if seconds_left() <= 0:
                break
            if isinstance(self.oracle, PlacingOracle):
                self.oracle.place(part, closed, prices, moved)
            else:
                _place(self.oracle, part, closed, prices, moved)
        return moved

    def improve(self, search: Search, turn: int) -> Iterator[Found]:
        """A further round of sweeps: other random orders."""
        return path_sweeps(search, self)

    def promises(self, plan: IntArray, value: float) -> bool:
        """Always: there is no quicker way than to evaluate the plan."""
        return True


def plan_by_first_values(
    problem: SAP,
    prices: FloatArray,
    stop: Callable[[], Any] = lambda: False,
    *,
    block: int = 0,
    reprice: Reprice | None = None,
    window: int | None = None,
) -> IntArray | None:
    """Return the plan that assigns, step by step, what the agents' best paths from each first task are worth.

    Parameters
    ----------
    prices : (T, m)
        Prices of the cells.
    block : int
        Steps between two calls of `reprice`.
    reprice : Reprice, optional
    window : int, optional
        Steps that are looked at; all that are left if omitted.

    Returns
    -------
    (T, n) array
        None if ``stop()`` ended it, or the oracle cannot value first tasks.
    """
    order = np.arange(problem.m)
    plan = np.zeros((problem.T, problem.n), np.int64)
    state = problem.initial_state()
    oracle: PathOracle | None = None
    for k in range(problem.T):
        end = problem.T if window is None else min(k + window, problem.T)
        rest = problem.benefits.slice(k, end)
        if isinstance(oracle, SteppingOracle) and window is None:
            oracle = oracle.after(plan[k - 1])
        else:
            oracle = path_oracle(problem.model, rest, state)
        if not values_first_tasks(oracle):
            return None
        if reprice is not None and k > 0 and k % block == 0:
            prices = prices.copy()
            prices[k:] = reprice(k, state, prices[k:])
        outlook = Outlook(k, end, state, problem, WindowSums(rest, first=k), order)
        plan[k] = _assigned(outlook, oracle, prices[k:end])
        state = problem.transition(k, state, plan[k])
        if stop():
            return None
    return plan


def _assigned(outlook: Outlook, oracle: PathOracle, prices: FloatArray) -> IntArray:
    """`assign_first`, where nearly every pair is worth something by a method for full matrices."""
    sparse = isinstance(oracle, (FirstGainsOracle, FirstRowsOracle))
    if (
        isinstance(oracle, FirstValueOracle)
        and not sparse
        and oracle.shape[1] * oracle.shape[2] >= _MANY_PAIRS
    ):
        values = oracle.first_values(prices)
        if np.isfinite(values).all():
            return np.asarray(linear_sum_assignment(values, maximize=True)[1], dtype=np.int64)
    return assign_first(outlook, oracle, prices)


def _place(
    oracle: PathOracle, order: IntArray, closed: FloatArray, prices: FloatArray, plan: IntArray
) -> None:
    """`PlacingOracle.place` agent by agent."""
    steps = np.arange(len(plan))
    for i in order:
        closed[steps, plan[:, i]] = prices[steps, plan[:, i]]
        value, path = oracle.best_path(int(i), closed)
        if np.isfinite(value):  # else its own old path, which was open, would have been found
            plan[:, i] = path
        closed[steps, plan[:, i]] = np.inf
