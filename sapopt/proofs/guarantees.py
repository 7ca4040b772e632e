"""What can be promised about HAA and HAAL before solving anything: the c / (1 + c) theorem, and a better bound.

With B the least value that any assignment has at any step and ``|H|`` the most that handovers can cost in one step, the
thesis (theorem 3.5.1) promises HAAL at least c / (1 + c) of the optimum, ``c = B / |H|``, if the handover matrix
vanishes for agents that stay. What holds of it (docs/theorem.md): it is true for lookahead 1 and 2 (HAA is lookahead
1) and for HAAL with ``keep_plan=True`` at any lookahead; for HAAL with lookahead 3 or more it is false (small
counterexamples).

The refined guarantee holds for the same algorithms. With m_k and M_k the least and the greatest value of an assignment
at step k, every one of them collects at least ``max(m_k, M_k - |H|)`` at every step, and the optimum at most M_k. It is
never below c / (1 + c), and says something where B = 0.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import dense_step
from sapopt.problem.sap import SAP

Answer = Literal["yes", "no", "unknown"]

_ENUMERATED = (
    20_000  # pairs of state and assignment that are tried to decide the conditions of a user's dynamics
)


@dataclass(frozen=True)
class Conditions:
    """Properties of the dynamics that the theorem is about.

    Attributes
    ----------
    vanishing : {"yes", "no", "unknown"}
        Repeating the last assignment has handover zero.
    strict_penalty : {"yes", "no", "unknown"}
        Every agent that changes task has negative handover.
    assignment_dominated : {"yes", "no", "unknown"}
        The state is the last assignment: nothing earlier matters.
    """

    vanishing: Answer
    strict_penalty: Answer
    assignment_dominated: Answer


@dataclass(frozen=True)
class Guarantee:
    """A-priori guarantees of a problem.

    Attributes
    ----------
    least_benefit : float
        B, the least value of an assignment at any step, handovers left out.
    least_benefit_by_entry : float
        n times the smallest benefit; below `least_benefit`, and cheaper.
    handover_size : float
        ``|H|``, the most that handovers can cost in one step; NaN where the dynamics does not say.
    c : float
        ``least_benefit / handover_size``; infinite if handovers cost nothing, NaN where unknown or negative.
    ratio : float
        ``c / (1 + c)``; 0 where nothing is promised.
    refined_ratio : float
        ``sum_k max(m_k, M_k - |H|) / sum_k M_k``; 0 where nothing is promised.
    conditions : Conditions
    """

    least_benefit: float
    least_benefit_by_entry: float
    handover_size: float
    c: float
    ratio: float
    refined_ratio: float
    conditions: Conditions

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Guarantee:
        """Undo `dataclasses.asdict`."""
        return cls(**{**values, "conditions": Conditions(**values["conditions"])})

    @property
    def applies(self) -> bool:
        """Whether the conditions of the theorem are known to hold."""
        return self.conditions.vanishing == "yes" and self.conditions.assignment_dominated == "yes"

    @property
    def statement(self) -> str:
        """What is promised, and for which algorithms."""
        if not self.applies:
            return "Nothing is promised a priori: the conditions of theorem 3.5.1 are not known to hold."
        return (
            "HAA, HAAL with lookahead 1 or 2, and HAAL with keep_plan=True reach at least "
            f"{100 * self.ratio:.4g} % of the optimum (theorem 3.5.1, c = {self.c:.4g}; refined: "
            f"{100 * self.refined_ratio:.4g} %). HAAL with lookahead 3 or more is promised nothing."
        )

    def covers(self, solver: Any) -> bool:
        """Whether the ratios are promised for a solver: HAA, HAAL with lookahead at most 2 or ``keep_plan=True``."""
        kind = type(solver).__name__
        if not self.applies:
            return False
        return kind == "HAA" or (
            kind == "HAAL" and (solver.lookahead <= 2 or getattr(solver, "keep_plan", False))
        )


def guarantee(problem: SAP) -> Guarantee:
    """Compute the a-priori guarantees of a problem.

    Parameters
    ----------
    problem : SAP

    Returns
    -------
    Guarantee
    """
    spans = [_span(problem, k) for k in range(problem.T)]
    least = float(min(low for low, _ in spans))
    size = _handover_size(problem)
    conditions = _conditions(problem)
    if not size >= 0 or least < 0:
        c, ratio = math.nan, 0.0
    elif size == 0:
        c, ratio = math.inf, 1.0
    else:
        c, ratio = least / size, least / (least + size)
    top = math.fsum(high for _, high in spans)
    refined = 0.0
    if size >= 0 and top > 0:
        refined = max(0.0, math.fsum(max(low, high - size) for low, high in spans) / top)
    entry = min(float(dense_min(problem, k)) for k in range(problem.T))
    return Guarantee(least, problem.n * entry, size, c, ratio, refined, conditions)


def dense_min(problem: SAP, k: int) -> float:
    """Smallest allowed benefit at a step."""
    step = problem.benefits.step(k)
    if isinstance(step, np.ndarray):
        return float(step[np.isfinite(step)].min())
    entries = step.data[np.isfinite(step.data)]
    smallest = float(entries.min()) if len(entries) else 0.0
    return smallest if step.nnz == problem.n * problem.m else min(smallest, 0.0)


def _span(problem: SAP, k: int) -> tuple[float, float]:
    """Least and greatest value of an assignment at step k, handovers left out."""
    from scipy.optimize import linear_sum_assignment

    step = problem.benefits.step(k)
    if not isinstance(step, np.ndarray) and step.nnz and step.data.min() >= 0 and _can_idle(step, problem.m):
        return 0.0, _most(step)
    dense = dense_step(step)
    low_rows = linear_sum_assignment(np.where(np.isfinite(dense), dense, np.inf))
    return float(dense[low_rows].sum()), float(dense[linear_sum_assignment(dense, maximize=True)].sum())


def _most(step: Any) -> float:
    """Greatest value of an assignment of benefits that are not negative, where every agent may also hold nothing.

    By scipy and not by the library's own kernels, so that a certificate shares nothing with the solvers.
    """
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    n, m = step.shape
    agents = np.arange(n)
    row = np.concatenate([np.repeat(agents, np.diff(step.indptr)), agents])
    column = np.concatenate([step.indices, m + agents])  # one column of its own for every idle agent
    gain = np.concatenate([step.data, np.zeros(n)])
    # scipy drops entries of weight zero; a constant added to all changes nothing, since every agent is matched.
    graph = sp.csr_array((gain.max() + 1.0 - gain, (row, column)), shape=(n, m + n))
    held = min_weight_full_bipartite_matching(graph)[1]
    chosen = sp.csr_array((gain, (row, column)), shape=(n, m + n))[agents, held]
    return math.fsum(np.asarray(chosen).ravel().tolist())


def _can_idle(step: Any, m: int) -> bool:
    """Whether all agents can be given tasks that are worth nothing to them; False if that takes more than greed."""
    taken = np.zeros(m, dtype=bool)
    for i in range(step.shape[0]):
        blocked = taken.copy()
        blocked[step.indices[step.indptr[i] : step.indptr[i + 1]]] = True
        free = int(np.argmin(blocked))
        if blocked[free]:
            return False
        taken[free] = True
    return True


def _handover_size(problem: SAP) -> float:
    rule = problem.model.switching()
    if rule is not None:
        return problem.n * rule.largest_cost
    floor, limit = problem.model.handover_floor, problem.model.handover_limit
    if floor is None or limit is None or limit > 0:
        return math.nan
    return -problem.n * float(floor)


def _conditions(problem: SAP) -> Conditions:
    rule = problem.model.switching()
    if rule is not None:
        cost = np.asarray(rule.cost)
        moves = cost if cost.ndim == 0 else cost[~np.eye(len(cost), dtype=bool)]
        strict: Answer = "yes" if not rule.idle_is_free and (moves > 0).all() else "no"
        return Conditions("yes", strict, "yes")
    return _enumerated(problem)


def _enumerated(problem: SAP) -> Conditions:
    """Decide the conditions of a user's dynamics by visiting every state the problem can reach, if they are few."""
    unknown = Conditions("unknown", "unknown", "unknown")
    if math.perm(problem.m, problem.n) > _ENUMERATED:
        return unknown
    assignments = [np.array(x) for x in itertools.permutations(range(problem.m), problem.n)]
    key = problem.model.key
    agents = np.arange(problem.n)
    vanishing = strict = dominated = True
    states = {key(problem.initial_state()): problem.initial_state()}
    tried = 0
    for k in range(problem.T - 1):
        following: dict[Any, Any] = {}
        for tasks in assignments:
            after: set[Any] = set()
            for state in states.values():
                tried += 1
                if tried > _ENUMERATED:
                    return unknown
                entered = problem.transition(k, state, tasks)
                name = key(entered)
                after.add(name)
                following[name] = entered
                eta = problem.handover(k + 1, entered)
                vanishing &= bool((eta[agents, tasks] == 0).all())
                moved = np.ones_like(eta, dtype=bool)
                moved[agents, tasks] = False
                strict &= bool((eta[moved] < 0).all())
            dominated &= len(after) == 1
        states = following
    return Conditions(_answer(vanishing), _answer(strict), _answer(dominated))


def _answer(truth: bool) -> Answer:
    return "yes" if truth else "no"
