"""Paths of agents that come in several identical copies: each is computed once."""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray


class RepeatedPaths:
    """Path oracle (`sapopt.dynamics.paths.oracles.SoftPathOracle`) of identical copies of the agents of another oracle.

    Parameters
    ----------
    oracle : SoftPathOracle
        Paths of one copy of each agent.
    copies : int
        Number of copies; those of an agent are adjacent.
    """

    def __init__(self, oracle: Any, copies: int) -> None:
        self._oracle, self._copies = oracle, copies

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window, n counting the copies."""
        T, n, m = self._oracle.shape
        return T, n * self._copies, m

    @property
    def scale(self) -> float:
        """Typical size of a benefit."""
        return float(self._oracle.scale)

    @property
    def coldest(self) -> float:
        """Lowest temperature that `soft_paths` can take."""
        return float(self._oracle.coldest)

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of every copy's longest path."""
        values, plan = self._oracle.best_paths(prices)
        return np.repeat(values, self._copies), np.repeat(plan, self._copies, axis=1)

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one copy."""
        value, path = self._oracle.best_path(agent // self._copies, prices)
        return float(value), path

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) of all copies."""
        values, usage = self._oracle.soft_paths(prices, temperature)
        return np.repeat(values, self._copies), usage * self._copies
