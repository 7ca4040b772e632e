"""The dual of a folded problem: prices of the tasks, and what every agent pays more for a move.

A multiplier y >= 0 of "agent i takes up at most H tasks" raises what i pays for a move by y. The agents' paths are
those of the plain problem with a cost for each agent, and for any prices and multipliers

    sum_i (path_i at cost + y_i) + sum mu + sum_i H_i y_i  >=  optimum.

`sapopt.formulations.limited.joint_descent` looks for the best ones.
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
from sapopt.formulations.limited.dual import Prices
from sapopt.formulations.limited.folded import Folded

_GRID = 0.02
"""Multipliers are whole multiples of this share of the typical benefit, so that many agents pay the same."""
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
