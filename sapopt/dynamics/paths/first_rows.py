"""What the first assignment of a window is worth, without a matrix of all agents and tasks.

For every agent i and task j: the value of i's longest path under the prices among those that hold j at the first step,
the price of the first step left out. Only the tasks that an agent sees within the window, or holds, need an entry. On
any other task it merely waits; it leaves at a step b and goes on along its best path, or waits to the end (b = T):

    value[i, j] = max_b leave[i, b] - dues[b, j],   dues[b, j] = sum of price[t, j] over the steps 1 <= t < b.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numba import njit, prange

from sapopt.data.feasibility import InfeasibleError, explain_infeasible
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import PathOracle


@dataclass(frozen=True, eq=False)
class FirstRows:
    """Values of the first tasks in sparse form, see the module documentation.

    Attributes
    ----------
    row_start : (n + 1,) int64 array
    tasks : (entries,) int32 array
    values : (entries,) float64 array
        Sorted by decreasing value inside a row, equal ones by ascending task; never below the unlisted value of the
        pair. -inf never occurs: a forbidden pair is not listed and has no unlisted value.
    leave : (n, B) float64 array
    dues : (B, m) float64 array
    """

    row_start: IntArray
    tasks: np.ndarray
    values: FloatArray
    leave: FloatArray
    dues: FloatArray

    def toarray(self) -> FloatArray:
        """The values as an array of shape (n, m), -inf where a pair is forbidden."""
        n, m = len(self.row_start) - 1, self.dues.shape[1]
        out = np.full((n, m), -np.inf)
        for leave, dues in zip(self.leave.T, self.dues, strict=True):
            np.maximum(out, leave[:, None] - dues[None, :], out=out)
        out[np.repeat(np.arange(n), np.diff(self.row_start)), self.tasks] = self.values
        return out

    def assign(self, prices: FloatArray | None = None, check: Callable[[], None] | None = None) -> IntArray:
        """The assignment (n,) of greatest total value.

        Parameters
        ----------
        prices : (m,) float array, optional
            Prices to start from, not negative; good ones save work. Where tasks can stay free, prices other than zero
            make a free task worth its price.
        check : callable, optional
            Called now and then; what it raises ends the work.

        Raises
        ------
        InfeasibleError
            If forbidden pairs leave no full assignment.
        """
        from sapopt.kernels.priced import assign_rows

        m = self.dues.shape[1]
        start = np.zeros(m) if prices is None else np.ascontiguousarray(prices, dtype=np.float64)
        chosen: IntArray = assign_rows(
            self.row_start, self.tasks, self.values, self.leave, self.dues, start, check
        )
        if len(chosen) == 0:
            raise InfeasibleError(explain_infeasible(np.isfinite(self.toarray())))
        return chosen


@runtime_checkable
class FirstRowsOracle(PathOracle, Protocol):
    """An oracle that values first tasks in sparse form."""

    def first_rows(self, prices: FloatArray) -> FirstRows:
        """Values of every agent's best path by its first task; the first step's prices do not count."""


def waiting_dues(prices: FloatArray, excluded: np.ndarray) -> FloatArray:
    """dues (T, m): row b - 1 is the price of waiting on a task over the steps 1..b-1; +inf on excluded tasks."""
    dues = np.zeros(prices.shape)
    np.cumsum(prices[1:], axis=0, out=dues[1:])
    dues[:, excluded] = np.inf
    return dues


@njit(cache=True, parallel=True)
def slot_values(indptr, entry_slot, data, slot_ptr, slot_task, cost, start, prices, waits, wait_price):
    """Value of every slot, and of leaving: (values (slots,), leave (n, T)); `wait_price` as `parking_table`.

    Without `waits` every task is a slot, and `leave` means nothing.
    """
    T = prices.shape[0]
    n = slot_ptr.size - 1
    values = np.zeros(slot_task.size)
    leave = np.zeros((n, T))
    for i in prange(n):
        slots = slot_task[slot_ptr[i] : slot_ptr[i + 1]]
        future = values[slot_ptr[i] : slot_ptr[i + 1]]
        for k in range(T - 1, -1, -1):
            if k > 0:
                for s in range(slots.size):
                    future[s] -= prices[k, slots[s]]
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                future[entry_slot[e]] += data[e]
            if k > 0:
                best = -np.inf
                for s in range(slots.size):
                    best = max(best, future[s])
                if waits:
                    best = max(best, -wait_price[k, T])
                    for b in range(k + 1, T):
                        best = max(best, leave[i, b - 1] - wait_price[k, b])
                leave[i, k - 1] = best - cost
                for s in range(slots.size):
                    future[s] = max(future[s], best - cost)
            elif start[i] >= 0:
                for s in range(slots.size):
                    if slots[s] != start[i]:
                        future[s] -= cost
        if start[i] >= 0:
            for b in range(T):
                leave[i, b] -= cost
    return values, leave


@njit(cache=True)
def sorted_rows(slot_ptr, slot_task, values, leave, dues):
    """Rows of the slots that are worth more than waiting there, by decreasing value: (row_start, tasks, values)."""
    n, hubs = leave.shape
    row_start = np.zeros(n + 1, np.int64)
    tasks = np.empty(slot_task.size, np.int32)
    worth = np.empty(slot_task.size)
    filled = 0
    for i in range(n):
        begin = filled
        for s in range(slot_ptr[i], slot_ptr[i + 1]):
            j = slot_task[s]
            value = values[s]
            listed = value > -np.inf
            for b in range(hubs):
                if leave[i, b] - dues[b, j] >= value:
                    listed = False
                    break
            if listed:
                tasks[filled] = j
                worth[filled] = value
                filled += 1
        order = np.argsort(-worth[begin:filled], kind="mergesort")
        tasks[begin:filled] = tasks[begin:filled][order]
        worth[begin:filled] = worth[begin:filled][order]
        row_start[i + 1] = filled
    return row_start, tasks[:filled], worth[:filled]
