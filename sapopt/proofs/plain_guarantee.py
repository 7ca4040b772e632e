"""The a-priori guarantee computed once more, for who verifies a certificate.

Nothing is shared with `sapopt.proofs.guarantees` and `sapopt.proofs.conditions`, which make it, but the definitions in
`sapopt.proofs.promises`. An assignment that is said to be the best or the worst of a step is only guessed by scipy;
that it is one is proven here by prices: with prices v >= 0 on the tasks no assignment is worth more than
``sum_i max_j (b_ij - v_j) + sum_j v_j``, and the guess must come up to that.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Switching
from sapopt.problem.sap import SAP
from sapopt.proofs.promises import CLOSE, ENUMERATED, Answer, Conditions, Guarantee, hamming, nothing_promised

_EPS = float(np.finfo(np.float64).eps)
_PROVEN = 1e-12
"""What proof and guess may differ by, as a share of the largest number times the number of agents: rounding."""


class Pairs(NamedTuple):
    """Pairs of agent and task that may be chosen, each once, with their worth."""

    agent: IntArray
    task: IntArray
    worth: FloatArray


def plain_guarantee(problem: SAP) -> Guarantee:
    """The a-priori guarantees of a problem, from their definitions.

    Raises
    ------
    ValueError
        If the extreme assignment of a step cannot be proven to be one.
    """
    if not problem.is_plain:
        return nothing_promised(problem.benefits.forbids())
    T, n = problem.T, problem.n
    spans = [_span(problem, k) for k in range(T)]
    smallest = min(_smallest(problem, k) for k in range(T))
    known = _conditions(problem)
    dear, good = _handovers(problem)
    B, size = min(worst for worst, _ in spans), good - dear
    # Comparisons with NaN are false: what the dynamics does not say promises nothing.
    c = math.nan
    if B >= 0 and size > 0:
        c = B / size
    elif B >= 0 and size == 0:
        c = math.inf
    ratio = refined = 0.0
    if known.broken == "" and size >= 0:
        if c > 0:
            ratio = B / (B + size) if size > 0 else 1.0
        most = math.fsum(best + (good if good > 0 else 0.0) for _, best in spans)
        sure = math.fsum(max(worst, best + (dear if dear < 0 else 0.0)) for worst, best in spans)
        if most > 0 and sure > 0:
            refined = sure / most
    return Guarantee(B, n * smallest, size, c, ratio, refined, known)


def _smallest(problem: SAP, k: int) -> float:
    """The smallest allowed benefit of a step; pairs that a sparse step leaves out are worth 0."""
    step = problem.benefits.step(k)
    entries = step.ravel() if isinstance(step, np.ndarray) else step.data
    allowed = entries[entries > -np.inf]
    if len(entries) < problem.n * problem.m:
        return float(allowed.min(initial=0.0))
    return float(allowed.min())


def _span(problem: SAP, k: int) -> tuple[float, float]:
    """Worth of the worst and of the best assignment of a step, handovers left out."""
    n, m = problem.n, problem.m
    step = problem.benefits.step(k)
    entries = step if isinstance(step, np.ndarray) else step.data
    if entries.size == 0 or entries.min() >= 0:
        # Nothing is forbidden and nothing negative: who holds nothing takes some free task and loses nothing by it.
        sparse = sp.coo_array(step)
        counts = sparse.data > 0
        rows, columns = (np.asarray(part, dtype=np.int64)[counts] for part in sparse.coords)
        best = _best_of_some(Pairs(rows, columns, sparse.data[counts]), n, m)
        if _all_may_hold_nothing(Pairs(rows, columns, sparse.data[counts]), n, m):
            return 0.0, best
        return -_best_of_all(-dense_step(step)), best
    dense = dense_step(step)
    worst = -_best_of_all(np.where(np.isneginf(dense), -np.inf, -dense))
    return worst, _best_of_all(dense)


def _all_may_hold_nothing(pairs: Pairs, n: int, m: int) -> bool:
    """Whether one agent after the other finds a free task that is worth nothing to it; if so, no benefit is negative
    and 0 is the least there is. False says nothing.
    """
    liked: list[set[int]] = [set() for _ in range(n)]
    for i, j in zip(pairs.agent.tolist(), pairs.task.tolist(), strict=True):
        liked[i].add(j)
    free = list(range(m))
    for wanted in liked:
        at = next((at for at, j in enumerate(free) if j not in wanted), None)
        if at is None:
            return False
        del free[at]
    return True


def _best_of_some(pairs: Pairs, n: int, m: int) -> float:
    """Worth of the best assignment of some agents, all pairs being worth more than 0."""
    if len(pairs.worth) == 0:
        return 0.0
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    # The guess: every agent has a private pair of worth 0, and one constant on all pairs changes no choice.
    top = float(pairs.worth.max())
    everyone = np.arange(n)
    size = np.concatenate([pairs.worth / top + 1.0, np.ones(n)])
    at = (np.concatenate([pairs.agent, everyone]), np.concatenate([pairs.task, m + everyone]))
    chosen = min_weight_full_bipartite_matching(sp.csr_array((size, at), shape=(n, m + n)), maximize=True)[1]
    held = np.where(chosen < m, chosen, -1).astype(np.int64)
    return _proven(pairs, held, n, m, can_pass=True)


def _best_of_all(worth: FloatArray) -> float:
    """Worth of the best assignment of all agents; -inf forbids a pair."""
    from scipy.optimize import linear_sum_assignment

    n, m = worth.shape
    held = linear_sum_assignment(worth, maximize=True)[1].astype(np.int64)
    agent, task = np.nonzero(worth > -np.inf)
    return _proven(Pairs(agent, task, worth[agent, task]), held, n, m, can_pass=False)


def _proven(pairs: Pairs, held: IntArray, n: int, m: int, *, can_pass: bool) -> float:
    """Worth of an assignment (n,), -1 for nothing, once prices have shown that no other is worth more.

    An agent that holds task j and could be worth d more with j' instead is no proof against it if j' is dearer than j
    by d. So prices rise from 0 until nobody would rather have another task, at most n times where the guess is right.

    Raises
    ------
    ValueError
        If the prices do not come down to the guess.
    """
    agent, task, worth = pairs
    mine = np.zeros(n)
    place = held[agent] == task
    mine[agent[place]] = worth[place]
    value = math.fsum(mine.tolist())
    largest = float(np.abs(worth).max(initial=0.0))
    gain, holds = worth - mine[agent], held[agent]
    price = np.zeros(m)
    for _ in range(n + 1):
        now = np.where(holds >= 0, price[holds], 0.0)
        raised = price.copy()
        np.maximum.at(raised, task, now + gain)
        if (raised - price).max(initial=0.0) <= _EPS * largest:
            break
        price = raised
    # Whatever the prices are, they prove this bound.
    pays = np.full(n, 0.0 if can_pass else -np.inf)
    np.maximum.at(pays, agent, worth - price[task])
    bound = math.fsum([*pays.tolist(), *price.tolist()])
    if not bound - value <= _PROVEN * n * largest:
        raise ValueError(f"an assignment worth {value!r} cannot be proven to be the best, only {bound!r}")
    return value


def _handovers(problem: SAP) -> tuple[float, float]:
    """The least and the greatest worth of the handovers of one step; NaN where the dynamics does not say."""
    n, m, T = problem.n, problem.m, problem.T
    rule = problem.model.switching()
    if rule is None:
        declared = (problem.model.handover_floor, problem.model.handover_limit)
        if declared[0] is None or declared[1] is None:
            return math.nan, math.nan
        return n * float(declared[0]), n * float(declared[1])
    charged = range(1 if problem.initial_assignment is None else 0, T)
    if m == 1 or not charged:
        return 0.0, 0.0
    if rule.idle_is_free and rule.uniform_cost is not None:
        return -rule.uniform_cost * max(_most_served(problem, k) for k in charged), 0.0
    cost = _matrix(rule, m)
    # n agents leave n tasks for n tasks. The other m - n tasks are left, and taken, by nobody: those stand in the
    # added rows and columns, which may not be paired with each other.
    spare = m - n
    wide = np.zeros((m + spare, m + spare))
    wide[:m, :m] = cost
    wide[m:, m:] = -np.inf
    return -_best_of_all(wide), 0.0


def _matrix(rule: Switching, m: int) -> FloatArray:
    cost = np.array(np.broadcast_to(np.asarray(rule.cost, dtype=np.float64), (m, m)))
    np.fill_diagonal(cost, 0.0)
    return cost


def _most_served(problem: SAP, k: int) -> int:
    """How many agents can have a task of positive benefit at once."""
    agent, task = (
        np.asarray(part, dtype=np.int64) for part in sp.coo_array(problem.benefits.step(k) > 0).coords
    )
    return round(_best_of_some(Pairs(agent, task, np.ones(len(agent))), problem.n, problem.m))


def _conditions(problem: SAP) -> Conditions:
    """What definitions 3.2.1, 3.2.2 and 3.5.1 say of the dynamics."""
    steps = [problem.benefits.step(k) for k in range(problem.T)]
    entries = [step if isinstance(step, np.ndarray) else step.data for step in steps]
    allowed: Answer = "no" if any((part == -np.inf).any() for part in entries) else "yes"
    rule = problem.model.switching()
    if rule is None:
        return _visited(problem, allowed)
    everywhere = all(part.size == problem.n * problem.m and (part > 0).all() for part in entries)
    strict = _strict(rule, problem.n, problem.m, everywhere)
    if strict == "unknown":
        strict = _visited(problem, allowed).strict_penalty
    return Conditions("yes", strict, 0.0, "yes", allowed)


def _strict(rule: Switching, n: int, m: int, everywhere: bool) -> Answer:
    """Definition 3.2.2 for switching costs: as many moves always cost as much. `everywhere`: no benefit is 0."""
    cost = _matrix(rule, m)
    away = [[cost[a, b] for b in range(m) if b != a] for a in range(m)]
    kinds = {fee for row in away for fee in row}
    if kinds <= {0.0}:
        return "yes"
    if rule.idle_is_free and not everywhere:
        return "unknown"
    by_task = all(len(set(row)) == 1 for row in away)
    if len(kinds) == 1 or (n == 1 and by_task):
        return "yes"
    # Two single moves of unequal cost: of one agent to two free tasks, or of two agents to one.
    return "no" if m - n >= (1 if by_task else 2) else "unknown"


def _visited(problem: SAP, allowed: Answer) -> Conditions:
    """The definitions read off all states that can be reached; "unknown" where these are too many to look at."""
    n, m, model = problem.n, problem.m, problem.model
    first = problem.handover(0, problem.initial_state())
    fair: Answer = "yes" if _best_of_all(np.where(first >= 0, 1.0, 0.0)) == n else "no"
    unknown = Conditions("unknown", "unknown", math.nan, fair, allowed)
    if math.perm(m, n) > ENUMERATED:
        return unknown
    agents = np.arange(n)
    choices = [np.array(tasks) for tasks in permutations(range(m), n)]
    states: dict[Hashable, Any] = {model.key(problem.initial_state()): problem.initial_state()}
    looked_at, apart = 0, 0.0
    stays_free = falls = True
    for k in range(problem.T):
        looked_at += len(choices) * len(states) * (1 + len(states))
        if looked_at > ENUMERATED:
            return unknown
        after = [[problem.transition(k, state, x) for x in choices] for state in states.values()]
        for state, leads_to in zip(states.values(), after, strict=True):
            eta = problem.handover(k, state)
            far = [float(hamming(new, state)) for new in leads_to]
            worth = [math.fsum(eta[agents, x].tolist()) for x in choices]
            falls = falls and _falls(far, worth, eta)
            if k + 1 < problem.T:
                for x, new in zip(choices, leads_to, strict=True):
                    stays_free = stays_free and bool((problem.handover(k + 1, new)[agents, x] >= 0).all())
        for column in zip(*after, strict=True):
            for a in range(len(column)):
                for b in range(a):
                    apart = max(apart, float(hamming(column[a], column[b])))
        states = {model.key(new): new for leads_to in after for new in leads_to}
    return Conditions("yes" if stays_free else "no", "yes" if falls else "no", apart, fair, allowed)


def _falls(far: list[float], worth: list[float], eta: FloatArray) -> bool:
    """Whether who goes farther, or as far, is worth no more."""
    slack = CLOSE * float(np.abs(eta[np.isfinite(eta)]).max(initial=0.0))
    order = sorted(range(len(far)), key=lambda x: far[x])
    lowest, at = math.inf, 0
    while at < len(order):
        level = [x for x in order[at:] if far[x] == far[order[at]]]
        lowest = min(lowest, *(worth[x] for x in level))
        if max(worth[x] for x in order[at:]) > lowest + slack:
            return False
        at += len(level)
    return True
