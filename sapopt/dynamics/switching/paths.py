"""Path oracles of `SwitchingCost`: the three cost rules, from dense or flat sparse benefits.

`oracle(benefits, dynamics, state)` picks the recursion; see `sapopt.dynamics.switching.hard` for the mathematics.
"""

from __future__ import annotations

import copy
from functools import partial
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray, root_mean_square
from sapopt.dynamics.paths import first_rows as rows
from sapopt.dynamics.paths.first_rows import FirstRows
from sapopt.dynamics.paths.oracles import PathOracle
from sapopt.dynamics.paths.rows import Smoothing, cheapest_and_rest, cheapest_tasks, most_entries, widest_row
from sapopt.dynamics.paths.window import checked_prices, coldest_temperature, flat_benefits
from sapopt.dynamics.switching import first as first
from sapopt.dynamics.switching import hard as kernels
from sapopt.dynamics.switching import narrow as narrow
from sapopt.dynamics.switching import soft_idle as soft_idle
from sapopt.dynamics.switching import soft_strict as soft
from sapopt.dynamics.switching import soft_waits as waits
from sapopt.dynamics.switching.layout import Slots, Waiting, Window
from sapopt.dynamics.switching.soft_matrix import soft_matrix_paths
from sapopt.dynamics.switching.soft_waits import SoftWaiting
from sapopt.kernels.blocks import in_blocks, summed_in_blocks, work_array

_LEAST_TURNS = 25_000
"""Turns of a loop below which a soft path takes about as long as to find out what it could do without."""

_ONE_CALL = 200_000
"""Turns of the smoothed recursion up to which one thread does all in one call: calls of several threads, each with
arrays of its own, cost as much as the second thread saves (0.2 ms)."""

_FEW_STEPS = 16
"""Steps up to which all is done in one call. It takes a second to compile, which policies that plan thousands of short
windows win back; over a whole horizon three calls cost little more, and large problems need them anyhow."""


class _Switching:
    """Common part: the window's benefits, the tasks held before it, and the checks.

    In the window -1 begins with a free step. `lost` (n,) is 1 where an agent holds nothing and has to pay instead.
    """

    def __init__(self, benefits: Any, cost: Any, state: Any) -> None:
        indptr, indices, data, self._shape = flat_benefits(benefits)
        _, n, m = self._shape
        if np.isnan(data).any() or np.isposinf(data).any():
            raise ValueError("benefits: NaN or +inf found; use finite numbers, or -inf for a forbidden pair")
        self._scale = root_mean_square(data)
        start = np.full(n, -1, dtype=np.int64)
        if state is not None:
            held = np.asarray(state, dtype=np.int64)
            if held.shape != (n,) or (n and (held.min() < -1 or held.max() >= m)):
                raise ValueError(
                    f"state: expected the previous task of each of {n} agents, numbers in 0..{m - 1}, -1 for none"
                )
            start = held.copy()
        self.lost = np.zeros(n) if state is None else np.where(start < 0, 1.0, 0.0)
        self.window = Window(n, indptr, indices, data, cost, start)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window."""
        return self._shape

    @property
    def scale(self) -> float:
        """Typical size of a benefit: root mean square of the finite entries (1 if there are none)."""
        return self._scale

    def _prices(self, prices: FloatArray) -> FloatArray:
        return checked_prices(prices, self._shape)

    def smoothing(self, prices: FloatArray, temperature: float) -> Smoothing:
        """Prices (T, m) under log-sum-exp smoothing, and what a move weighs."""
        p, eps = self._prices(prices), float(temperature)
        return Smoothing(eps, float(np.exp(-self.window.cost / eps)), p, np.exp(-p / eps))

    def _empty_paths(self) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (n, T): the kernels write a path at a time."""
        T, n, _ = self._shape
        return np.empty(n), np.empty((n, T), dtype=np.int64)

    def _uniform_first_values(self, idle_is_free: bool, prices: FloatArray) -> FloatArray:
        T, n, m = self._shape
        out = np.empty((n, m))
        in_blocks(
            first.first_values, n, self.window, idle_is_free, self._prices(prices), out,
            scratch=lambda: (work_array(m),), turns=3.0 * T * n * m,
        )  # fmt: skip
        return out


