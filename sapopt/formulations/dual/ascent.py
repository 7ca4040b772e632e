"""Minimise the Lagrangian dual: `ascend(oracle) -> DualResult`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sapopt.dynamics.local import FloatArray, PathOracle
from sapopt.formulations.dual.lagrangian import dual_value


@dataclass(frozen=True)
class DualResult:
    """Outcome of an ascent; pass `prices` on to start another one from here.

    Attributes
    ----------
    prices : (T, m) float array
        The best prices found, all >= 0.
    bound : float
        Proven upper bound of the problem's optimum at `prices`.
    iterations : int
        Evaluations of the dual function.
    history : (iterations, 3) float array
        Seconds since the start, value of this iteration, best bound so far.
    """

    prices: FloatArray
    bound: float
    iterations: int
    history: FloatArray = field(repr=False)


def ascend(
    oracle: PathOracle,
    prices: FloatArray | None = None,
    *,
    time_limit: float | None = None,
    deadline: float | None = None,
    max_iterations: int = 1500,
    target: float | None = None,
    tolerance: float = 1e-5,
    callback: Callable[[int, float, FloatArray], bool | None] | None = None,
    seed: int = 0,
) -> DualResult:
    """Subgradient descent with momentum, step halving on stall and restart from the best prices.

    Parameters
    ----------
    oracle : PathOracle
        Gives every agent's longest path under prices.
    prices : (T, m) float array, optional
        Start; zero if not given.
    time_limit, deadline : float, optional
        Seconds from now, and a reading of `time.monotonic`; the ascent stops at the earlier one.
    target : float, optional
        Value of the best plan known: the ascent stops when the bound meets it within `tolerance`.
    callback : callable, optional
        Called as callback(iteration, bound, best prices); a true answer stops the ascent.
    """
    T, n, m = oracle.shape
    begin = time.monotonic()
    stop_at = min(
        np.inf if time_limit is None else begin + time_limit, np.inf if deadline is None else deadline
    )
    mu = np.zeros((T, m)) if prices is None else np.maximum(np.asarray(prices, dtype=np.float64), 0.0)
    best_mu, best, bound = mu, np.inf, np.inf
    velocity = np.zeros_like(mu)
    history: list[tuple[float, float, float]] = []
    step, stall = 0.0, 0
    for iteration in range(max_iterations):
        here = dual_value(oracle, mu)
        history.append((time.monotonic() - begin, here.value, min(bound, here.bound)))
        if iteration == 0:
            # a first step that would move a price by some 5 % of a typical benefit of one agent and step
            step = 0.05 * max(here.value, 1e-12) / (n * T) * 4.0
        if here.value < best - 1e-7 * abs(best) if np.isfinite(best) else True:
            stall = 0
        else:
            stall += 1
        if here.bound < bound:
            best_mu, best, bound = mu, here.value, here.bound
        if callback is not None and callback(iteration, bound, best_mu):
            break
        if target is not None and bound - target <= tolerance * abs(target):
            break
        if time.monotonic() >= stop_at or step < 1e-7 * max(abs(best), 1e-12) / (n * T):
            break
        if stall >= 20:
            step *= 0.5
            stall = 0
            mu = best_mu
            velocity = np.zeros_like(mu)
            continue
        velocity = 0.9 * velocity + (here.usage - 1.0)
        mu = np.maximum(mu + step * 0.1 * velocity, 0.0)
    return DualResult(best_mu, bound, len(history), np.array(history).reshape(-1, 3))
