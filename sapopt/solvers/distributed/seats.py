"""Auctions where tasks take several agents, agents may hold nothing, and limits are to be kept.

An auction gives one thing to one bidder. So each place that a task has is a *seat*, worth to an agent what the task is
worth, and idleness is a seat of the agent's own, for which nobody else can bid.

All agents know all limits, and at every step they tell each other what they hold, so each knows what is left of every
limit. A pair that alone would go beyond is closed before the auctions. What several agents use of a limit together, at
one step, no bidder can know. So where the outcome of an auction breaks a limit, or the auction did not end in time, the
agents tell each other what every pair is worth to them, which takes a diameter of rounds, and each of them solves the
same assignment problem with the limits in it, the one that HAA solves in one place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.matrices import GainMatrix, Matrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.running.outlook import Outlook
from sapopt.running.steps import StepRules
from sapopt.solvers.distributed.auction import infeasible, run_auctions
from sapopt.solvers.distributed.common import Scene
from sapopt.solvers.distributed.simulator import ENTRY_BYTES

Interval = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Seats:
    """The seats of a window.

    Attributes
    ----------
    rules : StepRules
        Of the step at which it begins.
    task : ndarray of int64, shape (seats,)
        Task of every seat.
    number : ndarray of int64, shape (seats,)
        Which of the seats of its task it is; on idleness, the agent whose seat it is.
    """

    rules: StepRules
    task: IntArray
    number: IntArray

    def matrix(self, values: FloatArray, start: int, stop: int) -> FloatArray:
        """What every seat is worth, shape (n, seats), with -inf for a seat that is not there or another agent's.

        `values` (n, m) are of the steps ``start .. stop - 1``; pairs that break a limit alone are closed.
        """
        room, idle = self.rules.room(start, stop), self.rules.ledger.problem.rows.idle
        wide = self.rules.opened(values, start)[:, self.task]
        private = self.task == idle
        wide[:, ~private & (self.number >= room[self.task])] = -np.inf
        agents = np.arange(len(wide))[:, None]
        return np.where(private & (self.number != agents), -np.inf, wide)


def seats_of(outlook: Outlook, stop: int, private: bool = True) -> Seats:
    """The seats that the tasks have at some of the steps up to ``stop - 1``, ascending by task.

    Without the private seats of idleness, every task has one at least, for an agent that held it before.
    """
    rules = outlook.rules
    assert rules is not None
    most = np.max([rules.room(k, k + 1) for k in range(outlook.k, stop)], axis=0)
    if not private:
        most = np.maximum(most, 1)
        if outlook.problem.rows.idle >= 0:
            most[outlook.problem.rows.idle] = 1
    task = np.repeat(np.arange(len(most)), most)
    return Seats(rules, task, np.arange(len(task)) - np.repeat(np.cumsum(most) - most, most))


def auctioned(
    outlook: Outlook, matrices: Mapping[Interval, Matrix], scene: Scene, epsilon: float, max_rounds: int
) -> dict[Interval, IntArray]:
    """Assignments of intervals by auctions, within the capacities; those of the current step within the limits.

    Raises
    ------
    InfeasibleError
        If the current step alone has none. Other intervals without one are left out.
    """
    now = (outlook.k, outlook.k + 1)
    seats = seats_of(outlook, max(stop for _, stop in matrices))
    values = {interval: _dense(matrix) for interval, matrix in matrices.items()}
    wide = {interval: seats.matrix(values[interval], *interval) for interval in matrices}
    everywhere = replace(scene, open_tasks=np.ones((1, len(seats.task)), dtype=bool))
    held = [interval for interval in wide if not infeasible(wide[interval], everywhere)]
    solved: dict[Interval, IntArray] = {}
    if held:
        done = run_auctions([wide[interval] for interval in held], everywhere, epsilon, max_rounds)
        for interval, places in zip(held, done.tasks, strict=True):
            if (places >= 0).all():
                opened = seats.rules.opened(values[interval], interval[0])
                tasks = seats.rules.accepted(opened, seats.task[places], interval[0])
                if tasks is not None:
                    solved[interval] = tasks
    for interval in set(matrices) - set(solved):
        try:
            scene.simulator.flood(ENTRY_BYTES * np.isfinite(values[interval]).sum(axis=1))
            solved[interval] = outlook.alpha(values[interval], *interval)
        except InfeasibleError:
            if interval == now:
                raise
    return solved


def seated_offers(outlook: Outlook, window: Benefits, seats: Seats) -> Benefits:
    """The benefits of a window's seats (steps, n, seats); closed ones are worth nothing."""
    steps = []
    for t in range(window.shape[0]):
        k = outlook.k + t
        wide = seats.matrix(dense_step(window.step(t)), k, k + 1)
        steps.append(sp.csr_array(np.maximum(wide, 0.0)))
    return Benefits(steps)


def seated_cost(cost: float | FloatArray, seats: Seats) -> FloatArray:
    """What going from seat to seat costs (seats, seats): nothing within a task."""
    if isinstance(cost, np.ndarray):
        return np.asarray(cost[np.ix_(seats.task, seats.task)], dtype=np.float64)
    return np.where(seats.task[:, None] == seats.task, 0.0, float(cost))


def _dense(matrix: Matrix) -> FloatArray:
    return matrix.toarray() if isinstance(matrix, GainMatrix) else np.asarray(matrix, dtype=np.float64)
