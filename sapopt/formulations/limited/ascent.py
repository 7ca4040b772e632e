"""Minimise the dual of capacities, limits and teams: smoothed first, then by subgradients.

The paths are softened by log-sum-exp, which makes the dual smooth; L-BFGS descends within the bounds of the prices at
one temperature after another. What is left between the coldest of them and the dual itself is for subgradient steps
towards a target, the best plan known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.formulations.limited.descent import minimised
from sapopt.formulations.limited.dual import LimitedDual, Prices, dual_value, fitting
from sapopt.formulations.limited.graph import PathGraph
from sapopt.kernels import clock

_TEMPERATURES = (0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0003)
"""Of the smoothed dual, relative to the typical gain."""
_ITERATIONS = 40
"""Of L-BFGS at a temperature; the first ones are only on the way."""
_STEPS = 60
"""Subgradient steps at the end."""

Watch = Callable[[int, float], bool]
"""``watch(evaluations, bound) -> stop?``"""


class _Over(Exception):
    """Time is over, or the bound has met the target."""


@dataclass
class Ascent:
    """One run: the best prices so far.

    Parameters
    ----------
    graph : PathGraph
    stop_at : float
        Of `sapopt.kernels.clock.now`.
    watch : callable
        See `Watch`.
    target : float
        Value of a plan: the run ends when the bound is within `tolerance` of it.
    tolerance : float
        Relative.
    iterations : int
        Of L-BFGS at each temperature.
    polish : bool
        Whether subgradient steps follow.
    """

    graph: PathGraph
    stop_at: float = np.inf
    watch: Watch = lambda evaluations, bound: False
    target: float = -np.inf
    tolerance: float = 1e-7
    iterations: int = _ITERATIONS
    polish: bool = True
    best: LimitedDual | None = None
    evaluations: int = 0
    _high: FloatArray = field(default_factory=lambda: np.zeros(0))

    def run(
        self, prices: Prices | None = None, temperatures: tuple[float, ...] = _TEMPERATURES
    ) -> LimitedDual:
        """Descend from some prices, zero by default."""
        rows, problem = self.graph.problem.rows, self.graph.problem
        start = prices or Prices(
            np.zeros((problem.T, problem.m)), np.zeros(rows.count), np.zeros(len(rows.team_cell))
        )
        assert problem.capacity is not None
        self._look(dual_value(self.graph, start))
        assert self.best is not None
        if not np.isfinite(self.best.bound):
            return self.best
        x = np.minimum(self._packed(fitting(rows, start)), self._bounds())
        scale = self.graph.scale
        try:
            for temperature in temperatures:
                x = self._descend(x, temperature * scale)
                self._look(dual_value(self.graph, self._unpacked(x)))
            if self.polish:
                self._subgradients(scale)
        except _Over:
            pass
        return self.best

    def _look(self, here: LimitedDual) -> None:
        """Take notice of a value of the dual itself."""
        self.evaluations += 1
        if self.best is None or here.bound < self.best.bound:
            self.best = here

    def _check(self) -> None:
        assert self.best is not None
        near = np.isfinite(self.target) and (
            self.best.bound - self.target <= self.tolerance * max(abs(self.target), 1e-300)
        )
        if near or clock.now() >= self.stop_at or self.watch(self.evaluations, self.best.bound):
            raise _Over

    def _descend(self, x: FloatArray, temperature: float) -> FloatArray:
        high = self._bounds()
        free = np.flatnonzero(high > 0)  # most numbers can only be zero
        if not len(free):
            return x
        lowest: list[Any] = [np.inf, x]  # the best point seen, should the time end inside

        def whole(part: FloatArray) -> FloatArray:
            out = np.zeros(len(high))
            out[free] = part
            return out

        def smooth(part: FloatArray) -> tuple[float, FloatArray]:
            self.evaluations += 1
            point = whole(part)
            value, slope = self._smoothed(point, temperature)
            if value < lowest[0]:
                lowest[:] = [value, point]
            if self.evaluations % 5 == 0:
                try:
                    self._check()
                except _Over:
                    self._look(dual_value(self.graph, self._unpacked(np.asarray(lowest[1]))))
                    raise
            return value, slope[free]

        return whole(minimised(smooth, x[free], high[free], self.iterations))

    def _smoothed(self, x: FloatArray, temperature: float) -> tuple[float, FloatArray]:
        graph, rows, problem = self.graph, self.graph.problem.rows, self.graph.problem
        assert problem.capacity is not None
        prices = self._unpacked(x)
        values, share = graph.smoothed(graph.priced(prices.effective(rows), prices.limits), temperature)
        up, down, r = self._parts(x)
        high, low = _finite(rows.high), _finite(rows.low)
        total = float(values.sum() + (problem.capacity * prices.tasks).sum() + up @ high - down @ low)
        total += float((rows.team_reward - rows.team_needs * prices.teams).sum())
        usage = graph.usage(share)
        use = graph.weights @ share if r else np.zeros(0)
        slope = np.concatenate([
            (problem.capacity - usage).ravel(), high - use, use - low,
            usage.ravel()[rows.team_cell] - rows.team_needs,
        ])  # fmt: skip
        return total, slope

    def _subgradients(self, scale: float) -> None:
        """Steps of a length that shrinks when nothing is gained, from the best prices found."""
        rows, problem = self.graph.problem.rows, self.graph.problem
        assert self.best is not None
        assert problem.capacity is not None
        high, low = _finite(rows.high), _finite(rows.low)
        length, quiet = 0.02 * scale, 0
        here, x, top = self.best, self._packed(self.best.prices), self._bounds()
        direction = np.zeros(len(x))
        for _ in range(_STEPS):
            share = np.zeros(self.graph.arcs)
            share[here.arcs] = 1.0
            usage, use = self.graph.usage(share), self.graph.weights @ share if rows.count else np.zeros(0)
            slope = np.concatenate([
                (problem.capacity - usage).ravel(), high - use, use - low,
                usage.ravel()[rows.team_cell] - rows.team_needs,
            ])  # fmt: skip
            slope[((x <= 0) & (slope > 0)) | ((x >= top) & (slope < 0))] = 0.0
            size = float(np.abs(slope).max(initial=0.0))
            if size == 0.0:
                return
            direction = 0.7 * direction + slope / size
            x = np.clip(x - length * direction, 0.0, top)
            before = self.best.bound
            here = dual_value(self.graph, self._unpacked(x))
            self._look(here)
            self._check()
            quiet = 0 if self.best.bound < before else quiet + 1
            if quiet >= 5:
                length, quiet = 0.5 * length, 0
                here, x, direction = self.best, self._packed(self.best.prices), np.zeros(len(x))

    def _bounds(self) -> FloatArray:
        """The most that every number of `x` may be."""
        if not len(self._high):
            rows, problem = self.graph.problem.rows, self.graph.problem
            cells = problem.T * problem.m
            assert problem.capacity is not None
            # room for all that could come needs no price
            price = np.where(problem.capacity >= self.graph.comers, 0.0, np.inf).ravel()
            self._high = np.concatenate([
                price, np.where(np.isfinite(rows.high), rows.penalty, 0.0),
                np.where(np.isfinite(rows.low), rows.penalty, 0.0), rows.team_reward / np.maximum(rows.team_needs, 1),
            ])  # fmt: skip
            assert len(self._high) == cells + 2 * rows.count + len(rows.team_cell)
        return self._high

    def _packed(self, prices: Prices) -> FloatArray:
        y = prices.limits
        return np.concatenate([prices.tasks.ravel(), np.maximum(y, 0.0), np.maximum(-y, 0.0), prices.teams])

    def _parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray, int]:
        r, cells = self.graph.problem.rows.count, self.graph.problem.T * self.graph.problem.m
        return x[cells : cells + r], x[cells + r : cells + 2 * r], r

    def _unpacked(self, x: FloatArray) -> Prices:
        problem = self.graph.problem
        up, down, r = self._parts(x)
        cells = problem.T * problem.m
        return Prices(x[:cells].reshape(problem.T, problem.m), up - down, x[cells + 2 * r :])


def _finite(bounds: FloatArray) -> FloatArray:
    return np.where(np.isfinite(bounds), bounds, 0.0)
