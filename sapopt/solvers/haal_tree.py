"""HAAL's compiled search for sparse benefits and one switching cost: what it keeps from step to step."""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt.data.types import IntArray
from sapopt.data.windows import WindowSums
from sapopt.kernels import clock
from sapopt.running.outlook import Outlook

_MOST_BYTES = 512 * 2**20  # for states
_SLICE = 64
"""Intervals solved before the first look at the clock: as many as a lookahead of 6 may need."""
_SLICE_SECONDS = 0.1
"""While looks at the clock are closer together than this, twice as many intervals are solved until the next."""


class CompiledTree:
    """Window sums, states and solved intervals, as `sapopt.kernels.tree` wants them.

    Parameters
    ----------
    sums : WindowSums
        Source of the benefits.
    lookahead : int
        Most steps of a search.
    cost : float
    idle_is_free : bool
        As in `sapopt.dynamics.SwitchingCost`.
    """

    def __init__(self, sums: WindowSums, lookahead: int, cost: float, idle_is_free: bool) -> None:
        from sapopt.kernels.tree import Nodes, Prices

        self.sums = sums
        self.lookahead = lookahead
        self.cost = cost
        self.idle_is_free = idle_is_free
        # All trees that reach a step together have fewer than 2^L nodes there.
        shape = (lookahead + 1, 2**lookahead)
        self._nodes = Nodes(
            np.zeros(shape[0], np.int64), np.empty((*shape, sums.n), np.int32), np.empty(shape, np.int64),
            np.empty((*shape, lookahead), np.int32), np.empty((*shape, lookahead)),
        )  # fmt: skip
        slots = lookahead**2
        self._prices = Prices(
            np.zeros(slots, np.bool_),
            np.empty((slots, sums.m)),
            np.empty((slots, sums.n)),
            np.empty(slots),
            np.empty(slots),
        )
        self._plain: Any = None
        self._charged: Any = None
        self._step = self._end = -1  # the windows between these steps are there

    @classmethod
    def of(cls, outlook: Outlook, lookahead: int) -> CompiledTree | None:
        """The tree for a problem, None if it is not of this kind or too large."""
        rule, sums = outlook.model.switching(), outlook.windows
        if rule is None or rule.uniform_cost is None or not sums.is_sparse:
            return None
        lookahead = min(lookahead, sums.end - sums.first)  # an earlier step may be asked for later on
        if (lookahead + 1) * 2**lookahead * sums.n * 4 > _MOST_BYTES:
            return None
        return cls(sums, lookahead, rule.uniform_cost, rule.idle_is_free)

    def best(self, outlook: Outlook, order: IntArray) -> tuple[IntArray | None, int]:
        """First assignment of the best sequence and the number of intervals solved for it.

        The assignment is None if the kernel cannot tell, see `sapopt.kernels.tree.search`.
        """
        from sapopt.kernels.tree import FOUND, UNFINISHED, search

        k = outlook.k
        stop = min(k + self.lookahead, outlook.end)
        self._advance(k, stop)
        root = np.full(self.sums.n, -1) if outlook.state is None else outlook.state
        solved, budget = 0, _SLICE
        while True:
            began = clock.now()
            outcome, first, count = search(
                self._nodes, self._plain, self._charged, self._prices, root, k, stop, self.cost, self.idle_is_free,
                order, budget,
            )  # fmt: skip
            solved += count
            if outcome != UNFINISHED:
                return (first if outcome == FOUND else None), solved
            outlook.check()
            if clock.now() - began < _SLICE_SECONDS:
                budget *= 2

    def forget_nodes(self) -> None:
        """Drop all that was solved."""
        self._nodes.size[:] = 0

    def _advance(self, k: int, stop: int) -> None:
        """Drop the nodes of steps before k, make the windows up to `stop`."""
        if not self._step <= k <= self._end:
            self.forget_nodes()
            self._end = k
        elif k == self._step:  # asked once more, perhaps in another state: there is room for one tree a step
            self.forget_nodes()
        else:
            for step in range(self._step, k):
                self._nodes.size[step % len(self._nodes.size)] = 0
        self._step = k
        for last in range(self._end, stop):
            self._add(k, last)
        self._end = max(self._end, stop)

    def _add(self, k: int, last: int) -> None:
        from sapopt.kernels.tree import add_step

        rows = self.sums.slice(last, last + 1).flat()
        first = max(k, last - self.lookahead + 1)
        slots = [(a % self.lookahead) * self.lookahead + last - 1 - a for a in range(first, last)]
        held = self._plain.row_start[slots, -1].max() if slots else 0
        if self._plain is None or held + len(rows.data) > self._plain.tasks.shape[1]:
            self._grow(2 * (held + len(rows.data)) + 1)
        step = (rows.indptr, rows.indices, rows.data, self.sums.m, first, last)
        add_step(self._plain, self._prices, *step, 0.0)
        if self.idle_is_free:
            add_step(self._charged, self._prices, *step, self.cost)

    def _grow(self, capacity: int) -> None:
        self._plain = self._grown(self._plain, capacity)
        self._charged = self._grown(self._charged, capacity) if self.idle_is_free else self._plain

    def _grown(self, old: Any, capacity: int) -> Any:
        from sapopt.kernels.tree import Windows

        slots = self.lookahead**2
        tasks = np.empty((slots, capacity), np.int32)
        gains = np.empty((slots, capacity))
        if old is None:
            return Windows(
                np.empty((slots, self.sums.n + 1), np.int64), tasks, gains, np.zeros(slots, np.bool_)
            )
        tasks[:, : old.tasks.shape[1]] = old.tasks
        gains[:, : old.gains.shape[1]] = old.gains
        return Windows(old.row_start, tasks, gains, old.negative)
