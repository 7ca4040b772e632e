"""Plans from prices for any dynamics with a path oracle: what `rolling` and `sweeps` do, without their kernels.

Where an oracle can place a whole sequence of agents by itself (`sapopt.dynamics.paths.oracles.PlacingOracle`) the
sweeps are compiled all the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sapopt.data.windows import WindowSums
from sapopt.dynamics.paths.oracles import PathOracle, PlacingOracle, SteppingOracle, path_oracle
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.dual_decomposition.arrays import Floats, Ints
from sapopt.solvers.dual_decomposition.sweeps import closed_prices
from sapopt.solvers.dual_lookahead import assign_first, values_first_tasks


def rolling_plan(
    problem: SAP,
    prices: Floats,
    stop: Callable[[], Any] = lambda: False,
    *,
    block: int = 0,
    reprice: Callable[[int, Any, Floats], Floats] | None = None,
) -> Ints | None:
    """Return the plan that assigns, step by step, what the agents' best paths from each first task are worth.

    Parameters
    ----------
    prices : (T, m)
        Prices of the cells.
    block : int
        Steps between two calls of `reprice`.
    reprice : callable, optional
        ``reprice(k, state, prices of the steps k..T-1)`` gives new prices for these steps.

    Returns
    -------
    (T, n) array
        None when ``stop()`` came true, or if the oracle cannot value first tasks.
    """
    order = np.arange(problem.m)
    plan = np.zeros((problem.T, problem.n), np.int64)
    state = problem.initial_state()
    oracle: PathOracle | None = None
    for k in range(problem.T):
        rest = problem.benefits.slice(k, problem.T)
        if isinstance(oracle, SteppingOracle):
            oracle = oracle.after(plan[k - 1])
        else:
            oracle = path_oracle(problem.model, rest, state)
        if not values_first_tasks(oracle):
            return None
        if reprice is not None and k > 0 and k % block == 0:
            prices = prices.copy()
            prices[k:] = reprice(k, state, prices[k:])
        outlook = Outlook(k, problem.T, state, problem, WindowSums(rest, first=k), order)
        plan[k] = assign_first(outlook, oracle, prices[k:])
        state = problem.transition(k, state, plan[k])
        if stop():
            return None
    return plan


def sweep(
    oracle: PathOracle,
    plan: Ints,
    prices: Floats,
    rng: np.random.Generator,
    seconds_left: Callable[[], float] = lambda: math.inf,
) -> Ints:
    """Return the plan (T, n) after the agents, in random order, moved to their best open paths under ``prices``."""
    moved = plan.copy()
    order = rng.permutation(plan.shape[1])
    closed = closed_prices(prices, plan)
    for part in np.array_split(order, 1 + plan.size // 20_000):
        if seconds_left() <= 0:
            break
        if isinstance(oracle, PlacingOracle):
            oracle.place(part, closed, prices, moved)
        else:
            _place(oracle, part, closed, prices, moved)
    return moved


def _place(oracle: PathOracle, order: Ints, closed: Floats, prices: Floats, plan: Ints) -> None:
    """`PlacingOracle.place` agent by agent."""
    steps = np.arange(len(plan))
    for i in order:
        closed[steps, plan[:, i]] = prices[steps, plan[:, i]]
        value, path = oracle.best_path(int(i), closed)
        if np.isfinite(value):  # else its own old path, which was open, would have been found
            plan[:, i] = path
        closed[steps, plan[:, i]] = np.inf
