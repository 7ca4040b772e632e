"""The Lagrangian dual function of the task capacities.

With a price mu[k, j] >= 0 on "at most one agent holds task j at step k", the sequential assignment problem falls apart
into one longest path per agent, and for *any* such prices

    D(mu) = sum_i path_i(mu) + sum_{k, j} mu[k, j]  >=  optimum.

The subgradient of D at mu is 1 - (number of agents whose best path holds task j at step k).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sapopt.dynamics.local import FloatArray, IntArray, PathOracle


@dataclass(frozen=True)
class DualValue:
    """D(mu) at one price vector: `value`, rigorous `bound` >= value, the paths' `plan` (T, n) and `usage` (T, m)."""

    value: float
    bound: float
    plan: IntArray
    usage: IntArray


def rigorous_bound(values: FloatArray, prices: FloatArray) -> float:
    """sum(values) + sum(prices), padded so that rounding in the recursions cannot make it too small.

    A path value is a sum of at most 3 T terms, each of them bounded by the largest intermediate value; the relative
    error of such a sum is below 3 T eps. The outer sums are exact (`math.fsum`).
    """
    T = prices.shape[0]
    if not np.isfinite(values).all():
        return math.fsum(prices.ravel()) + float(values.sum())
    magnitude = float(np.abs(values).sum() + values.size * np.abs(prices).sum(axis=0).max(initial=0.0))
    total = math.fsum(values) + math.fsum(prices.ravel())
    return total + 4.0 * (T + 2) * np.finfo(np.float64).eps * (magnitude + abs(total) + 1.0)


def dual_value(oracle: PathOracle, prices: FloatArray) -> DualValue:
    """Evaluate D at `prices` (T, m), which must be >= 0 and finite."""
    T, _, m = oracle.shape
    if prices.shape != (T, m) or not (prices >= 0.0).all() or not np.isfinite(prices).all():
        raise ValueError(f"prices: expected finite numbers >= 0 of shape {(T, m)}")
    values, plan = oracle.best_paths(prices)
    flat = (np.arange(T)[:, None] * m + plan).ravel()
    usage = np.bincount(flat, minlength=T * m).reshape(T, m)
    return DualValue(float(values.sum() + prices.sum()), rigorous_bound(values, prices), plan, usage)