class StrictSwitching(_Switching):
    """Every change of task pays the same cost."""

    def __init__(self, benefits: Any, cost: float, state: Any) -> None:
        self.cost = float(cost)
        super().__init__(benefits, self.cost, state)
        T, n, m = self._shape
        self.lost *= self.cost  # whatever the agent does: it is in no recursion, only in the values
        # A task with a negative or forbidden entry is no safe place to wait, so every agent keeps it as a slot.
        self.excluded = np.zeros(m, dtype=np.bool_)
        self.excluded[self.window.indices[self.window.data < 0.0]] = True
        self._free = np.flatnonzero(~self.excluded) if self.excluded.any() else slice(None)
        self._set_slots(True)
        # The table of waiting costs O(T^2 m) once and O(T^2) an agent; with few tasks a slot for each is cheaper.
        if not self.slots.task.size / max(n, 1) + T / 2 < m:
            self._set_slots(False)

    def _set_slots(self, park: bool) -> None:
        """List the slots: of the tasks an agent sees if it waits on the others by the table, else of all tasks."""
        m = self._shape[2]
        self.park = park
        everyone = self.excluded if park else np.ones(m, dtype=np.bool_)
        self.slots = kernels.find_slots(self.window, m, everyone)
        self._widest = int(np.diff(self.slots.ptr).max(initial=1))
        self._most = most_entries(self.window.indptr, self.window.n)

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        p = self._prices(prices)
        return self.best_beside(p, self.waiting(p))

    def best_beside(self, prices: FloatArray, waiting: Waiting) -> tuple[FloatArray, IntArray]:
        """The same with what waiting costs at hand."""
        values, plan = self._empty_paths()
        in_blocks(
            kernels.strict_paths, self.window.n, self.window, self.slots, prices, waiting, values, plan,
            scratch=partial(kernels.strict_scratch, len(prices), self._widest), turns=self._turns,
        )  # fmt: skip
        return values - self.lost, np.ascontiguousarray(plan.T)

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        T, n, m = self._shape
        p = self._prices(prices)
        values, plan = self._empty_paths()
        # Every task as a slot of this agent: no table to build, the cheapest way to a single path.
        ptr = np.zeros(n + 1, dtype=np.int64)
        ptr[agent + 1 :] = m
        slots = Slots(ptr, np.arange(m, dtype=np.int32), self.window.indices)
        kernels.strict_paths(
            agent,
            agent + 1,
            self.window,
            slots,
            p,
            self._no_waiting,
            values,
            plan,
            *kernels.strict_scratch(T, m),
        )
        return float(values[agent] - self.lost[agent]), plan[agent]

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        return self._uniform_first_values(False, prices) - self.lost[:, None]

    def first_rows(self, prices: FloatArray) -> FirstRows:
        """`first_values` in sparse form."""
        p = self._prices(prices)
        values, leave = np.empty(self.slots.task.size), np.zeros((self.window.n, len(p)))
        in_blocks(
            rows.slot_values, self.window.n, self.window, self.slots, p, self.waiting(p), values, leave,
            turns=self._turns,
        )  # fmt: skip
        if self.lost.any():
            values -= np.repeat(self.lost, np.diff(self.slots.ptr))
            leave -= self.lost[:, None]
        dues = rows.waiting_dues(p, self.excluded)
        if not self.park:  # every task is listed
            leave, dues = leave[:, :0], dues[:0]
        return rows.sorted_rows(self.slots, values, leave, dues)

    @property
    def worth_narrowing(self) -> bool:
        """Whether an iteration takes more than some tens of microseconds."""
        return self._turns >= _LEAST_TURNS

    def narrowed(self, prices: FloatArray, regret: float) -> StrictSwitching:
        """The same problem without the benefits that no path within `regret` of its agent's best one collects."""
        p = self._prices(prices)
        near = np.zeros(self.window.data.size, dtype=np.bool_)
        in_blocks(
            narrow.near_entries, self.window.n, self.window, self.slots, p, self.waiting(p), float(regret), near,
            scratch=partial(narrow.narrow_scratch, len(p), self._widest), turns=2.0 * self._turns,
        )  # fmt: skip
        return self._with_window(len(p), narrow.kept_window(self.window, near))

    def blocks(self, length: int) -> list[StrictSwitching]:
        """The problem cut into blocks of `length` steps; the later ones begin with a free step."""
        T, n, _ = self._shape
        whole = self.window
        found = []
        for begin in range(0, T, length):
            last = min(begin + length, T)
            starts = whole.indptr[begin * n : last * n + 1]
            entries = slice(starts[0], starts[-1])
            part = whole._replace(
                indptr=starts - starts[0],
                indices=whole.indices[entries],
                data=whole.data[entries],
                held=whole.held if begin == 0 else np.full(n, -1, dtype=np.int64),
            )
            block = self._with_window(last - begin, part)
            block.lost = self.lost if begin == 0 else np.zeros(n)
            found.append(block)
        return found

    def alone(self, agents: IntArray, cost: float) -> StrictSwitching:
        """Some of the agents, who pay another cost for a move."""
        T, n, _ = self._shape
        whole = self.window
        rows = (np.arange(T)[:, None] * n + agents).ravel()
        counts = np.diff(whole.indptr)[rows]
        indptr = np.concatenate([[0], np.cumsum(counts)])
        entries = np.arange(indptr[-1]) + np.repeat(whole.indptr[rows] - indptr[:-1], counts)
        part = Window(
            len(agents), indptr, whole.indices[entries], whole.data[entries], cost, whole.held[agents]
        )
        other = copy.copy(self)
        other.cost, other.lost = cost, (self.lost > 0)[agents] * cost
        return other._with_window(T, part)

    def _with_window(self, T: int, window: Window) -> StrictSwitching:
        other = copy.copy(self)
        other._shape = T, window.n, self._shape[2]
        other.window = window
        other._set_slots(self.park)
        return other

    def waiting(self, p: FloatArray) -> Waiting:
        """What waiting costs at prices (T, m), the same for all agents and whatever they pay for a move."""
        if not self.park:
            return self._no_waiting
        T, m = p.shape
        table = Waiting(True, np.zeros((T, T + 1)), np.zeros((T, T + 1), dtype=np.int32), self.excluded)
        in_blocks(
            kernels.waiting_table, T, p, self.excluded, table.price, table.task,
            scratch=lambda: (work_array(m),), turns=0.5 * T * T * m,
        )  # fmt: skip
        return table

    @property
    def _no_waiting(self) -> Waiting:
        return Waiting(False, np.zeros((1, 1)), np.zeros((1, 1), dtype=np.int32), self.excluded)

    @property
    def _turns(self) -> float:
        T, n, _ = self._shape
        return 2.0 * T * self.slots.task.size + (0.5 * n * T * T if self.park else 0.0)

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`: below it the weight of two moves leaves the range of floats."""
        return coldest_temperature(self.cost)

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        T, n, m = self._shape
        smoothing = self.smoothing(prices, temperature)
        if self.park and not self.excluded.all() and T <= _FEW_STEPS and 5.0 * self._turns < _ONE_CALL:
            best = self._best_waits(smoothing)
            if best.min() > waits.LEAST:
                waiting = SoftWaiting(True, True, best, np.zeros((T, T + 1)), np.zeros((T + 1, T)))
                usage, log_z = np.zeros((T, m)), np.empty(n)
                scratch = soft.strict_soft_scratch(T, self._widest, self._most)
                if soft.soft_strict_round(
                    self.window, self.slots, smoothing, self.excluded, waiting, *scratch, soft.round_scratch(T, m),
                    log_z, usage,
                ):  # fmt: skip
                    return smoothing.temperature * log_z - self.lost, usage
        waiting = self.soft_waiting(smoothing)
        values, usage, mass = self.soft_beside(smoothing, waiting)
        self.spread(smoothing, waiting, mass, usage)
        return values, usage

    def soft_beside(
        self, smoothing: Smoothing, waiting: SoftWaiting
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The same with what waiting weighs at hand; who waits is not in the usage yet, but counted by interval."""
        T, n, m = self._shape
        log_z = np.empty(n)
        usage, mass = summed_in_blocks(
            soft.soft_strict_paths, n, ((T, m), (T, T + 1)),
            self.window, self.slots, smoothing, waiting, log_z,
            scratch=partial(soft.strict_soft_scratch, T, self._widest, self._most), turns=5.0 * self._turns,
        )  # fmt: skip
        return smoothing.temperature * log_z - self.lost, usage, mass

    def soft_waiting(self, smoothing: Smoothing) -> SoftWaiting:
        """What waiting weighs, the same for all agents and whatever they pay for a move."""
        if not self.park:
            return SoftWaiting(False, True, np.ones(1), np.zeros((1, 1)), np.zeros((1, 1)))
        if self.excluded.all():  # there is nothing to wait on
            T = self._shape[0]
            return SoftWaiting(True, True, np.ones(T), np.zeros((T, T + 1)), np.zeros((T + 1, T)))
        return waits.waits(smoothing, self._best_waits(smoothing), self.excluded)

    def spread(self, smoothing: Smoothing, waiting: SoftWaiting, mass: FloatArray, usage: FloatArray) -> None:
        """Add the agents that wait to the usage (T, m), from their numbers by interval."""
        if self.park:
            waits.spread(smoothing, waiting, self.excluded, mass, usage)

    def _best_waits(self, smoothing: Smoothing) -> FloatArray:
        """Greatest weight (T,) of one task that may be waited on."""
        best: FloatArray = smoothing.weight[:, self._free].max(axis=1)
        return best


class IdleFreeSwitching(_Switching):
    """Only a move into a positive benefit pays."""

    def __init__(self, benefits: Any, cost: float, state: Any) -> None:
        self.cost = float(cost)
        super().__init__(benefits, self.cost, state)
        self.window.held[self.lost > 0] = self._shape[2]  # a task that is not there: nothing is a stay on it
        self._count = min(self._shape[2], widest_row(self.window.indptr) + 1)
        self._most = most_entries(self.window.indptr, self.window.n)

    @property
    def _turns(self) -> float:
        return 10.0 * self.window.data.size + 20.0 * self._shape[0] * self._shape[1]

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        p = self._prices(prices)
        values, plan = self._empty_paths()
        in_blocks(
            kernels.idle_free_paths, self.window.n, self.window, p, cheapest_tasks(p, self._count), values, plan,
            scratch=partial(kernels.idle_free_scratch, len(p), self._most), turns=self._turns,
        )  # fmt: skip
        return values, np.ascontiguousarray(plan.T)

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        p = self._prices(prices)
        values, plan = self._empty_paths()
        kernels.idle_free_paths(
            agent, agent + 1, self.window, p, np.empty((len(p), 0), dtype=np.int32), values, plan,
            *kernels.idle_free_scratch(len(p), self._most),
        )  # fmt: skip
        return float(values[agent]), plan[agent]

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        return self._uniform_first_values(True, prices)

    @property
    def coldest(self) -> float:
        """Any temperature will do."""
        return 0.0

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        T, n, m = self._shape
        p = self._prices(prices)
        least = p.min(axis=1, keepdims=True)  # counted from it, no price makes all weights vanish
        smoothing = self.smoothing(p - least, temperature)
        cheapest = cheapest_and_rest(smoothing.prices, smoothing.weight, min(m, self._count + 32))
        log_z = np.empty(n)
        usage, unlisted = summed_in_blocks(
            soft_idle.soft_idle_free_paths, n, ((T, m), (T,)), self.window, smoothing, cheapest, log_z,
            scratch=partial(soft_idle.idle_soft_scratch, T, m, self._most), turns=20.0 * self._turns,
        )  # fmt: skip
        usage += unlisted[:, None] * smoothing.weight
        return smoothing.temperature * log_z - float(least.sum()), usage


class MatrixSwitching(_Switching):
    """The cost of a move depends on both tasks: O(T m^2) an agent."""

    def __init__(self, benefits: Any, cost: FloatArray, idle_is_free: bool, state: Any) -> None:
        super().__init__(benefits, np.ascontiguousarray(cost, dtype=np.float64), state)
        m = self._shape[2]
        if self.window.cost.shape != (m, m):
            raise ValueError(
                f"cost: expected a number or a matrix of shape {(m, m)}, got {self.window.cost.shape}"
            )
        self.idle_is_free = bool(idle_is_free)

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        T, n, m = self._shape
        values, plan = self._empty_paths()
        in_blocks(
            kernels.matrix_paths, n, self.window, self.idle_is_free, self._prices(prices), values, plan,
            scratch=partial(kernels.matrix_scratch, T, m), turns=float(T * n * m * m),
        )  # fmt: skip
        return values, np.ascontiguousarray(plan.T)

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        T, _, m = self._shape
        values, plan = self._empty_paths()
        kernels.matrix_paths(
            agent, agent + 1, self.window, self.idle_is_free, self._prices(prices), values, plan,
            *kernels.matrix_scratch(T, m),
        )  # fmt: skip
        return float(values[agent]), plan[agent]

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        T, n, m = self._shape
        out = np.empty((n, m))
        in_blocks(
            first.first_values_matrix, n, self.window, self.idle_is_free, self._prices(prices), out,
            scratch=lambda: (work_array(m), work_array(m, dtype=np.bool_)), turns=float(T * n * m * m),
        )  # fmt: skip
        return out

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`: below it the weight of two moves leaves the range of floats."""
        return coldest_temperature(float(self.window.cost.max(initial=0.0)))

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        return soft_matrix_paths(self.window, self.idle_is_free, self._prices(prices), float(temperature))


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
