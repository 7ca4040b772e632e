"""What capacities and limits allow at a step, for policies: they never break a limit that can be kept step by step.

A limit that the empty plan would keep is kept at every step: the sum so far is never beyond its bound. One that needs
something done is kept if it is about a single step, such as a cover; what needs something done over several steps is
for planners, unless it has a penalty, which is then paid.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.matrices import GainMatrix, Matrix
from sapopt.data.transport import LARGE, beside_rest, rests_beside, short_of_room, transported
from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.rows import Weights
from sapopt.problem.sap import SAP


class Ledger:
    """The sums of all limits so far, along a plan that is made step by step.

    Parameters
    ----------
    problem : SAP
        A core (`SAP.core`).
    strict : bool
        Whether to refuse what cannot be promised.

    Raises
    ------
    ValueError
        If a hard limit needs something done over several steps.
    """

    def __init__(self, problem: SAP, strict: bool = True) -> None:
        self.problem = problem
        rows = problem.rows
        self.used = np.zeros(rows.count)
        self.previous = problem.initial_assignment
        T, n, m = problem.T, problem.n, problem.m
        # entries of pairs, take-ups and stays by step
        self._spans = [
            np.searchsorted(weights.cell[order], np.arange(T + 1) * n * m)
            for weights, order in self._ordered()
        ]
        self._entries = [
            (weights.cell[order] % (n * m), weights.row[order], weights.weight[order])
            for weights, order in self._ordered()
        ]
        first, last = np.full(rows.count, T), np.full(rows.count, -1)
        for weights in (rows.pair, rows.taken, rows.stayed):
            np.minimum.at(first, weights.row, weights.cell // (n * m))
            np.maximum.at(last, weights.row, weights.cell // (n * m))
        first[rows.taken_by.row], last[rows.taken_by.row] = 0, T - 1
        self.step_of = np.where(first == last, first, -1)
        needs = (rows.low > 0) | (rows.high < 0)
        late = np.flatnonzero(needs & np.isinf(rows.penalty) & (self.step_of < 0))
        if strict and len(late):
            raise ValueError(
                f"limits: {rows.names[late[0]]!r} needs something done over several steps, which nobody can promise "
                "who decides step by step; use DualDecomposition or Exact, or give the limit a penalty"
            )

    def _ordered(self) -> list[tuple[Weights, IntArray]]:
        rows = self.problem.rows
        return [(w, np.argsort(w.cell, kind="stable")) for w in (rows.pair, rows.taken, rows.stayed)]

    def after(self, k: int, tasks: IntArray) -> Ledger:
        """The ledger if these tasks are held at step k; this one stays as it is."""
        further = copy.copy(self)
        further.used = self.used.copy()
        further.enter(k, tasks)
        return further

    def rules(self, k: int) -> StepRules:
        """What is allowed at step k."""
        return StepRules(self, k, self.weights(k))

    def weights(self, k: int) -> sp.csr_array:
        """What every pair adds to every row at step k, shape (rows, n * m), after the assignment before."""
        rows, n, m = self.problem.rows, self.problem.n, self.problem.m
        if not rows.count:
            return sp.csr_array((0, n * m))
        held = np.full(n, -2) if self.previous is None else self.previous
        row, pair, weight = [], [], []
        for kind, (spans, (cells, at, value)) in enumerate(zip(self._spans, self._entries, strict=True)):
            own = slice(spans[k], spans[k + 1])
            stays = cells[own] % m == held[cells[own] // m]
            keep = slice(None) if kind == 0 else ~stays if kind == 1 else stays
            row.append(at[own][keep])
            pair.append(cells[own][keep])
            weight.append(value[own][keep])
        by = rows.taken_by
        if len(by.row) and (k > 0 or rows.first_counts):
            tasks = np.arange(m)
            for agent, of_row, value in zip(by.agent, by.row, by.weight, strict=True):
                taken = tasks[(tasks != held[agent]) & (tasks != rows.idle)]
                row.append(np.full(len(taken), of_row))
                pair.append(agent * m + taken)
                weight.append(np.full(len(taken), value))
        return sp.csr_array(
            (np.concatenate(weight), (np.concatenate(row), np.concatenate(pair))), shape=(rows.count, n * m)
        )

    def enter(self, k: int, tasks: IntArray) -> None:
        """Count the assignment of step k."""
        if self.problem.rows.count:
            weights = self.weights(k)
            self.used += np.asarray(
                weights[:, np.arange(len(tasks)) * self.problem.m + tasks].sum(axis=1)
            ).ravel()
        self.previous = tasks


@dataclass(frozen=True, eq=False)
class StepRules:
    """Capacities and limits at one step.

    Attributes
    ----------
    ledger : Ledger
    k : int
    weights : sparse matrix, shape (rows, n * m)
        What every pair adds to every row.
    """

    ledger: Ledger
    k: int
    weights: sp.csr_array

    def assign(self, matrix: Matrix, start: int, stop: int, *, priced: bool = False) -> IntArray:
        """The best assignment for the steps ``start .. stop - 1``, within the limits if it begins at this very step.

        With `priced` the matrix already contains what soft limits cost, so only hard ones are looked at: then a
        programme is seldom needed.

        Raises
        ------
        InfeasibleError
            If there is none.
        """
        problem = self.ledger.problem
        room = self.room(start, stop)
        is_free = self._is_free(start)
        if isinstance(matrix, GainMatrix):
            if is_free and rests_beside(room, problem.rows.idle) and problem.n * problem.m >= LARGE:
                return beside_rest(matrix, problem.rows.idle)
            matrix = matrix.toarray()
        if is_free:
            return self._resting(matrix, transported(matrix, room))
        tried = self.opened(matrix, start)
        try:
            tasks = self.accepted(tried, transported(tried, room), start, priced=priced)
            if tasks is not None:
                return tasks
        except InfeasibleError:
            pass  # the programme says which limit is in the way
        return self._programme(matrix, room)

    def room(self, start: int, stop: int) -> IntArray:
        """How many agents every task takes all through the steps ``start .. stop - 1``, shape (m,); at most n."""
        problem = self.ledger.problem
        assert problem.capacity is not None
        return np.minimum(problem.capacity[start:stop].min(axis=0), problem.n)

    def opened(self, matrix: FloatArray, start: int) -> FloatArray:
        """A matrix for steps from `start` on, with -inf for pairs that alone would break a hard limit at this step."""
        return matrix if self._is_free(start) else np.where(self._closed, -np.inf, matrix)

    def accepted(
        self, matrix: FloatArray, tasks: IntArray, start: int, *, priced: bool = False
    ) -> IntArray | None:
        """An assignment within the capacities, with nobody on a task in vain; None if another may keep limits better.

        `matrix` is what was assigned by; `priced` as for `assign`.
        """
        tasks = self._resting(matrix, tasks)
        if self._is_free(start):
            return tasks
        beyond = self._beyond(tasks) > 0
        broken = beyond & np.isinf(self.ledger.problem.rows.penalty) if priced else beyond
        return None if broken.any() else tasks

    def _is_free(self, start: int) -> bool:
        """Whether no limit counts for an assignment that begins at a step."""
        return start != self.k or not len(self._active)

    def allows(self, tasks: IntArray) -> bool:
        """Whether an assignment of this very step breaks no hard limit."""
        if not self.ledger.problem.rows.count:
            return True
        return not (self._beyond(tasks)[np.isinf(self.ledger.problem.rows.penalty)] > 0).any()

    @property
    def _sides(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest sum that this step may add to every row; infinite where it does not matter."""
        rows, ledger = self.ledger.problem.rows, self.ledger
        now, soft = ledger.step_of == self.k, np.isfinite(rows.penalty)
        low, high = rows.low - ledger.used, rows.high - ledger.used
        # A sum that is beyond a soft bound already is paid for; what comes on top counts.
        running_low = np.where(soft, np.minimum(low, 0.0), low)
        running_high = np.where(soft, np.maximum(high, 0.0), high)
        return (
            np.where(rows.low <= 0, running_low, np.where(now, low, -np.inf)),
            np.where(rows.high >= 0, running_high, np.where(now, high, np.inf)),
        )

    @property
    def _active(self) -> IntArray:
        """Rows that this step can change."""
        return np.flatnonzero(np.diff(self.weights.indptr) > 0)

    @property
    def _closed(self) -> np.ndarray:
        """Pairs (n, m) that alone would break a hard limit whose weights at this step are all of one sign."""
        problem = self.ledger.problem
        low, high = self._sides
        part = sp.coo_array(self.weights)
        row, pair, weight = part.row, part.col, part.data
        least, most = np.zeros(problem.rows.count), np.zeros(problem.rows.count)
        np.minimum.at(least, row, weight)
        np.maximum.at(most, row, weight)
        over = (least[row] >= 0) & (weight > high[row]) | (most[row] <= 0) & (weight < low[row])
        closed = np.zeros(problem.n * problem.m, dtype=bool)
        closed[pair[over & np.isinf(problem.rows.penalty)[row]]] = True
        return closed.reshape(problem.n, problem.m)

    def _beyond(self, tasks: IntArray) -> FloatArray:
        """By how much an assignment would break every row."""
        low, high = self._sides
        use = np.asarray(
            self.weights[:, np.arange(len(tasks)) * self.ledger.problem.m + tasks].sum(axis=1)
        ).ravel()
        return np.maximum(np.maximum(use - high, low - use), 0.0)

    def _resting(self, matrix: FloatArray, tasks: IntArray) -> IntArray:
        """Agents that gain nothing over holding nothing hold nothing, where that is possible."""
        idle = self.ledger.problem.rows.idle
        if idle < 0:
            return tasks
        agents = np.arange(len(tasks))
        return np.where(matrix[agents, tasks] <= matrix[agents, idle], idle, tasks)

    def _programme(self, matrix: FloatArray, room: IntArray) -> IntArray:
        """An integer programme with the limits as rows; what cannot be kept costs more than all else."""
        from scipy.optimize import Bounds, LinearConstraint, milp

        rows, (n, m) = self.ledger.problem.rows, matrix.shape
        pairs = np.flatnonzero(np.isfinite(matrix))
        gain = matrix.ravel()[pairs]
        # In the size of the gains, for HiGHS has absolute tolerances.
        unit = float(np.abs(gain).max(initial=0.0)) or 1.0
        active = self._active
        count, r = len(pairs), len(active)
        penalty = rows.penalty[active] / unit
        dear = 10.0 * max(float(n), penalty[np.isfinite(penalty)].max(initial=0.0)) + 1.0
        cost = np.where(np.isfinite(penalty), penalty, dear)
        column = np.arange(count)
        one = sp.csr_array((np.ones(count), (pairs // m, column)), shape=(n, count + r))
        held = sp.csr_array((np.ones(count), (pairs % m, column)), shape=(m, count + r))
        low, high = self._sides
        own = sp.csr_array(self.weights[active][:, pairs])
        slack = sp.eye_array(r, format="csr")
        found = milp(
            np.concatenate([-gain / unit, cost]),
            integrality=np.concatenate([np.ones(count), np.zeros(r)]),
            bounds=Bounds(0.0, np.concatenate([np.ones(count), np.full(r, np.inf)])),
            constraints=[
                LinearConstraint(one, 1.0, 1.0),
                LinearConstraint(held, -np.inf, room.astype(np.float64)),
                LinearConstraint(sp.hstack([own, -slack], format="csr"), -np.inf, high[active]),
                LinearConstraint(sp.hstack([own, slack], format="csr"), low[active], np.inf),
            ],
        )
        if found.x is None:
            raise InfeasibleError(short_of_room(matrix, room))
        chosen = pairs[found.x[:count] > 0.5]
        tasks = np.empty(n, dtype=np.int64)
        tasks[chosen // m] = chosen % m
        broken = np.flatnonzero((self._beyond(tasks) > 1e-9) & np.isinf(rows.penalty))
        if len(broken):
            raise InfeasibleError(
                f"limit {rows.names[broken[0]]!r} cannot be kept any more by any assignment; a planner such as "
                "DualDecomposition looks ahead"
            )
        return tasks
