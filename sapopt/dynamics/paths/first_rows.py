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
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sapopt.data.feasibility import InfeasibleError, explain_infeasible
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import PathOracle
from sapopt.kernels.jit import njit
from sapopt.kernels.windows import fill_sorted


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


@njit(cache=True, borrows=True, nogil=True)
def slot_values(begin, end, window, slots, prices, waiting, values, leave):
    """Value of every slot, and of leaving: fills `values` (slots,) and `leave` (n, T) for the agents of a block.

    Backwards in time, with ``leave[b]``, the best value from step b + 1 on after a move, and the price of waiting:

        future_k[s] = benefit_k[s] + max(future_{k+1}[s] - price_{k+1}[s], leave[k])

    `leave` holds zeros on entry; where every task is a slot it means nothing.
    """
    n, indptr, data, cost = window.n, window.indptr, window.data, window.cost
    entry = slots.entry
    T = prices.shape[0]
    for i in range(begin, end):
        tasks = slots.task[slots.ptr[i] : slots.ptr[i + 1]]
        future = values[slots.ptr[i] : slots.ptr[i + 1]]
        for s in range(tasks.size):
            future[s] = 0.0
        for k in range(T - 1, -1, -1):
            if k > 0:
                for s in range(tasks.size):
                    future[s] -= prices[k, tasks[s]]
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                future[entry[e]] += data[e]
            if k > 0:
                best = -np.inf
                for s in range(tasks.size):
                    best = max(best, future[s])
                if waiting.shared:
                    best = max(best, -waiting.price[k, T])
                    for b in range(k + 1, T):
                        best = max(best, leave[i, b - 1] - waiting.price[k, b])
                leave[i, k - 1] = best - cost
                for s in range(tasks.size):
                    future[s] = max(future[s], best - cost)
            elif window.held[i] >= 0:
                for s in range(tasks.size):
                    if tasks[s] != window.held[i]:
                        future[s] -= cost
        if window.held[i] >= 0:
            for b in range(T):
                leave[i, b] -= cost


def sorted_rows(slots: Any, values: FloatArray, leave: FloatArray, dues: FloatArray) -> FirstRows:
    """The rows of the slots that are worth more than waiting there, by decreasing value.

    `slots` are those of `sapopt.dynamics.switching.layout`, `values` and `leave` as from `slot_values`.
    """
    row_start = np.zeros(len(leave) + 1, dtype=np.int64)
    tasks, worth = slots.task.copy(), values.copy()
    total = np.empty(int(tasks.max(initial=0)) + 1)
    filled = _sort_rows(slots.ptr, np.ascontiguousarray(leave), dues, row_start, tasks, worth, total)
    return FirstRows(row_start, tasks[:filled].copy(), worth[:filled].copy(), leave, dues)


@njit(cache=True, borrows=True, nogil=True)
def _sort_rows(ptr, leave, dues, row_start, tasks, worth, total):
    """Drop the slots that are worth no more than waiting, and sort the rows, in place; returns how many are left."""
    n, hubs = leave.shape
    filled = np.int64(
        0
    )  # a plain 0 would be a type of its own to the compiler, and `fill_sorted` compiled twice
    for i in range(n):
        begin = filled
        for s in range(ptr[i], ptr[i + 1]):
            j, value = tasks[s], worth[s]
            listed = value > -np.inf
            for b in range(hubs):
                if leave[i, b] - dues[b, j] >= value:
                    listed = False
                    break
            if listed:
                tasks[filled] = j
                total[j] = value
                filled += 1
        fill_sorted(tasks, worth, total, begin, filled)
        row_start[i + 1] = filled
    return filled
