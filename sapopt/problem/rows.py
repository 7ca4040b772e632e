"""The limits of a problem as rows: one sum with its bounds each, in sparse form.

A row weighs three things: the pairs of a plan; the *take-ups*, where an agent holds a pair and did not hold its task
the step before; and the *stays*, where it did. Weights of take-ups may also stand for all tasks of an agent at once.
Pairs are numbered ``cell = (k * n + i) * places + j``, with the tasks, and as the last place idleness where there is
some.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sapopt.data.naming import Naming
from sapopt.data.types import FloatArray, IntArray


class Weights(NamedTuple):
    """Weights of rows for cells, all shape (entries,)."""

    cell: IntArray
    row: IntArray
    weight: FloatArray


class AgentWeights(NamedTuple):
    """Weights of rows for every take-up of an agent, all shape (entries,)."""

    agent: IntArray
    row: IntArray
    weight: FloatArray


@dataclass(frozen=True)
class LimitUse:
    """How much of one limit a plan uses.

    Attributes
    ----------
    name : str
    use : float
        The weighted sum.
    at_most, at_least : float
        Infinite where there is none.
    cost : float
        Penalty paid for going beyond.
    """

    name: str
    use: float
    at_most: float
    at_least: float
    cost: float = 0.0

    @property
    def slack(self) -> float:
        """What is left to the nearer bound; negative beyond it."""
        return min(self.at_most - self.use, self.use - self.at_least)


@dataclass(frozen=True, eq=False)
class Rows:
    """All rows of a problem.

    Attributes
    ----------
    shape : (T, n, places)
    idle : int
        The place that stands for holding nothing; -1 if agents always hold something.
    names : tuple of str
    low, high : ndarray, shape (rows,)
        With the slack of sums that are not whole; infinite where there is no bound.
    told_low, told_high : ndarray, shape (rows,)
        As the user gave them.
    penalty : ndarray, shape (rows,)
        Cost of each unit beyond, infinite for a hard limit.
    pair, taken, stayed : Weights
        For holding a cell, for taking it up, and for staying on it.
    taken_by : AgentWeights
    first_counts : bool
        Whether the first step can take up a task: there is an initial assignment.
    team_cell : ndarray of int64, shape (teams,)
        ``k * places + j`` of every step at which a team may earn.
    team_needs, team_reward : ndarray, shape (teams,)
    """

    shape: tuple[int, int, int]
    idle: int
    names: tuple[str, ...]
    low: FloatArray
    high: FloatArray
    told_low: FloatArray
    told_high: FloatArray
    penalty: FloatArray
    pair: Weights
    taken: Weights
    stayed: Weights
    taken_by: AgentWeights
    first_counts: bool
    team_cell: IntArray
    team_needs: IntArray
    team_reward: FloatArray

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.names)

    @property
    def remembers(self) -> bool:
        """Whether a row looks at the task held before."""
        return bool(len(self.taken.row) or len(self.stayed.row) or len(self.taken_by.row))

    def terms(self, plan: IntArray, initial: IntArray | None) -> list[tuple[IntArray, FloatArray, IntArray]]:
        """What a plan (T, n) of places adds to the rows: groups of (row, weight, cell)."""
        T, n, places = self.shape
        before = np.vstack([np.full((1, n), -2) if initial is None else initial[None], plan[:-1]])
        first = np.arange(T)[:, None] * n + np.arange(n)
        cells = (first * places + plan).ravel()
        is_new = (plan != before).ravel()
        out = []
        for weights, mask in ((self.pair, None), (self.taken, is_new), (self.stayed, ~is_new)):
            if len(weights.cell):
                step, task = np.divmod(weights.cell, places)
                held = plan.ravel()[step] == task
                if mask is not None:
                    held &= mask[step]
                out.append((weights.row[held], weights.weight[held], weights.cell[held]))
        if len(self.taken_by.row):
            counts = is_new & (plan != self.idle).ravel()
            if not self.first_counts:
                counts[:n] = False
            place = np.flatnonzero(counts)
            who = place % n
            for agent in np.unique(self.taken_by.agent):
                mine = place[who == agent]
                for entry in np.flatnonzero(self.taken_by.agent == agent):
                    full = np.full(len(mine), self.taken_by.row[entry])
                    weight = np.full(len(mine), self.taken_by.weight[entry])
                    out.append((full, weight, cells[mine]))
        return out

    def use(self, plan: IntArray, initial: IntArray | None) -> FloatArray:
        """The sum of every row, each rounded once."""
        groups = self.terms(plan, initial)
        if not groups:
            return np.zeros(self.count)
        row, weight = np.concatenate([g[0] for g in groups]), np.concatenate([g[1] for g in groups])
        if (weight == np.rint(weight)).all():
            return np.bincount(row, weights=weight, minlength=self.count).astype(np.float64)
        order = np.argsort(row, kind="stable")
        spans = np.searchsorted(row[order], np.arange(self.count + 1))
        ordered = weight[order].tolist()
        return np.array([math.fsum(ordered[a:b]) for a, b in pairwise(spans.tolist())])

    def violation(self, use: FloatArray) -> FloatArray:
        """By how much every row is beyond its bounds, 0 where it is not."""
        over = np.where(np.isfinite(self.high), use - self.high, 0.0)
        under = np.where(np.isfinite(self.low), self.low - use, 0.0)
        return np.maximum(np.maximum(over, under), 0.0)

    def cost(self, use: FloatArray) -> FloatArray:
        """Penalty of every row; infinite where a hard limit is broken."""
        beyond = self.violation(use)
        return np.where(beyond > 0, beyond * np.where(beyond > 0, self.penalty, 1.0), 0.0)

    def uses(self, use: FloatArray) -> tuple[LimitUse, ...]:
        """The rows as a reader wants to see them."""
        cost = self.cost(use)
        return tuple(
            LimitUse(
                self.names[r],
                float(use[r]),
                float(self.told_high[r]),
                float(self.told_low[r]),
                float(cost[r]),
            )
            for r in range(self.count)
        )

    def earned(self, plan: IntArray) -> FloatArray:
        """Reward (teams,) of every team and step under a plan of places."""
        if not len(self.team_cell):
            return np.zeros(0)
        T, _, places = self.shape
        flat = (np.arange(T)[:, None] * places + plan).ravel()
        held = np.bincount(flat, minlength=T * places)
        return np.where(held[self.team_cell] >= self.team_needs, self.team_reward, 0.0)

    def broken(self, plan: IntArray, initial: IntArray | None, use: FloatArray, naming: Naming) -> str:
        """Which hard limit a plan breaks, with steps and agents; empty if none."""
        bad = np.flatnonzero((self.violation(use) > 0) & np.isinf(self.penalty))
        if not len(bad):
            return ""
        r, (_, n, places) = int(bad[0]), self.shape
        over = use[r] > self.high[r]
        said = f"above at_most={self.told_high[r]:g}" if over else f"below at_least={self.told_low[r]:g}"
        where = np.unique(
            np.concatenate([cell[row == r] for row, _, cell in self.terms(plan, initial)] or [[]])
        )
        pairs = [divmod(int(cell) // places, n) for cell in where]
        shown = ", ".join(f"{naming.agent(i)} at {naming.step(k)}" for k, i in pairs[:6]) + (
            ", ..." if len(pairs) > 6 else ""
        )
        return (
            f"limit {self.names[r]!r}: its sum is {use[r]:g}, {said} ({shown or 'nothing counts towards it'})"
        )


def no_rows(shape: tuple[int, int, int], idle: int) -> Rows:
    """The rows of a problem without limits."""
    whole, real = np.zeros(0, dtype=np.int64), np.zeros(0)
    none = Weights(whole, whole, real)
    return Rows(
        shape, idle, (), real, real, real, real, real, none, none, none, AgentWeights(whole, whole, real), False,
        whole, whole, real,
    )  # fmt: skip
