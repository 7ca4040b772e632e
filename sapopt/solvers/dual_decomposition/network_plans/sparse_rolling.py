"""Rolling assignment for thousands of agents: sparse first values of a window, priced by the whole horizon.

As `priced_futures`, but an agent's future is looked at for a window of steps only, and nothing of size (n, m) is
built. The prices of the window may be improved before each step, from the assignment that is really held.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.first_rows import FirstRowsOracle
from sapopt.problem.sap import SAP
from sapopt.running.control import Expired
from sapopt.solvers.dual_decomposition.repricing import repriced_window


def plan_by_first_rows(
    problem: SAP,
    prices: FloatArray,
    stop: Callable[[], Any] = lambda: False,
    *,
    window: int = 20,
    iterations: int = 0,
    seconds: Callable[[int], float] = lambda k: np.inf,
) -> IntArray | None:
    """Return the plan (T, n) of the rolling assignment, or None if ``stop()`` ended it.

    Parameters
    ----------
    prices : (T, m)
        Prices of the cells.
    window : int
        Steps that are looked at.
    iterations : int
        Most dual iterations on the window's prices before each step.
    seconds : callable
        ``seconds(k)``: time that the iterations of step k may take.

    Raises
    ------
    ValueError
        If the dynamics cannot value first tasks in sparse form.
    """

    def check() -> None:
        if stop():
            raise Expired

    plan = np.zeros((problem.T, problem.n), np.int64)
    state = problem.initial_state()
    prices = prices.copy()
    for k in range(problem.T):
        end = min(k + window, problem.T)
        oracle = problem.model.path_oracle(problem.benefits.slice(k, end), state)
        if not isinstance(oracle, FirstRowsOracle):
            raise ValueError(
                f"dynamics: {type(problem.dynamics).__name__} has no sparse values of first tasks"
            )
        if iterations:
            prices[k:end] = repriced_window(oracle, prices[k:end], iterations, seconds(k))
        # with a task to spare only prices of zero make the assignment optimal
        start = prices[k] if problem.n == problem.m else None
        try:
            check()
            plan[k] = oracle.first_rows(prices[k:end]).assign(start, check)
        except Expired:
            return None
        state = problem.transition(k, state, plan[k])
    return plan
