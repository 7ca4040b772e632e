"""Problems whose limits are next to nothing: a plain problem, with at most so many take-ups for an agent.

A penalty that is paid for every unit that a sum misses is a benefit of what the sum counts, as long as the sum can
never get beyond its bound. Where a task takes one agent, "served at this step, or one is paid" says the same as a
benefit that is greater by one, and one that is paid anyhow. Limits that no plan could break say nothing. What may be
left are hard limits on the take-ups of single agents. A multiplier of one of them raises what the agent pays for a
move, under the rule by which every change of task costs the same.

So neither needs a graph of all that agents can do, and the compiled paths of the plain problem serve both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.problem.rows import Rows
from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class Folded:
    """A plain problem that stands for one with limits.

    Attributes
    ----------
    given : SAP
        The core (`SAP.core`) of the problem with limits.
    problem : SAP
        A plan is worth as much here, less `paid`, if it keeps `most`.
    paid : float
        What the penalties come to where nothing is served.
    multipliers : ndarray, shape (rows,)
        Of the rows that have become benefits; zero for the others.
    most : ndarray of int64, shape (n,)
        Take-ups that an agent may have; T where there is no limit.
    row : ndarray of int64, shape (n,)
        The row that says so, -1 where there is none.
    """

    given: SAP
    problem: SAP
    paid: float
    multipliers: FloatArray
    most: IntArray
    row: IntArray

    @property
    def is_plain(self) -> bool:
        """Whether no take-ups are limited."""
        return bool((self.row < 0).all())

    def take_ups(self, plan: IntArray) -> IntArray:
        """Take-ups (n,) of every agent in a plan (T, n)."""
        initial = self.problem.initial_assignment
        before = plan[:1] if initial is None else initial[None]
        taken: IntArray = (plan != np.vstack([before, plan[:-1]])).sum(axis=0)
        return taken


def folded(problem: SAP) -> Folded | None:
    """The plain problem behind a core (`SAP.core`), None if there is none."""
    rule, rows = problem.model.switching(), problem.rows
    single = problem.capacity is None or bool((problem.capacity == 1).all())
    if rule is None or rule.uniform_cost is None or rule.idle_is_free or rows.idle >= 0 or not single:
        return None
    if len(rows.team_cell) or len(rows.taken.cell) or len(rows.stayed.cell):
        return None
    least, greatest = _reach(rows)
    idle = (least >= rows.low) & (greatest <= rows.high)
    lacks = np.isfinite(rows.penalty) & (greatest <= rows.low) & ~idle
    exceeds = np.isfinite(rows.penalty) & (least >= rows.high) & ~idle
    of_pairs = (
        np.bincount(rows.taken_by.row, minlength=rows.count) == 0
    )  # what moves cost, no benefit can say
    lacks, exceeds = lacks & of_pairs, exceeds & of_pairs
    alone = _of_an_agent(rows)
    if not (idle | lacks | exceeds | alone).all():
        return None
    most, row = _take_ups(rows, alone & ~idle)
    multipliers = np.where(lacks, -rows.penalty, np.where(exceeds, rows.penalty, 0.0))
    bounds = np.where(lacks, rows.low, np.where(exceeds, rows.high, 0.0))
    plain = SAP(
        _repriced(problem, multipliers), SwitchingCost(rule.uniform_cost), problem.initial_assignment,
        agents=problem.agents, tasks=problem.tasks,
    )  # fmt: skip
    return Folded(problem, plain, -float(multipliers @ bounds), multipliers, most, row)


def _reach(rows: Rows) -> tuple[FloatArray, FloatArray]:
    """No more and no less than every row's sum (rows,), where a task takes one agent and an agent one task."""
    T, n, m = rows.shape
    pair, task = np.divmod(rows.pair.cell, m)
    step = pair // n
    moves = T if rows.first_counts else T - 1
    by = rows.taken_by
    ends: list[FloatArray] = []
    for sign in (-1.0, 1.0):
        weight = np.maximum(sign * rows.pair.weight, 0.0)
        sums = [_sum_of_greatest(rows, place, weight) for place in (step * m + task, pair)]
        taken = np.bincount(by.row, weights=np.maximum(sign * by.weight, 0.0), minlength=rows.count) * moves
        ends.append(np.asarray(sign * (np.minimum(*sums) + taken), dtype=np.float64))
    return ends[0], ends[1]


def _sum_of_greatest(rows: Rows, place: IntArray, weight: FloatArray) -> FloatArray:
    """For every row, the greatest weight at every place, added up over the places."""
    span = int(place.max(initial=0)) + 1
    places, at = np.unique(rows.pair.row * span + place, return_inverse=True)
    greatest = np.zeros(len(places))
    np.maximum.at(greatest, at, weight)
    total: FloatArray = np.bincount(places // span, weights=greatest, minlength=rows.count).astype(np.float64)
    return total


def _of_an_agent(rows: Rows) -> np.ndarray:
    """Mask (rows,) of the hard limits on nothing but the number of take-ups of one agent."""
    by, count = rows.taken_by, rows.count
    ones = np.bincount(by.row[by.weight == 1.0], minlength=count)
    all_of_them = np.bincount(by.row, minlength=count)
    pairs = np.bincount(rows.pair.row, minlength=count)
    alone: np.ndarray = (all_of_them == 1) & (ones == 1) & (pairs == 0)
    return alone & np.isinf(rows.penalty) & (rows.low <= 0)


def _take_ups(rows: Rows, alone: np.ndarray) -> tuple[IntArray, IntArray]:
    """The strictest of the limits of a mask (rows,) for every agent, and its row."""
    T, n, _ = rows.shape
    most, row = np.full(n, T), np.full(n, -1)
    for agent, r in zip(rows.taken_by.agent.tolist(), rows.taken_by.row.tolist(), strict=True):
        if alone[r] and np.floor(rows.high[r]) < most[agent]:
            most[agent], row[agent] = int(np.floor(rows.high[r])), r
    return most, row


def _repriced(problem: SAP, multipliers: FloatArray) -> Benefits:
    """The benefits less the multipliers of what pairs add to the rows."""
    T, n, m = problem.T, problem.n, problem.m
    flat, rows = problem.benefits.flat(), problem.rows
    own = sp.csr_array((flat.data, flat.indices, flat.indptr), shape=(T * n, m))
    pair, task = np.divmod(rows.pair.cell, m)
    more = -multipliers[rows.pair.row] * rows.pair.weight
    keep = more != 0
    total = sp.csr_array(own + sp.csr_array((more[keep], (pair[keep], task[keep])), shape=(T * n, m)))
    total.sort_indices()
    return Benefits.from_flat(total.indptr, total.indices, total.data, (T, n, m))
