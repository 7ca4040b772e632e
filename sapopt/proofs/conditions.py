"""The properties of a dynamics that the thesis' promises rest on (definitions 3.2.1, 3.2.2 and 3.5.1, and |H|).

For the plain switching rule they are known in closed form. For any other dynamics every state that the problem can
reach is visited, if these are few, and the definitions are read off; otherwise the answer is "unknown".
"""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Switching
from sapopt.problem.sap import SAP
from sapopt.proofs.promises import CLOSE, ENUMERATED, Answer, Conditions, Distance, hamming


class HandoverRange(NamedTuple):
    """The least and the greatest handover value of a whole assignment in any state; NaN where unknown."""

    least: float
    greatest: float

    @property
    def size(self) -> float:
        """|H| of section 3.5."""
        return self.greatest - self.least


def conditions(problem: SAP, distance: Distance | None = None) -> Conditions:
    """Decide the conditions of a problem.

    Parameters
    ----------
    problem : SAP
    distance : callable, optional
        Distance of two states, see `Distance`; by default `hamming`, the number of agents in which they differ.
    """
    allowed: Answer = "no" if problem.benefits.forbids() else "yes"
    rule = problem.model.switching()
    if rule is not None and distance is None:
        strict = _strict_switching(problem, rule)
        if strict == "unknown":
            strict = _enumerated(problem, hamming, allowed).strict_penalty
        return Conditions("yes", strict, 0.0, "yes", allowed)
    return _enumerated(problem, distance or hamming, allowed)


def handover_range(problem: SAP) -> HandoverRange:
    """Least and greatest H(s, x) over all states and assignments (section 3.5), on the safe side where they are bounds.

    Exact for the plain switching rule. Otherwise n times what the dynamics declares as ``handover_floor`` and
    ``handover_limit``.
    """
    rule = problem.model.switching()
    if rule is not None:
        return HandoverRange(-_dearest_moves(problem, rule), 0.0)
    floor, limit = problem.model.handover_floor, problem.model.handover_limit
    if floor is None or limit is None:
        return HandoverRange(math.nan, math.nan)
    return HandoverRange(problem.n * float(floor), problem.n * float(limit))


def _dearest_moves(problem: SAP, rule: Switching) -> float:
    """The most that the moves of one step can cost, over all pairs of assignments before and after."""
    from scipy.sparse.csgraph import maximum_bipartite_matching

    n, m = problem.n, problem.m
    first = 1 if problem.initial_assignment is None else 0
    if m == 1 or first >= problem.T:
        return 0.0
    if not rule.idle_is_free:
        return _dearest(_costs(rule, m), n)
    # Only moves to pairs of positive benefit are charged: as many agents as can have one at once.
    if rule.uniform_cost is not None:
        movers = 0
        for k in range(first, problem.T):
            step = problem.benefits.step(k)
            served = maximum_bipartite_matching(sp.csr_array(step > 0), perm_type="column")
            movers = max(movers, int((served >= 0).sum()))
        return movers * rule.uniform_cost
    return _dearest(_costs(rule, m), n)


def _costs(rule: Switching, m: int) -> FloatArray:
    """Cost (m, m) of every move."""
    if rule.uniform_cost is not None:
        return rule.uniform_cost * (1.0 - np.eye(m))
    return np.asarray(rule.cost)


def _dearest(cost: FloatArray, n: int) -> float:
    """The dearest n moves from different tasks to different tasks."""
    from scipy.optimize import linear_sum_assignment

    m = len(cost)
    if np.ptp(cost[~np.eye(m, dtype=bool)]) == 0:
        return n * float(cost.max())
    # m - n tasks are left by nobody and m - n are taken by nobody: dummy rows and columns.
    size = 2 * m - n
    wide = np.zeros((size, size))
    wide[:m, :m] = cost
    wide[m:, m:] = -np.inf
    rows, columns = linear_sum_assignment(wide, maximize=True)
    return math.fsum(wide[rows, columns].tolist())


