"""Subgradient descent with momentum on the dual: for any path oracle, and for the last digits after smoothing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.dynamics.paths.oracles import PathOracle
from sapopt.formulations.dual.lagrangian import DualValue, dual_value


@dataclass(frozen=True, eq=False)
class SubgradientState:
    """The `prices` to evaluate next, velocity, step length, and the best prices with their value."""

    prices: FloatArray
    velocity: FloatArray
    length: float
    stalled: int
    best: FloatArray
    value: float
    iteration: int


@dataclass(frozen=True)
class Subgradient:
    """Options of the subgradient descent.

    Attributes
    ----------
    length : float
        First step length, as a multiple of the oracle's scale: the price change of a task that one agent too many
        holds, once the momentum has built up.
    inertia : float
        Share of the last step's direction that is kept.
    patience : int
        Steps without improvement after which the length is halved and the search goes back to the best prices.
    shortest : float
        The descent has converged when the length fell below this share of the first one.
    """

    length: float = 0.001
    inertia: float = 0.9
    patience: int = 20
    shortest: float = 2e-3

    def begin(self, prices: FloatArray, scale: float) -> SubgradientState:
        """State before the first step."""
        return SubgradientState(prices, np.zeros_like(prices), self.length * scale, 0, prices, np.inf, 0)

    def converged(self, state: SubgradientState, scale: float) -> bool:
        """Whether further steps would change next to nothing."""
        return state.length < self.shortest * self.length * scale

    def step(self, oracle: PathOracle, state: SubgradientState) -> tuple[SubgradientState, DualValue]:
        """One evaluation and one step."""
        here = dual_value(oracle, state.prices)
        gained = not np.isfinite(state.value) or here.value < state.value - 1e-7 * abs(state.value)
        stalled = 0 if gained else state.stalled + 1
        best, value = state.best, state.value
        if here.value < value:
            best, value = here.prices, here.value
        if stalled >= self.patience:
            rested = SubgradientState(
                best, np.zeros_like(best), 0.5 * state.length, 0, best, value, state.iteration + 1
            )
            return rested, here
        velocity = self.inertia * state.velocity + (here.usage - 1.0)
        prices = np.maximum(here.prices + (1.0 - self.inertia) * state.length * velocity, 0.0)
        after = replace(
            state, prices=prices, velocity=velocity, stalled=stalled, best=best, value=value,
            iteration=state.iteration + 1,
        )  # fmt: skip
        return after, here
