"""The dual of a folded problem: prices of the tasks, and what every agent pays more for a move.

A multiplier y >= 0 of "agent i takes up at most H tasks" raises what i pays for a move by y. The agents' paths are
those of the plain problem with a cost for each agent, and for any prices and multipliers

    sum_i (path_i at cost + y_i) + sum mu + sum_i H_i y_i  >=  optimum.

Prices and multipliers are improved by turns: the prices by the ascent of the plain problem, each multiplier by a search
for the one at which its agent's best path keeps the limit. After the first turn it goes but half the way there, for the
prices answer it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.dynamics.switching.many_costs import ManyCosts
from sapopt.dynamics.switching.paths import StrictSwitching
from sapopt.formulations.bounds import cancellation, largest_benefits
from sapopt.formulations.dual import ascend
from sapopt.formulations.limited.dual import Prices
from sapopt.formulations.limited.folded import Folded
from sapopt.kernels import clock

_GRID = 0.02
"""Multipliers are whole multiples of this share of the typical benefit, so that many agents pay the same."""
_FIRST, _LATER = 150, 40
"""Iterations of the first ascent, and of those after every change of the multipliers."""
_DAMPED = 0.5
"""Share of the way to its best that a multiplier goes at a turn, the first turn aside."""
_DOUBLINGS = 20
"""Of the greatest multiplier that is tried."""
_QUIET = 4
"""Turns without a better bound after which the search ends."""
_WORTHWHILE = 1e-5
"""Relative gain of a turn that counts as one."""
_EPS = float(np.finfo(np.float64).eps)

Watch = Callable[[int, float], bool]
"""``watch(iterations, bound) -> stop?``"""


@dataclass(frozen=True, eq=False)
class FoldedDual:
    """The dual at some prices.

    Attributes
    ----------
    bound : float
        Certainly not below the optimum of the problem with limits.
    prices : ndarray, shape (T, m)
        Of the tasks.
    dearer : ndarray, shape (n,)
        Of the limits on take-ups.
    """

    bound: float
    prices: FloatArray
    dearer: FloatArray

    def multipliers(self, folded: Folded) -> FloatArray:
        """Those of all rows."""
        out = folded.multipliers.copy()
        has = np.flatnonzero(folded.row >= 0)
        out[folded.row[has]] = self.dearer[has]
        return out

    def all_prices(self, folded: Folded) -> Prices:
        """The same point in the dual of the problem with limits."""
        return Prices(self.prices, self.multipliers(folded), np.zeros(0))


class FoldedPaths:
    """The agents' paths, by what each of them pays more for a move."""

    def __init__(self, folded: Folded) -> None:
        self.folded = folded
        problem = folded.problem
        oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
        assert isinstance(oracle, StrictSwitching)  # the rule that is folded
        self.plain = oracle
        self.grid = _GRID * oracle.scale
        self._hidden = cancellation(problem) + self._rounding()

    def at(self, dearer: FloatArray) -> ManyCosts:
        """The paths at multipliers (n,)."""
        return ManyCosts.of(self.plain, self.plain.cost + dearer)

    def whole(self, bound: float, dearer: FloatArray) -> float:
        """The bound of the problem with limits that follows from that of the paths."""
        terms = [*(self.folded.most * dearer).tolist(), -self.folded.paid]
        total = math.fsum([bound, *terms])
        size = abs(bound) + math.fsum(abs(term) for term in terms)
        moves = (
            (self.folded.problem.T + 4)
            * self.folded.problem.n
            * (self.plain.cost + float(dearer.max(initial=0.0)))
        )
        return total + self._hidden + 8.0 * _EPS * (size + moves)

    def _rounding(self) -> float:
        """What rounding hides where penalties were added to benefits."""
        problem = self.folded.problem
        return (
            4.0 * _EPS * problem.n * sum(largest_benefits(problem)) if self.folded.multipliers.any() else 0.0
        )


def descend(
    folded: Folded,
    paths: FoldedPaths,
    stop_at: float,
    watch: Watch = lambda iterations, bound: False,
    prices: FloatArray | None = None,
) -> FoldedDual:
    """Minimise the dual, from some prices (T, m), until `stop_at` or until it no longer falls.

    `stop_at` is a time of `sapopt.kernels.clock.now`.
    """
    best: FoldedDual | None = None
    quiet, iterations, first = 0, 0, True
    dearer = np.zeros(folded.problem.n)
    while True:
        before = math.inf if best is None else best.bound

        def told(
            done: int,
            bound: float,
            _: FloatArray,
            now: FloatArray = dearer,
            least: float = before,
            past: int = iterations,
        ) -> bool:
            return watch(past + done, min(least, paths.whole(bound, now)))

        here = ascend(
            paths.at(dearer), prices, callback=told,
            time_limit=max(stop_at - clock.now(), 0.0) if math.isfinite(stop_at) else None,
            max_iterations=None if folded.is_plain else _FIRST if prices is None else _LATER,
        )  # fmt: skip
        iterations += here.iterations
        found = FoldedDual(paths.whole(here.bound, dearer), here.prices, dearer)
        if best is None or found.bound < best.bound:
            best = found
        quiet = 0 if best.bound < before - _WORTHWHILE * abs(before) else quiet + 1
        if folded.is_plain or quiet >= _QUIET or clock.now() >= stop_at or watch(iterations, best.bound):
            return best
        prices = here.prices
        wanted = _multipliers(folded, paths, prices)
        wanted = dearer + (1.0 if first else _DAMPED) * (wanted - dearer)
        dearer = np.where(folded.row >= 0, paths.grid * np.rint(wanted / paths.grid), 0.0)
        first = False


def _multipliers(folded: Folded, paths: FoldedPaths, prices: FloatArray) -> FloatArray:
    """The multipliers (n,) that are best at some prices, on the grid."""
    n = folded.problem.n
    low, high = np.zeros(n, dtype=np.int64), np.full(n, 8, dtype=np.int64)
    best, least = np.zeros(n), np.full(n, np.inf)

    def looked(level: np.ndarray) -> np.ndarray:
        """Whether every agent keeps its limit at a level."""
        dearer = paths.grid * level
        values, plan = paths.at(dearer).best_paths(prices)
        value = values + folded.most * dearer
        better = value < least
        best[better], least[better] = dearer[better], value[better]
        keeps: np.ndarray = folded.take_ups(plan) <= folded.most
        return keeps

    fits = looked(low)
    high[fits] = 0
    for _ in range(_DOUBLINGS):
        fits = looked(high)
        if fits.all():
            break
        low, high = np.where(fits, low, high), np.where(fits, high, 2 * high)
    while (high - low > 1).any():
        middle = (low + high) // 2
        fits = looked(middle)
        low, high = np.where(fits, low, middle), np.where(fits, middle, high)
    return best
