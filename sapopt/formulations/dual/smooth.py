"""Accelerated descent on the softened Lagrangian dual, with the temperature falling all the while.

Every agent's longest path is softened to ``eps log sum_paths exp(value / eps)``; the dual becomes smooth, and its
gradient is 1 - usage, where usage is the expected number of agents on (step, task) under the Gibbs distributions of
their paths. The step is the one of matrix scaling (Sinkhorn), damped: ``mu += rate * eps * log(usage)``. It is a
gradient step preconditioned by the usage, keeps its size sensible where many agents crowd on one task, and comes with
Nesterov's momentum, restarted when it points uphill. Instead of solving a sequence of problems at fixed temperatures,
eps falls a little with every step. Idle agents spread over the free tasks by themselves, which a subgradient can only
do by alternating; where there is no spare task that decides everything.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.dynamics.paths.oracles import SoftPathOracle


@runtime_checkable
class NarrowingOracle(SoftPathOracle, Protocol):
    """An oracle that can leave out what no good path uses."""

    @property
    def worth_narrowing(self) -> bool:
        """Whether it is so large that leaving something out saves more than finding out what."""

    def narrowed(self, prices: FloatArray, regret: float) -> SoftPathOracle:
        """The same problem without what no path within `regret` of its agent's best one uses."""

    def blocks(self, length: int) -> Sequence[SoftPathOracle]:
        """The problem cut into blocks of `length` steps that know nothing of each other."""


@runtime_checkable
class DampedOracle(SoftPathOracle, Protocol):
    """An oracle whose usage answers to prices more than that of single agents with one price a step."""

    @property
    def damping(self) -> float:
        """What the length of a step is multiplied by, so that it does not go too far."""


_REACH = 15.0
"""Reduced cost, in temperatures, up to which an entry stays in a narrowed oracle: a weight of 3e-7, and room for the
prices to move in."""

_WORTHWHILE = 2.0
"""Reduced cost, in typical benefits, above which hardly anything could be left out."""

_NARROW = _WORTHWHILE / _REACH
"""Relative temperature from which on entries are left out."""

_NARROW_COST = 0.25
"""What a step costs then, as a multiple of one with all entries (0.2 to 0.3 at 30 000 agents and 6 steps)."""

