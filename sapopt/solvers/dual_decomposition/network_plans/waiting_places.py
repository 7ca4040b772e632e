"""Waiting in the network of a window, wherever there is room.

Where every move costs the same, an agent that waits may do so on any task that nobody serves, and which one it is makes
no difference to it. So its own network has one further task for every step at which it may begin to wait. Its *spells*
of waiting, over the steps ``begin .. end - 1``, are given to tasks beside it: there is a column for every spell and
every task that may be waited on for so long, and as many of them are taken as there are agents with that spell. This is
exact, and takes the place of a few tasks drawn at random for every agent. Where no task is spare it decides: whoever is
to serve a task drives out an agent that waits there, and that has to go somewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array, hstack, vstack

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import Programme
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import (
    RestrictedFlow,
    open_prices,
    restricted_flow,
)

_FEW_SPARE = 0.1
"""Spare tasks for every agent above which a few of them, drawn at random, serve as well."""

PLACES_REGRET = 1.4
"""What a place may cost more than the cheapest of its spell, in typical benefits."""

_SPARSE = 0.25
"""Share of the pairs that are worth something above which nobody waits out of sight."""


def can_wait(arrays: Arrays) -> bool:
    """Whether networks of this problem may have spells of waiting: one cost for all moves, and agents that wait."""
    uniform = arrays.matrix.shape[0] == 0 and not arrays.idle_is_free
    return uniform and len(arrays.data) <= _SPARSE * arrays.steps * arrays.agents * arrays.tasks


def wait_anywhere(arrays: Arrays) -> bool:
    """Whether windows of a plan have spells of waiting: where they may, and hardly a task is spare."""
    return can_wait(arrays) and arrays.tasks - arrays.agents <= _FEW_SPARE * arrays.agents


def waiting_flow(
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
    """`restricted_flow` of a window, in which task ``m + s`` stands for waiting somewhere from step ``first + s`` on.

    That costs, at least, what the task does that is cheapest over these steps. An agent may also wait where the plan
    has it after the window. ``until`` is that of `restricted_flow`.
    """
    length, n = last - first, len(agents)
    end = last if until is None else until
    prices = open_prices(arrays, plan, prices, agents, first, end)
    wide = np.full((arrays.steps, arrays.tasks + length), np.inf)
    wide[:, : arrays.tasks] = prices
    for s in range(length):
        least = np.cumsum(prices[first + s : end], axis=0).min(axis=1)
        with np.errstate(invalid="ignore"):  # no task is open for so long: inf - inf
            wide[first + s : end, arrays.tasks + s] = np.diff(least, prepend=0.0)
    wide[np.isnan(wide)] = np.inf
    after = plan[min(last, arrays.steps - 1), agents]
    parking = np.column_stack([np.broadcast_to(arrays.tasks + np.arange(length), (n, length)), after])
    flow = restricted_flow(arrays, plan, wide, agents, first, last, regret, parking, limit, until)
    if len(flow.tail) > limit:
        return flow  # it is incomplete, and must not look as if it fitted
    spell = flow.task[flow.head] - arrays.tasks
    stays = (flow.tail >= 0) & (flow.task[flow.tail] == flow.task[flow.head])
    keep = (spell < 0) | stays | (flow.step[flow.head] - first == spell)
    return replace(flow, tail=flow.tail[keep], head=flow.head[keep], value=flow.value[keep])


@dataclass(frozen=True)
class Places:
    """Where the spells of waiting of a window may be spent.

    Attributes
    ----------
    tasks : int
        Number m of tasks.
    first, last : int
        The window.
    begin, end : ndarray of int, shape (spells,)
        Steps of every spell, counted from `first`, by ascending `begin`.
    spell, task : ndarray of int, shape (places,)
        The spells that may be spent on a task that others may use.
    spare : ndarray of int
        Tasks that nobody else uses and that cost nothing: they are all alike.
    """

    tasks: int
    first: int
    last: int
    begin: IntArray
    end: IntArray
    spell: IntArray
    task: IntArray
    spare: IntArray

    @classmethod
    def of(
        cls,
        arrays: Arrays,
        flow: RestrictedFlow,
        plan: IntArray,
        prices: FloatArray,
        agents: IntArray,
        first: int,
        last: int,
        regret: float,
    ) -> Places:
        """Those of a `waiting_flow` that cost at most `regret` more than the cheapest place of the same spell."""
        prices = open_prices(arrays, plan, prices, agents, first, last)
        total = np.concatenate([np.zeros((1, arrays.tasks)), np.cumsum(prices[first:last], axis=0)])
        contested = np.asarray((prices[first:last] > 0.0).any(axis=0))
        contested[flow.task[flow.task < arrays.tasks]] = True
        begin, end = np.triu_indices(last - first + 1, 1)
        with np.errstate(invalid="ignore"):  # a task that is closed before and within a spell: inf - inf
            paid = total[end] - total[begin]
        paid = np.where(np.isfinite(paid), paid, np.inf)
        is_near = paid <= paid.min(axis=1, keepdims=True) + regret
        spell, task = np.nonzero(is_near & contested & np.isfinite(paid))
        return cls(arrays.tasks, first, last, begin, end, spell, task, np.flatnonzero(~contested))

    def added(self, programme: Programme, flow: RestrictedFlow, tail: IntArray, head: IntArray) -> Programme:
        """The programme of the agents' paths, with the columns of the places and one agent for every cell.

        Columns: those of `programme`, from cell `tail` to cell `head` (hubs beyond the cells), then the places, then
        for every spell how many are spent on spare tasks. Rows: those of `programme`, then the capacity of every cell,
        then of the spare tasks at every step, then the balance of every spell.
        """
        length, m, cells = self.last - self.first, self.tasks, len(flow.agent)
        spells, places = len(self.begin), len(self.spell)
        count = len(tail)
        column = np.flatnonzero(head < cells)
        task, step = flow.task[head[column]], flow.step[head[column]] - self.first
        before = np.where((tail >= 0) & (tail < cells), flow.task[np.clip(tail, 0, cells - 1)], -1)[column]
        serves, kind = task < m, task - m
        spread, at = self._steps(self.spell)
        own, own_at = self._steps(np.arange(spells))
        # A spell ends where its agent's flow leaves the task that stands for it: what arrives less what stays.
        number = np.full((length, length + 1), -1)
        number[self.begin, self.end] = np.arange(spells)
        arrives = np.flatnonzero(~serves)
        stays = arrives[before[arrives] == task[arrives]]
        first_balance = length * m + length
        balance = first_balance + np.concatenate(
            [
                number[kind[arrives], step[arrives] + 1],
                number[kind[stays], step[stays]],
                self.spell,
                np.arange(spells),
            ]
        )
        row = np.concatenate(
            [step[serves] * m + task[serves], at * m + self.task[spread], length * m + own_at, balance]
        )
        columns = np.concatenate(
            [
                column[serves], count + spread, count + places + own, column[arrives], column[stays],
                count + np.arange(places), count + places + np.arange(spells),
            ]
        )  # fmt: skip
        sign = np.ones(len(row))
        sign[len(row) - spells - places - len(stays) :] = -1.0
        height, width = first_balance + spells, count + places + spells
        rows = csc_array((sign, (row, columns)), shape=(height, width))
        by_row = rows.tocsr()
        used = np.diff(by_row.indptr) > np.repeat([1, 0], [length * m, length + spells])
        high = np.concatenate(
            [np.ones(length * m), np.full(length, float(len(self.spare))), np.zeros(spells)]
        )
        low = np.concatenate([np.full(length * m + length, -np.inf), np.zeros(spells)])
        none = csc_array((programme.rows.shape[0], places + spells))
        return Programme(
            np.append(programme.gain, np.zeros(places + spells)),
            vstack([hstack([programme.rows, none]), by_row[used]], format="csc"),
            np.append(programme.low, low[used]),
            np.append(programme.high, high[used]),
            np.concatenate([programme.upper, np.ones(places), np.full(spells, float(len(self.spare)))]),
            np.ones(width, dtype=bool),
        )

    def placed(self, plan: IntArray, chosen: FloatArray) -> IntArray:
        """The plan (steps of the window, n) with real tasks in the place of those that stand for waiting.

        ``chosen`` are the values of the columns that `added` has added.
        """
        plan, length = plan.copy(), self.last - self.first
        is_taken = chosen[: len(self.spell)] > 0.5
        spare_until = np.zeros(len(self.spare), np.int64)  # step up to which each is taken
        waits = plan - self.tasks
        for number, (begin, end) in enumerate(zip(self.begin, self.end, strict=True)):
            is_spell = (waits[begin:end] == begin).all(axis=0)
            if end < length:
                is_spell &= waits[end] != begin
            agents = np.flatnonzero(is_spell)
            tasks = self.task[is_taken & (self.spell == number)]
            free = np.flatnonzero(spare_until <= begin)[: len(agents) - len(tasks)]
            spare_until[free] = end
            plan[begin:end, agents] = np.append(tasks, self.spare[free])
        return plan

    def _steps(self, spell: IntArray) -> tuple[IntArray, IntArray]:
        """For some spells their positions, each as often as it has steps, and these steps, counted from `first`."""
        length = self.end[spell] - self.begin[spell]
        position = np.repeat(np.arange(len(spell)), length)
        ends = np.cumsum(length)
        step = np.arange(len(position)) - np.repeat(ends - length, length) + self.begin[spell][position]
        return position, step
