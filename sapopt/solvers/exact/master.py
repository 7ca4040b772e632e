"""The linear programme over stays, by column generation: only stays that prices call for are in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import GrowingProgramme, Programme
from sapopt.formulations.stays import Stays
from sapopt.solvers.exact.cuts import coefficients

_BATCH = 800
"""Stays that are added at a time."""
_RAISES = 5
"""How often the penalty of a step left out is raised tenfold before a node is given up."""
_ROUNDING = 1e-11
"""Relative padding of a bound: sums of some thousand terms in float64 are closer than that."""


@dataclass(frozen=True, eq=False)
class Relaxed:
    """A relaxation, solved unless it was cut short.

    Attributes
    ----------
    bound : float
        No plan over the open stays is worth more; -inf if there is none.
    stays : ndarray of int64
        Stays in the programme.
    x : ndarray
        Their shares.
    whole : bool
        Whether the shares make up a plan.
    complete : bool
        Whether no step was left out, as it is where the open stays allow no plan.
    prices : ndarray, shape (T, m)
        Prices that prove the bound.
    """

    bound: float
    stays: IntArray
    x: FloatArray
    whole: bool
    complete: bool
    prices: FloatArray


@dataclass(frozen=True, eq=False)
class Proof:
    """A Lagrangian bound: prices (T, m), wages (T, n), and what is left of every stay's gain after prices and fines."""

    bound: float
    prices: FloatArray
    wages: FloatArray
    weight: FloatArray


class Master:
    """The programme of one thread; stays can be closed and opened, and those once added remain.

    Parameters
    ----------
    stays : Stays
        All that are in the game.
    begin : ndarray of int64
        Stays to begin with.
    stop : callable
        Asked while the programme is solved; a true answer ends that.
    unit : float
        What stands for 1 in tolerances, see `sapopt.solvers.base.gap_unit`.
    """

    def __init__(
        self, stays: Stays, begin: IntArray, stop: Callable[[], bool] = lambda: False, unit: float = 1.0
    ) -> None:
        self.stays = stays
        self.stop = stop
        self.unit = unit
        self.inside = np.zeros(len(stays), dtype=bool)
        self.columns = np.zeros(0, dtype=np.int64)
        T, n, m = stays.shape
        self.last_prices: FloatArray = np.zeros((T, m))
        self.artificial = count = (
            n * T
        )  # a step of an agent that is left out, so that there always is a solution
        self.penalty = 2.0 * (float(np.abs(stays.gain).max(initial=0.0)) + unit)
        low, high = stays.sides
        self.programme = GrowingProgramme(
            Programme(
                np.full(count, -self.penalty), sp.csc_array(sp.eye_array(len(low), count)), low, high,
                np.full(count, np.inf), np.zeros(count, dtype=bool),
            )
        )  # fmt: skip
        self.closed = np.zeros(0, dtype=bool)
        self.cuts, self.right = coefficients(stays, [])
        self.add(begin)

    def add(self, stays: IntArray) -> None:
        """Put stays into the programme."""
        self.programme.add_columns(
            self.stays.gain[stays], sp.vstack([self.stays.rows(stays), self.cuts[:, stays]])
        )
        self.columns = np.concatenate([self.columns, stays])
        self.closed = np.concatenate([self.closed, np.zeros(len(stays), dtype=bool)])
        self.inside[stays] = True

    def cut(self, cuts: sp.csr_array, right: FloatArray) -> None:
        """Add rows (cuts, all stays) with their right-hand sides."""
        part = sp.csr_array(cuts[:, self.columns])
        part = sp.hstack([sp.csr_array((len(right), self.artificial)), part])
        self.programme.add_rows(part, right)
        self.cuts = sp.csr_array(sp.vstack([self.cuts, cuts]))
        self.right = np.concatenate([self.right, right])

    def close(self, closed: np.ndarray) -> None:
        """Close exactly the stays of a mask."""
        wanted = closed[self.columns]
        changed = np.flatnonzero(wanted != self.closed)
        if len(changed):
            self.programme.set_upper(changed + self.artificial, np.where(wanted[changed], 0.0, np.inf))
            self.closed = wanted

    def solve(self, closed: np.ndarray, cutoff: float) -> Relaxed:
        """Solve over all stays but those of the mask `closed`; stops early at a bound below the cut-off.

        Cut short by `stop`, it still gives a bound, but neither a plan nor the certainty that there is one.
        """
        bound = np.inf
        prices = self.last_prices
        raised = 0
        while True:
            self.close(closed)
            ended = self.programme.solve(self.stop)
            proof = self.proof(closed)
            if proof.bound < bound:
                bound, prices = proof.bound, proof.prices
            if bound <= cutoff or not ended:
                break
            better = self.stays.less_wages(proof.weight, proof.wages)
            better[closed | self.inside] = -np.inf
            better = np.where(better > 1e-7 * self.unit, better, -np.inf)
            if len(better) > _BATCH:
                chosen = np.argpartition(-better, _BATCH)[:_BATCH]
            else:
                chosen = np.arange(len(better))
            chosen = chosen[better[chosen] > 0]
            if len(chosen):
                self.add(chosen)
            elif self._left_out() > 1e-6 and raised < _RAISES and cutoff > -np.inf:
                raised += 1
                self._set_penalty(10.0**raised * self.penalty)
            else:
                break
        if raised:
            self._set_penalty(self.penalty)
        self.last_prices = prices
        x = self.programme.x
        left_out, x = x[: self.artificial], x[self.artificial :]
        complete = ended and bool((left_out < 1e-6).all())
        whole = complete and bool((np.minimum(x, 1 - x) < 1e-6).all())
        return Relaxed(bound, self.columns, x, whole, complete, prices)

    def _left_out(self) -> float:
        return float(self.programme.x[: self.artificial].max())

    def _set_penalty(self, penalty: float) -> None:
        """Make it dearer to leave a step out: where a node has no plan, its bound then falls below the cut-off."""
        self.programme.set_gain(np.arange(self.artificial), np.full(self.artificial, -penalty))

    def proof(self, closed: np.ndarray) -> Proof:
        """Lagrangian bound by the duals of the last programme."""
        T, n, m = self.stays.shape
        duals = self.programme.duals
        wages = duals[: n * T].reshape(n, T).T
        prices = np.maximum(duals[n * T : (n + m) * T].reshape(m, T).T, 0.0)
        lowest = prices.min(axis=1, keepdims=True)
        # Every agent holds one task at every step, so this never raises the bound.
        prices, wages = prices - lowest, wages + lowest
        weight = self.stays.priced(prices)
        fixed = float(prices.sum())
        if len(self.right):
            fines = np.maximum(duals[(n + m) * T :], 0.0)
            weight -= self.cuts.T @ fines
            fixed += float(fines @ self.right)
        weight[closed] = -np.inf
        values, _ = self.stays.through(weight)
        total = float(values.sum()) + fixed
        return Proof(total + _ROUNDING * max(self.unit, abs(total)), prices, wages, weight)

    def probe(self, closed: np.ndarray, basis: Any, iterations: int) -> float:
        """Bound after a few steps of the dual simplex method from a basis, without new stays."""
        self.programme.basis = basis
        self.close(closed)
        self.programme.solve(self.stop, iterations)
        return self.proof(closed).bound
