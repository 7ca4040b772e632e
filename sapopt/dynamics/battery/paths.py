"""Path oracle of `Battery`, from dense or flat sparse benefits; the mathematics is in the kernels' modules."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from sapopt.data.matrices import GainMatrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.battery import hard as kernels
from sapopt.dynamics.battery import soft as soft
from sapopt.dynamics.paths.window import flat_benefits
from sapopt.dynamics.switching.soft_idle import cheapest_and_rest

if TYPE_CHECKING:
    from sapopt.dynamics.battery.model import Battery, BatteryState


class BatteryPaths:
    """Longest priced paths of agents on batteries: O(levels x visible tasks) per agent and step.

    Parameters
    ----------
    benefits : Benefits or (T, n, m) float array
        The window's benefits; sparse ones are never expanded.
    dynamics : Battery
    state : BatteryState
        State before the first step of the window.
    goes_on : bool
        The problem goes on after the window, so that charge which is left over has a value, see `leftover`; by default
        it ends there, and has none.
    end_value : ndarray of float64, shape (levels + 1,), optional
        What every level is worth after the window, in place of `leftover`.
    """

    def __init__(
        self,
        benefits: Any,
        dynamics: Battery,
        state: BatteryState,
        *,
        goes_on: bool = False,
        end_value: FloatArray | None = None,
    ) -> None:
        indptr, indices, data, self._shape = flat_benefits(benefits)
        T, n, m = self._shape
        self.levels = np.ascontiguousarray(state.levels, dtype=np.int64)
        if self.levels.shape != (n,):
            raise ValueError(f"state: expected the level of each of {n} agents, got {self.levels.shape}")
        self.ready = np.ascontiguousarray(dynamics.serving(state), dtype=np.int64)
        self.free = state.held is None
        self.cost = dynamics.cost
        units = dynamics.units
        if end_value is not None:
            end = np.ascontiguousarray(end_value, dtype=np.float64)
            if end.shape != (units.capacity + 1,) or not np.isfinite(end).all():
                raise ValueError(
                    f"end_value must hold a finite number for each of the {units.capacity + 1} levels"
                )
        elif goes_on:
            end = leftover(indptr, data, T, *units[1:])
        else:
            end = np.zeros(units.capacity + 1)
        self.battery = (dynamics.cost, *units[1:], dynamics.pay_for == "entries", end)
        self.rows = (indptr, indices, data, *kernels.neighbours(indptr, indices, data, T, n))
        self._count = min(m, int(np.diff(indptr).max(initial=0)) + 1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window."""
        return self._shape

    @property
    def scale(self) -> float:
        """Typical size of a benefit: root mean square of the finite entries (1 if there are none)."""
        finite = self.rows[2][np.isfinite(self.rows[2])]
        return float(np.sqrt(np.mean(finite**2))) if finite.size else 1.0

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`: below it the weight of two moves leaves the range of floats."""
        return self.cost / 300.0

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        p = self._prices(prices)
        values, plan = kernels.best_paths(
            self._shape[1], self.rows, self.battery, p, kernels.cheapest_tasks(p, self._count), *self._start,
            self._chunks(8),
        )  # fmt: skip
        return values, plan

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        p = self._prices(prices)
        value, path = kernels.best_path(agent, self._shape[1], self.rows, self.battery, *self._start, p)
        return float(value), path

    def place(self, order: IntArray, closed: FloatArray, prices: FloatArray, plan: IntArray) -> None:
        """Let agents re-plan one after another, in place (`sapopt.dynamics.paths.oracles.PlacingOracle`)."""
        kernels.place(
            self._shape[1], self.rows, self.battery, *self._start, order, closed, self._prices(prices), plan
        )

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        T, n, m = self._shape
        rest, listed = self._first(prices)
        values = np.repeat(rest[:, None], m, axis=1)
        indptr, indices = self.rows[:2]
        for k in range(min(T, 2)):
            agents = np.repeat(np.arange(n), np.diff(indptr[k * n : (k + 1) * n + 1]))
            span = slice(indptr[k * n], indptr[(k + 1) * n])
            values[agents, indices[span]] = listed[span]
        return values

    def first_gains(self, prices: FloatArray) -> GainMatrix:
        """`first_values` in sparse form, less a constant for every agent, which changes no assignment."""
        _, n, m = self._shape
        rest, listed = self._first(prices)
        row_start, tasks, gains = kernels.first_gains(n, m, self.rows, rest, listed)
        negative = bool(gains.min(initial=0.0) < 0)
        return GainMatrix(row_start, tasks, gains, np.full(n, -1), np.zeros(n), 0.0, m, negative)

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        p = self._prices(prices)
        least = p.min(axis=1, keepdims=True)  # every path pays it; without it no weight underflows
        p = p - least
        w = np.exp(-p / temperature)
        listing = cheapest_and_rest(p, w, min(self._shape[2], self._count + 32))
        log_z, usage = soft.soft_paths(
            self._shape[1],
            self.rows,
            self.battery,
            temperature,
            p,
            w,
            *listing,
            *self._start,
            self._chunks(1),
        )
        return temperature * log_z - least.sum(), usage

    def mean_values(self, prices: FloatArray) -> FloatArray:
        """What each level is worth before each step and after the last, (T + 1, levels + 1): mean of the agents.

        Of the paths that follow under `prices`, whose first start of work is paid.
        """
        p = self._prices(prices)
        values: FloatArray = kernels.mean_values(
            self._shape[1], self.rows, self.battery, p, kernels.cheapest_tasks(p, self._count)
        )
        return values

    def _first(self, prices: FloatArray) -> tuple[FloatArray, FloatArray]:
        p = self._prices(prices).copy()
        p[0] = 0.0
        rest, listed = kernels.first_entries(
            self._shape[1], self.rows, self.battery, p, kernels.cheapest_tasks(p, self._count), *self._start,
            self._chunks(8),
        )  # fmt: skip
        return rest, listed

    @property
    def _start(self) -> tuple[IntArray, IntArray, bool]:
        return self.levels, self.ready, self.free

    def _prices(self, prices: FloatArray) -> FloatArray:
        T, _, m = self._shape
        p = np.ascontiguousarray(prices, dtype=np.float64)
        if p.shape != (T, m):
            raise ValueError(f"prices: expected shape {(T, m)}, got {p.shape}")
        return p

    def _chunks(self, per_thread: int) -> int:
        return min(max(1, self._shape[1]), per_thread * int(numba.get_num_threads()))


def leftover(
    indptr: IntArray, data: FloatArray, T: int, drain: int, charge: int, capacity: int
) -> FloatArray:
    """What charge is worth at the end of a window that is not the end of the problem, by level (levels + 1,).

    An agent that neither runs down nor wastes charge works at a share ``charge / (charge + drain)`` of the steps, and
    picks the best ones; the least of those is what a step's drain is worth to it in the long run. It is read off the
    window: the quantile of the largest benefits in sight, over all agents and steps. A full battery cannot store what
    comes in next, and an empty one must wait, so the value of the last drop falls linearly from twice that to nothing.
    Death costs more than anything that the window can bring.
    """
    largest = kernels.row_maxima(indptr, np.where(np.isfinite(data), data, 0.0))
    share = charge / max(charge + drain, 1)
    worth = float(np.quantile(largest, 1.0 - share)) * capacity / max(drain, 1) if drain else 0.0
    full = np.arange(capacity + 1) / capacity
    value: FloatArray = worth * (2.0 * full - full**2)
    value[0] = -float(largest.max(initial=0.0)) * (T + 1) - worth if drain else 0.0
    return value
