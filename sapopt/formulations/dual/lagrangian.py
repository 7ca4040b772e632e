"""The Lagrangian dual function of the task capacities.

With a price mu[k, j] >= 0 on "at most one agent holds task j at step k", the sequential assignment problem falls apart
into one longest path per agent, and for *any* such prices

    D(mu) = sum_i path_i(mu) + sum_{k, j} mu[k, j]  >=  optimum.

A subgradient of D at mu is 1 - usage, with usage the number of agents whose best path holds task j at step k.

Every agent holds one task at every step, so lowering all m prices of a step by c changes D by (n - m) c <= 0: prices
can always be moved until the cheapest task of a step costs nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import PathOracle


@dataclass(frozen=True, eq=False)
class DualValue:
    """D at some prices.

    Attributes
    ----------
    prices : (T, m) float array
        The prices given, less the least price of their step.
    value : float
        D(prices), as computed.
    path_values : (n,) float array
    plan : (T, n) int array
        The agents' best paths.
    """

    prices: FloatArray
    value: float
    path_values: FloatArray
    plan: IntArray

    @property
    def usage(self) -> IntArray:
        """Number of agents (T, m) on every task."""
        T, m = self.prices.shape
        flat = (np.arange(T)[:, None] * m + self.plan).ravel()
        return np.bincount(flat, minlength=T * m).reshape(T, m)

    @property
    def bound(self) -> float:
        """A float64 that is certainly not below D(prices)."""
        return rigorous_bound(self.path_values, self.prices)


def rigorous_bound(values: FloatArray, prices: FloatArray) -> float:
    """sum(values) + sum(prices), padded so that rounding in the recursions cannot make it too small.

    A path value is a sum of at most 3 T terms, and no partial sum exceeds the sum of their magnitudes; the relative
    error of such a sum is below 3 T eps. The outer sums are exact (`math.fsum`).
    """
    T = prices.shape[0]
    if not np.isfinite(values).all():
        return float(values.sum()) + math.fsum(prices.ravel())
    paid = float(prices.max(axis=1, initial=0.0).sum())  # no path pays more
    magnitude = float(np.abs(values).sum()) + 2.0 * values.size * paid
    total = math.fsum(values) + math.fsum(prices.ravel())
    return total + 4.0 * (T + 2) * float(np.finfo(np.float64).eps) * (magnitude + abs(total))


def lowered(prices: FloatArray) -> FloatArray:
    """Prices with the least one of every step at zero: never worse, see the module documentation."""
    return np.asarray(prices - prices.min(axis=1, keepdims=True))


def dual_value(oracle: PathOracle, prices: FloatArray) -> DualValue:
    """Evaluate D at `prices` (T, m), finite and >= 0, after lowering them."""
    low = lowered(prices)
    values, plan = oracle.best_paths(low)
    return DualValue(low, float(values.sum() + low.sum()), values, plan)
