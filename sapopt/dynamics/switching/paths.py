"""Path oracles of `SwitchingCost`: the three cost rules, from dense or flat sparse benefits.

`oracle(benefits, dynamics, state)` picks the recursion; see `switching_paths_kernels` for the mathematics.
"""

from __future__ import annotations

import copy
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths import first_rows as rows
from sapopt.dynamics.paths.first_rows import FirstRows
from sapopt.dynamics.paths.oracles import PathOracle
from sapopt.dynamics.paths.window import flat_benefits
from sapopt.dynamics.switching import first as first
from sapopt.dynamics.switching import hard as kernels
from sapopt.dynamics.switching import narrow as narrow
from sapopt.dynamics.switching import soft_idle as soft_idle
from sapopt.dynamics.switching import soft_strict as soft


class _Switching:
    """Common part: the window's benefits, the tasks held before it, and the checks."""

    def __init__(self, benefits: Any, state: Any) -> None:
        self.indptr, self.indices, self.data, self._shape = flat_benefits(benefits)
        _, n, m = self._shape
        if np.isnan(self.data).any() or np.isposinf(self.data).any():
            raise ValueError("benefits: NaN or +inf found; use finite numbers, or -inf for a forbidden pair")
        finite = self.data[np.isfinite(self.data)]
        self._scale = float(np.sqrt(np.mean(finite**2))) if finite.size else 1.0
        self.start = np.full(n, -1, dtype=np.int64)
        if state is not None:
            held = np.asarray(state, dtype=np.int64)
            if held.shape != (n,) or (n and (held.min() < 0 or held.max() >= m)):
                raise ValueError(
                    f"state: expected the previous task of each of {n} agents, numbers in 0..{m - 1}"
                )
            self.start = held.copy()

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window."""
        return self._shape

    @property
    def scale(self) -> float:
        """Typical size of a benefit: root mean square of the finite entries (1 if there are none)."""
        return self._scale

    def _prices(self, prices: FloatArray) -> FloatArray:
        T, _, m = self._shape
        p = np.ascontiguousarray(prices, dtype=np.float64)
        if p.shape != (T, m):
            raise ValueError(f"prices: expected shape {(T, m)}, got {p.shape}")
        return p

    def _rows(self) -> tuple[IntArray, NDArray[np.int32], FloatArray, int]:
        return self.indptr, self.indices, self.data, self._shape[1]

    def _threads(self) -> int:
        # every chunk of the soft recursions sums up its own usage (T, m)
        return min(max(1, self._shape[1]), int(numba.get_num_threads()))

    def _chunks(self) -> int:
        # a few chunks a thread even out the agents' different numbers of tasks
        return min(max(1, self._shape[1]), 8 * int(numba.get_num_threads()))


class StrictSwitching(_Switching):
    """Every change of task pays the same cost."""

    def __init__(self, benefits: Any, cost: float, state: Any) -> None:
        super().__init__(benefits, state)
        T, n, m = self._shape
        self.cost = float(cost)
        # A task with a negative or forbidden entry is no safe parking place, so every agent keeps it as a slot.
        self.excluded = np.zeros(m, dtype=np.bool_)
        self.excluded[self.indices[self.data < 0.0]] = True
        always = self.excluded
        self.slot_ptr, self.slot_task, self.entry_slot = kernels.seen_tasks(
            self.indptr, self.indices, n, T, m, self.start, always
        )
        # The parking table costs O(T^2 m) once and O(T^2) an agent; with few tasks a slot for each is cheaper.
        self.park = bool(self.slot_task.size / max(n, 1) + T / 2 < m)
        if not self.park:
            self.slot_ptr, self.slot_task, self.entry_slot = kernels.seen_tasks(
                self.indptr, self.indices, n, T, m, self.start, np.ones(m, dtype=np.bool_)
            )

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        p = self._prices(prices)
        if self.park:
            table, task = kernels.parking_table(p, self.excluded)
        else:
            table, task = np.zeros((1, 1)), np.zeros((1, 1), dtype=np.int32)
        values, plan = kernels.strict_paths(
            self.indptr, self.entry_slot, self.data, self.slot_ptr, self.slot_task, self.cost, self.start, p,
            self.park, table, task, self.excluded, self._chunks(),
        )  # fmt: skip
        return values, plan

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        n = self._shape[1]
        value, path = kernels.strict_path_all_tasks(
            agent, n, self.indptr, self.indices, self.data, self.cost, self.start[agent], self._prices(prices)
        )
        return float(value), path

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        values: FloatArray = first.first_values(
            *self._rows(), self.cost, False, self.start, self._prices(prices)
        )
        return values

    def first_rows(self, prices: FloatArray) -> FirstRows:
        """`first_values` in sparse form."""
        p = self._prices(prices)
        table = kernels.parking_table(p, self.excluded)[0] if self.park else np.zeros((1, 1))
        values, leave = rows.slot_values(
            self.indptr, self.entry_slot, self.data, self.slot_ptr, self.slot_task, self.cost, self.start, p,
            self.park, table,
        )  # fmt: skip
        dues = rows.waiting_dues(p, self.excluded)
        if not self.park:  # every task is listed
            leave, dues = leave[:, :0], dues[:0]
        row_start, tasks, values = rows.sorted_rows(self.slot_ptr, self.slot_task, values, leave, dues)
        return FirstRows(row_start, tasks, values, leave, dues)

    def narrowed(self, prices: FloatArray, regret: float) -> StrictSwitching:
        """The same problem without the benefits that no path within `regret` of its agent's best one collects."""
        p = self._prices(prices)
        table = kernels.parking_table(p, self.excluded)[0] if self.park else np.zeros((1, 1))
        near = narrow.near_entries(
            self.indptr, self.entry_slot, self.data, self.slot_ptr, self.slot_task, self.cost, self.start, p,
            self.park, table, regret, self._chunks(),
        )  # fmt: skip
        indptr, indices, data = narrow.kept_rows(self.indptr, self.indices, self.data, near)
        return self._with_entries(self._shape[0], indptr, indices, data, self.start)

    def blocks(self, length: int) -> list[StrictSwitching]:
        """The problem cut into blocks of `length` steps; the later ones begin with a free step."""
        T, n, _ = self._shape
        found = []
        for begin in range(0, T, length):
            last = min(begin + length, T)
            starts = self.indptr[begin * n : last * n + 1]
            entries = slice(starts[0], starts[-1])
            start = self.start if begin == 0 else np.full(n, -1, dtype=np.int64)
            found.append(
                self._with_entries(
                    last - begin, starts - starts[0], self.indices[entries], self.data[entries], start
                )
            )
        return found

    def _with_entries(
        self, T: int, indptr: IntArray, indices: NDArray[np.int32], data: FloatArray, start: IntArray
    ) -> StrictSwitching:
        _, n, m = self._shape
        other = copy.copy(self)
        other._shape = T, n, m
        other.indptr, other.indices, other.data, other.start = indptr, indices, data, start
        always = self.excluded if self.park else np.ones(m, dtype=np.bool_)
        other.slot_ptr, other.slot_task, other.entry_slot = kernels.seen_tasks(
            indptr, indices, n, T, m, start, always
        )
        return other

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`: below it the weight of two moves leaves the range of floats."""
        return self.cost / 300.0

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        p = self._prices(prices)
        w = np.exp(-p / temperature)
        shares = soft.soft_parking(w, self.excluded) if self.park else np.zeros((1, 1))
        log_z, usage, mass = soft.soft_strict_paths(
            self.indptr, self.entry_slot, self.data, self.slot_ptr, self.slot_task, self.cost, temperature, self.start,
            p, w, self.park, shares, self._threads(),
        )  # fmt: skip
        if self.park:
            usage = usage + soft.spread_parking(p, temperature, self.excluded, shares, mass)
        return temperature * log_z, usage


class IdleFreeSwitching(_Switching):
    """Only a move into a positive benefit pays."""

    def __init__(self, benefits: Any, cost: float, state: Any) -> None:
        super().__init__(benefits, state)
        _, _, m = self._shape
        self.cost = float(cost)
        widest = int(np.diff(self.indptr).max(initial=0))
        self._count = min(m, widest + 1)

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        p = self._prices(prices)
        cheapest = kernels.cheapest_tasks(p, self._count)
        values, plan = kernels.idle_free_paths(
            *self._rows(), self.cost, self.start, p, cheapest, self._chunks()
        )
        return values, plan

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        n = self._shape[1]
        value, path = kernels.idle_free_path(
            agent, n, self.indptr, self.indices, self.data, self.cost, self.start[agent], self._prices(prices)
        )
        return float(value), path

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        values: FloatArray = first.first_values(
            *self._rows(), self.cost, True, self.start, self._prices(prices)
        )
        return values

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`: below it the weight of two moves leaves the range of floats."""
        return self.cost / 300.0

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        p = self._prices(prices)
        w = np.exp(-p / temperature)
        cheapest, rest, rank = soft_idle.cheapest_and_rest(p, w, min(self._shape[2], self._count + 32))
        log_z, usage = soft_idle.soft_idle_free_paths(
            *self._rows(), self.cost, temperature, self.start, p, w, cheapest, rest, rank, self._threads()
        )
        return temperature * log_z, usage


class MatrixSwitching(_Switching):
    """The cost of a move depends on both tasks: O(T m^2) an agent."""

    def __init__(self, benefits: Any, cost: FloatArray, idle_is_free: bool, state: Any) -> None:
        super().__init__(benefits, state)
        m = self._shape[2]
        self.cost = np.ascontiguousarray(cost, dtype=np.float64)
        if self.cost.shape != (m, m):
            raise ValueError(f"cost: expected a number or a matrix of shape {(m, m)}, got {self.cost.shape}")
        self.idle_is_free = bool(idle_is_free)

    def _paths(self, prices: FloatArray, first: int, last: int) -> tuple[FloatArray, IntArray]:
        values, plan = kernels.matrix_paths(
            *self._rows(), self.cost, self.idle_is_free, self.start, self._prices(prices), first, last
        )
        return values, plan

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        return self._paths(prices, 0, self._shape[1])

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        values, plan = self._paths(prices, agent, agent + 1)
        return float(values[0]), plan[:, 0]

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        values: FloatArray = first.first_values_matrix(
            *self._rows(), self.cost, self.idle_is_free, self.start, self._prices(prices)
        )
        return values


def oracle(benefits: Any, dynamics: Any, state: Any = None) -> PathOracle:
    """The path oracle of a `SwitchingCost`.

    Parameters
    ----------
    benefits : Benefits or (T, n, m) float array
        The window's benefits; sparse ones are never expanded.
    dynamics : SwitchingCost
        `cost` a number or an (m, m) matrix, `idle_is_free`.
    state : (n,) int array or None
        Tasks held before the first step; None makes the first step free.
    """
    cost = np.asarray(dynamics.cost, dtype=np.float64)
    if cost.ndim == 2:
        return MatrixSwitching(benefits, cost, dynamics.idle_is_free, state)
    if dynamics.idle_is_free:
        return IdleFreeSwitching(benefits, float(cost), state)
    return StrictSwitching(benefits, float(cost), state)
