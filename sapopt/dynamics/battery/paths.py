"""Path oracle of `Battery`, from dense or flat sparse benefits; the mathematics is in the kernels' modules."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.matrices import GainMatrix
from sapopt.data.types import FloatArray, IntArray, root_mean_square
from sapopt.dynamics.battery import hard as kernels
from sapopt.dynamics.battery import soft as soft
from sapopt.dynamics.battery.hard import Before, Rule, link_rows
from sapopt.dynamics.paths.rows import Smoothing, cheapest_and_rest, cheapest_tasks, most_entries, widest_row
from sapopt.dynamics.paths.window import checked_prices, coldest_temperature, flat_benefits
from sapopt.kernels.blocks import in_blocks, summed_in_blocks

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
        levels = np.ascontiguousarray(state.levels, dtype=np.int64)
        if levels.shape != (n,):
            raise ValueError(f"state: expected the level of each of {n} agents, got {levels.shape}")
        ready = np.ascontiguousarray(dynamics.serving(state), dtype=np.int64)
        self.before = Before(levels, ready, state.held is None)
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
        drain, charge, capacity = (int(unit) for unit in units[1:])
        self.rule = Rule(float(dynamics.cost), drain, charge, capacity, dynamics.pay_for == "entries", end)
        self.rows = link_rows(indptr, indices, data, n)
        self._count = min(m, widest_row(indptr) + 1)
        self._most = most_entries(indptr, n)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window."""
        return self._shape

    @property
    def scale(self) -> float:
        """Typical size of a benefit: root mean square of the finite entries (1 if there are none)."""
        return root_mean_square(self.rows.data)

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`: below it the weight of two moves leaves the range of floats."""
        return coldest_temperature(self.cost)

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        p = self._prices(prices)
        T, n, _ = self._shape
        values, plan = np.empty(n), np.empty((n, T), dtype=np.int64)
        in_blocks(
            kernels.best_paths, n, self.rows, self.rule, self.before, p, cheapest_tasks(p, self._count), values, plan,
            scratch=self._scratch, turns=self._turns,
        )  # fmt: skip
        return values, np.ascontiguousarray(plan.T)

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        p = self._prices(prices)
        T, n, _ = self._shape
        values, plan = np.empty(n), np.empty((n, T), dtype=np.int64)
        kernels.best_paths(
            agent, agent + 1, self.rows, self.rule, self.before, p, self._all_tasks, values, plan, *self._scratch()
        )  # fmt: skip
        return float(values[agent]), plan[agent]

    def place(self, order: IntArray, closed: FloatArray, prices: FloatArray, plan: IntArray) -> None:
        """Let agents re-plan one after another, in place (`sapopt.dynamics.paths.oracles.PlacingOracle`)."""
        kernels.place(
            order, self.rows, self.rule, self.before, closed, self._prices(prices), self._all_tasks, plan,
            np.empty(self._shape[0], dtype=np.int64), *self._scratch(),
        )  # fmt: skip

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        T, n, m = self._shape
        rest, listed = self._first(prices)
        values = np.repeat(rest[:, None], m, axis=1)
        indptr, indices = self.rows.indptr, self.rows.indices
        for k in range(min(T, 2)):
            agents = np.repeat(np.arange(n), np.diff(indptr[k * n : (k + 1) * n + 1]))
            span = slice(indptr[k * n], indptr[(k + 1) * n])
            values[agents, indices[span]] = listed[span]
        return values

    def first_gains(self, prices: FloatArray) -> GainMatrix:
        """`first_values` in sparse form, less a constant for every agent, which changes no assignment."""
        _, n, m = self._shape
        rest, listed = self._first(prices)
        row_start = np.empty(n + 1, dtype=np.int64)
        tasks, gains = np.empty(listed.size, dtype=np.int32), np.empty(listed.size)
        filled = kernels.first_gains(self.rows, rest, listed, np.empty(m), row_start, tasks, gains)
        tasks, gains = tasks[:filled].copy(), gains[:filled].copy()
        negative = bool(gains.min(initial=0.0) < 0)
        return GainMatrix(row_start, tasks, gains, np.full(n, -1), np.zeros(n), 0.0, m, negative)

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        T, n, m = self._shape
        p, eps = self._prices(prices), float(temperature)
        least = p.min(axis=1, keepdims=True)  # every path pays it; without it no weight underflows
        p = p - least
        smoothing = Smoothing(eps, float(np.exp(-self.cost / eps)), p, np.exp(-p / eps))
        cheapest = cheapest_and_rest(p, smoothing.weight, min(m, self._count + 32))
        log_z = np.empty(n)
        usage, unlisted = summed_in_blocks(
            soft.soft_paths, n, ((T, m), (T,)), self.rows, self.rule, self.before, smoothing, cheapest, log_z,
            scratch=partial(soft.make_soft_scratch, T, m, self._most, self.rule.capacity), turns=10.0 * self._turns,
        )  # fmt: skip
        usage += unlisted[:, None] * smoothing.weight
        return eps * log_z - least.sum(), usage

    def mean_values(self, prices: FloatArray) -> FloatArray:
        """What each level is worth before each step and after the last, (T + 1, levels + 1): mean of the agents.

        Of the paths that follow under `prices`, whose first start of work is paid.
        """
        p = self._prices(prices)
        T, n, _ = self._shape
        (total,) = summed_in_blocks(
            kernels.add_values, n, ((T + 1, self.rule.capacity + 1),), self.rows, self.rule, p,
            cheapest_tasks(p, self._count), scratch=self._scratch, turns=self._turns,
        )  # fmt: skip
        return total / n

    def _first(self, prices: FloatArray) -> tuple[FloatArray, FloatArray]:
        p = self._prices(prices).copy()
        p[0] = 0.0
        T, n, _ = self._shape
        rest = np.empty(n)
        listed = np.full(self.rows.indptr[min(T, 2) * n], -np.inf)
        in_blocks(
            kernels.first_entries, n, self.rows, self.rule, self.before, p, cheapest_tasks(p, self._count),
            rest, listed, scratch=self._scratch, turns=self._turns,
        )  # fmt: skip
        return rest, listed

    def _scratch(self) -> tuple[kernels.Scratch]:
        T, _, m = self._shape
        return kernels.make_scratch(T, m, self._most, self.rule.capacity)

    @property
    def _all_tasks(self) -> np.ndarray:
        """An empty list of the cheapest tasks: the kernels then look at all, once, which is cheaper for few agents."""
        return np.empty((self._shape[0], 0), dtype=np.int32)

    @property
    def _turns(self) -> float:
        T, n, _ = self._shape
        return 3.0 * (self.rule.capacity + 1) * (self.rows.data.size + T * n)

    def _prices(self, prices: FloatArray) -> FloatArray:
        return checked_prices(prices, self._shape)


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