_BLOCK = 16
"""Steps of a block. While the temperature is that high, steps far apart have little to do with each other; the work
grows with the square of the horizon, for an agent comes to see ever more tasks."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Soft paths of blocks of steps, one after another, as if every block began anew."""

    parts: Sequence[SoftPathOracle]

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Values (n,), summed over the blocks, and usage (T, m)."""
        values, usages = [], []
        first = 0
        for part in self.parts:
            last = first + part.shape[0]
            value, usage = part.soft_paths(prices[first:last], temperature)
            values.append(value)
            usages.append(usage)
            first = last
        return np.sum(values, axis=0), np.concatenate(usages)


@dataclass(frozen=True, eq=False)
class SmoothState:
    """Where a smooth descent stands: the `point` to evaluate next, the last step's `prices`, momentum, progress.

    `damping` is the oracle's, asked for once: whether it has any takes 25 us to find out, and a step may take 400.
    """

    point: FloatArray
    prices: FloatArray
    momentum: float
    rate: float
    value: float
    iteration: int
    damping: float | None = None


@dataclass(frozen=True)
class SmoothDescent:
    """Options of the smooth descent.

    Attributes
    ----------
    iterations : int
        Steps over which the temperature falls from `hot` to `cold` geometrically; it stays at `cold` afterwards.
    hot, cold : float
        Temperatures, as multiples of the oracle's `scale`.
    rate : float, optional
        Step length as a multiple of the temperature; by default the fewer the iterations, the longer the steps.
    """

    iterations: int = 200
    hot: float = 0.5
    cold: float = 0.005
    rate: float | None = None

    def begin(self, prices: FloatArray) -> SmoothState:
        """State before the first step."""
        return SmoothState(prices, prices, 1.0, self.first_rate, np.inf, 0)

    @property
    def first_rate(self) -> float:
        """Step length at the start: measured to be best between 24 and 200 iterations."""
        return min(0.5, max(0.1, 10.0 / self.iterations)) if self.rate is None else self.rate

    def relative(self, iteration: int) -> float:
        """Temperature of a step as a multiple of the scale."""
        done = min(1.0, iteration / max(1, self.iterations - 1))
        return math.exp((1.0 - done) * math.log(self.hot) + done * math.log(self.cold))

    def replanned(self, done: int, remaining: int) -> SmoothDescent:
        """The rest of the fall of temperature, from where it is after `done` steps, in another number of steps."""
        count = done + remaining
        if remaining <= 1:
            return replace(self, iterations=count)
        now = self.relative(done)
        # `hot` such that step `done` is at temperature `now`, and step `count - 1` at `cold`
        hot = self.cold * (now / self.cold) ** ((count - 1) / (count - 1 - done))
        return replace(self, hot=hot, iterations=count)

    def temperature(self, oracle: SoftPathOracle, iteration: int) -> float:
        """Temperature of a step."""
        return max(self.relative(iteration) * oracle.scale, 1.05 * oracle.coldest, 1e-12 * oracle.scale)

    def cheaper(
        self, oracle: SoftPathOracle, state: SmoothState
    ) -> tuple[SoftPathOracle | Blocks, SmoothState]:
        """An oracle that does for the next few steps (about ten), and the state to go on from with it."""
        if not isinstance(oracle, NarrowingOracle) or not oracle.worth_narrowing:
            return oracle, state
        # the values of two oracles differ, so the next one is not to be compared with the last one
        anew = replace(state, value=np.inf)
        regret = _REACH * self.temperature(oracle, state.iteration)
        if regret <= _WORTHWHILE * oracle.scale:
            return oracle.narrowed(state.point, regret), anew
        return (Blocks(oracle.blocks(_BLOCK)), anew) if oracle.shape[0] >= 2 * _BLOCK else (oracle, state)

    def is_wide(self, oracle: SoftPathOracle, iteration: int) -> bool:
        """Whether a step needs every entry: too hot to leave any out, and the horizon too short for blocks."""
        is_short_and_hot = (
            oracle.shape[0] < 2 * _BLOCK and self.temperature(oracle, iteration) > _NARROW * oracle.scale
        )
        return is_short_and_hot and isinstance(oracle, NarrowingOracle)

    def mean_cost(self, oracle: SoftPathOracle, iteration: int) -> float:
        """Expected mean time of the steps from `iteration` on, as a multiple of that of this step."""
        if not self.is_wide(oracle, iteration):
            return 1.0
        now = self.temperature(oracle, iteration) / oracle.scale
        wide = np.log(now / _NARROW) / np.log(now / min(self.cold, _NARROW))
        return float(wide + _NARROW_COST * (1.0 - wide))

    def step(
        self, oracle: SoftPathOracle, state: SmoothState, cheaper: SoftPathOracle | Blocks | None = None
    ) -> SmoothState:
        """One evaluation, by a cheaper oracle if there is one, and one step."""
        eps = self.temperature(oracle, state.iteration)
        values, usage = (cheaper or oracle).soft_paths(state.point, eps)
        value = float(values.sum() + state.point.sum())
        if not math.isfinite(value) or value > state.value + 1e-9 * abs(state.value):
            # The dual only falls as eps falls, so this went too far: by momentum, or else because the step is too long.
            rate = state.rate if state.momentum > 8.0 else 0.7 * state.rate
            return SmoothState(
                state.prices, state.prices, 1.0, rate, np.inf, state.iteration + 1, state.damping
            )
        damping = state.damping
        if damping is None:
            damping = oracle.damping if isinstance(oracle, DampedOracle) else 1.0
        length = state.rate * eps * damping
        # In place: with a few thousand prices, making the arrays in between takes as long as the arithmetic.
        new = np.maximum(usage, 1e-3)
        np.log(new, out=new)
        new *= length
        new += state.point
        np.maximum(new, 0.0, out=new)
        point = new - state.prices
        slope = 1.0 - usage
        slope *= point
        uphill = float(slope.sum()) > 0.0
        before = 1.0 if uphill else state.momentum
        after = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * before * before))
        point *= (before - 1.0) / after
        point += new
        np.maximum(point, 0.0, out=point)
        return SmoothState(point, new, after, state.rate, value, state.iteration + 1, damping)