def _strict_switching(problem: SAP, rule: Switching) -> Answer:
    """Definition 3.2.2 for the plain switching rule and the Hamming distance: equally many moves must cost the same."""
    n, m = problem.n, problem.m
    cost = _costs(rule, m)
    moves = cost[~np.eye(m, dtype=bool)].reshape(m, max(m - 1, 0))
    if m == 1 or not moves.any():
        return "yes"
    # If idling is free, a move to a task that is worth nothing costs less than another, though both move one agent.
    if rule.idle_is_free and not all(_all_positive(problem, k) for k in range(problem.T)):
        return "unknown"
    if np.ptp(moves) == 0 or (n == 1 and (np.ptp(moves, axis=1) == 0).all()):
        return "yes"
    # Two moves of one agent each and of unequal cost, from one assignment that leaves both targets free.
    room = m >= n + 2 if (np.ptp(moves, axis=1) > 0).any() else m >= n + 1
    return "no" if room else "unknown"


def _all_positive(problem: SAP, k: int) -> bool:
    step = problem.benefits.step(k)
    if isinstance(step, np.ndarray):
        return bool((step > 0).all())
    return step.nnz == problem.n * problem.m and bool((step.data > 0).all())


def _enumerated(problem: SAP, distance: Distance, allowed: Answer) -> Conditions:
    """Read the definitions off every state that the problem can reach, if they are few."""
    fair = _fair_start(problem)
    unknown = Conditions("unknown", "unknown", math.nan, fair, allowed)
    if math.perm(problem.m, problem.n) > ENUMERATED:
        return unknown
    assignments = [np.array(x) for x in itertools.permutations(range(problem.m), problem.n)]
    key = problem.model.key
    states = {key(problem.initial_state()): problem.initial_state()}
    vanishing = strict = True
    domination = 0.0
    tried = 0
    for k in range(problem.T):
        following: dict[Any, Any] = {}
        reached: list[list[Any]] = [[] for _ in assignments]
        for state in states.values():
            tried += len(assignments)
            if tried > ENUMERATED:
                return unknown
            eta = problem.handover(k, state)
            worth, moved = [], []
            for place, tasks in enumerate(assignments):
                after = problem.transition(k, state, tasks)
                reached[place].append(after)
                following[key(after)] = after
                worth.append(_total(eta, tasks))
                moved.append(float(distance(after, state)))
                if k + 1 < problem.T:
                    kept = problem.handover(k + 1, after)[np.arange(problem.n), tasks]
                    vanishing &= bool((kept >= 0).all())
            strict &= _falls(np.array(moved), np.array(worth), _largest(eta))
        for states_after in reached:
            tried += len(states_after) ** 2
            if tried > ENUMERATED:
                return unknown
            for a, b in itertools.combinations(states_after, 2):
                domination = max(domination, float(distance(a, b)))
        states = following
    return Conditions(_answer(vanishing), _answer(strict), domination, fair, allowed)


def _fair_start(problem: SAP) -> Answer:
    """Whether some assignment has no negative handover at the first step."""
    from scipy.optimize import linear_sum_assignment

    eta = problem.handover(0, problem.initial_state())
    rows, columns = linear_sum_assignment(np.where(eta >= 0, 0.0, 1.0))
    return _answer(bool((eta[rows, columns] >= 0).all()))


def _total(eta: FloatArray, tasks: IntArray) -> float:
    return math.fsum(eta[np.arange(len(tasks)), tasks].tolist())


def _largest(eta: FloatArray) -> float:
    return float(np.abs(eta[np.isfinite(eta)]).max(initial=0.0))


def _falls(moved: FloatArray, worth: FloatArray, size: float) -> bool:
    """Whether who moves the state as far or farther is worth the same or less; `size` is that of the handovers."""
    slack = CLOSE * size
    for distance in np.unique(moved):
        if worth[moved >= distance].max() > worth[moved <= distance].min() + slack:
            return False
    return True


def _answer(truth: bool) -> Answer:
    return "yes" if truth else "no"
