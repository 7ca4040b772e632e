"""Idling in the network of a window, where it costs nothing to begin or to end it.

Where moves to tasks that earn nothing are free, an agent that earns nothing may change its task at every step. So one
cell of the agent and the step stands for all tasks it might idle on. There is room for everyone: the others hold as
many tasks as they are, and no fewer than the idle ones are left. Which task it is does not matter, as long as the agent
earns nothing there; it is chosen afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array, vstack

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import Programme
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import (
    RestrictedFlow,
    open_prices,
    restricted_flow,
)
from sapopt.solvers.dual_decomposition.network_plans.waiting_places import is_sparse


def idles_freely(arrays: Arrays) -> bool:
    """Whether networks of this problem have one cell for idling: it is free, and agents idle."""
    return arrays.matrix.shape[0] == 0 and arrays.idle_is_free and is_sparse(arrays)


def idle_flow(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    agents: IntArray,
    first: int,
    last: int,
    regret: float,
    limit: int = 2**62,
    until: int | None = None,
) -> RestrictedFlow:
    """`restricted_flow` of a window, in which task ``m`` stands for idling somewhere, at the step's lowest price."""
    prices = open_prices(arrays, plan, prices, agents, first, last if until is None else until)
    wide = np.column_stack([prices, prices.min(axis=1)])
    parking = np.full((len(agents), 1), arrays.tasks)
    return restricted_flow(arrays, plan, wide, agents, first, last, regret, parking, limit, until)


@dataclass(frozen=True)
class IdlePlaces:
    """Where the agents of an `idle_flow` idle: on what is left.

    Attributes
    ----------
    arrays : Arrays
    first, last : int
        The window.
    before : ndarray of int, shape (n,)
        What the agents hold before it.
    """

    arrays: Arrays
    first: int
    last: int
    before: IntArray

    @classmethod
    def of(cls, arrays: Arrays, plan: IntArray, first: int, last: int) -> IdlePlaces:
        """Those of a window of ``plan`` (T, n)."""
        return cls(arrays, first, last, arrays.initial if first == 0 else plan[first - 1])

    def added(self, programme: Programme, flow: RestrictedFlow, tail: IntArray, head: IntArray) -> Programme:
        """The programme of the agents' paths with one agent for every cell, and any number that idle.

        The columns are those of `programme`, from cell `tail` to cell `head` (hubs beyond the cells).
        """
        column = np.flatnonzero(head < len(flow.agent))
        column = column[flow.task[head[column]] < self.arrays.tasks]
        cell = flow.step[head[column]] * self.arrays.tasks + flow.task[head[column]]
        _, row, count = np.unique(cell, return_inverse=True, return_counts=True)
        rows = csc_array((np.ones(len(row)), (row, column)), shape=(len(count), len(tail))).tocsr()[count > 1]
        return replace(
            programme,
            rows=vstack([programme.rows, rows], format="csc"),
            low=np.append(programme.low, np.full(rows.shape[0], -np.inf)),
            high=np.append(programme.high, np.ones(rows.shape[0])),
        )

    def placed(self, plan: IntArray, chosen: FloatArray) -> IntArray:
        """The plan (steps of the window, n) with a task for everyone who idles: the last one, if the agent may stay.

        Else one that is left and on which it earns nothing.
        """
        m, plan, held = self.arrays.tasks, plan.copy(), self.before
        for s, row in enumerate(plan):
            idle = np.flatnonzero(row == m)
            is_free = np.ones(m, dtype=bool)
            is_free[row[row < m]] = False
            later = []
            for i in idle.tolist():
                if held[i] >= 0 and is_free[held[i]] and not self._earns(self.first + s, i, held[i]):
                    row[i] = held[i]
                    is_free[row[i]] = False
                else:
                    later.append(i)
            left = np.flatnonzero(is_free)
            for i in later:
                earns = np.isin(left, self._seen(self.first + s, i))
                at = int(np.argmin(earns))  # the first on which it earns nothing, or any
                row[i], left = left[at], np.delete(left, at)
            held = row
        return plan

    def _seen(self, k: int, i: int) -> IntArray:
        """The tasks on which an agent earns something at a step."""
        row = k * self.arrays.agents + i
        return self.arrays.indices[self.arrays.indptr[row] : self.arrays.indptr[row + 1]].astype(np.int64)

    def _earns(self, k: int, i: int, task: int) -> bool:
        return bool((self._seen(k, i) == task).any())
