"""Tiny random problems with capacities, idleness, limits and teams, and a reference that reads their definitions.

The reference scores a plan agent by agent and step by step, and finds the optimum by trying every plan. It calls
nothing of the code under test but the dynamics' own three methods.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from sapopt import SAP, Benefits, Limit, SwitchingCost, Team
from sapopt.data.types import IntArray
from sapopt.dynamics import Battery, UnitCommitment
from sapopt.dynamics.capabilities import adapt
from tests.local_dynamics import Dictator, Tiring

LOCAL = ("number", "free", "matrix", "battery", "entries", "units", "tiring")
"""Kinds of agent-local dynamics."""


@dataclass
class Sum:
    """One sum of a limit: a function of what an agent does at a step, and its bounds."""

    weight: Any  # (k, i, before or None, task, benefits) -> number
    at_most: float = math.inf
    at_least: float = -math.inf
    penalty: float | None = None


@dataclass
class Tiny:
    """A problem and what it says, in plain words."""

    problem: SAP
    benefits: np.ndarray
    dynamics: Any
    initial: list[int] | None
    capacity: np.ndarray
    idle: bool
    sums: list[Sum] = field(default_factory=list)
    teams: list[tuple[int, int, float, list[int]]] = field(default_factory=list)

    def value(self, plan: Any) -> float | None:
        """Value of a plan; None if it is none."""
        T, n, m = self.benefits.shape
        for k in range(T):
            for j in range(m):
                if sum(1 for i in range(n) if plan[k][i] == j) > self.capacity[k, j]:
                    return None
        total = self._gains(plan)
        if total is None:
            return None
        for entry in self.sums:
            use = 0.0
            for k in range(T):
                for i in range(n):
                    before = (None if self.initial is None else self.initial[i]) if k == 0 else plan[k - 1][i]
                    if plan[k][i] >= 0:
                        use += entry.weight(k, i, before, plan[k][i], self.benefits)
            beyond = max(use - entry.at_most, entry.at_least - use, 0.0)
            if beyond > 1e-12:
                if entry.penalty is None:
                    return None
                total -= entry.penalty * beyond
        for task, needs, reward, steps in self.teams:
            total += sum(reward for k in steps if list(plan[k]).count(task) >= needs)
        return total

    def _gains(self, plan: Any) -> float | None:
        """Benefits and handovers by the dynamics' own methods, idleness being a task of no benefit and no charge."""
        T, n, m = self.benefits.shape
        wide = np.concatenate([self.benefits, np.zeros((T, n, 1))], axis=2) if self.idle else self.benefits
        initial = None if self.initial is None else np.array([m if j < 0 else j for j in self.initial])
        setting = SimpleNamespace(
            T=T, n=n, m=wide.shape[2], benefits=Benefits(wide), initial_assignment=initial
        )
        model = adapt(self.dynamics, setting)
        state, total = model.initial_state(setting), 0.0
        for k in range(T):
            row = np.array([m if j < 0 else j for j in plan[k]])
            eta = model.handover(k, state)
            for i, j in enumerate(row):
                # the units' own rule says what going idle costs; nothing, by all others
                free = self.idle and j == m and not isinstance(self.dynamics, UnitCommitment)
                total += wide[k, i, j] + (0.0 if free else eta[i, j])
            state = model.transition(k, state, row)
        return total if math.isfinite(total) else None

    def plans(self) -> Any:
        """All plans within the capacities."""
        T, n, m = self.benefits.shape
        rows = list(itertools.product(range(-1 if self.idle else 0, m), repeat=n))
        by_step = [
            [row for row in rows if all(row.count(j) <= self.capacity[k, j] for j in range(m))]
            for k in range(T)
        ]
        return itertools.product(*by_step)

    def optimum(self) -> tuple[float, Any]:
        """The best value and a plan that has it; -inf and None if there is none."""
        best, found = -math.inf, None
        for plan in self.plans():
            value = self.value(plan)
            if value is not None and value > best:
                best, found = value, plan
        return best, found


def tiny(rng: np.random.Generator, kind: str = "number", plans: int = 3000) -> Tiny | None:
    """A random problem of a kind of dynamics; None where the numbers drawn allow none."""
    T, n, m = int(rng.integers(1, 4)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    idle = bool(rng.integers(2))
    while T > 1 and (m + idle) ** (n * T) > plans:
        T -= 1
    benefits = np.round(rng.normal(0.6, 1.0, (T, n, m)), 2)
    benefits[rng.random((T, n, m)) < 0.3] = 0.0
    if kind in ("units",):
        benefits = np.abs(benefits)
    capacity = rng.integers(0, 3, (T, m)) if rng.random() < 0.6 else np.ones((T, m), dtype=int)
    if not idle and (np.minimum(capacity, n).sum(axis=1) < n).any():
        return None
    initial = None
    if rng.random() < 0.5:
        places = [j for j in range(m) for _ in range(int(capacity[:, j].max()))] + ([-1] * n if idle else [])
        if len(places) >= n:
            initial = [int(j) for j in rng.permutation(places)[:n]]
    sums: list[Sum] = []
    teams: list[tuple[int, int, float, list[int]]] = []
    limits: list[Any] = []
    for _ in range(int(rng.integers(0, 4))):
        _add_limit(rng, (T, n, m), capacity, initial, limits, sums, teams)
    dynamics = _dynamics(rng, kind, n, m + idle)
    try:
        problem = SAP(benefits, dynamics, initial, capacity=_short(capacity), idle=idle, limits=limits)
    except ValueError as error:
        if "out of reach" in str(error) or "no full assignment" in str(error):
            return None
        raise
    return Tiny(problem, benefits, dynamics, initial, capacity, idle, sums, teams)


def _short(capacity: np.ndarray) -> Any:
    """The shortest form that says the same."""
    if (capacity == capacity[0, 0]).all():
        return int(capacity[0, 0])
    return capacity[0] if (capacity == capacity[0]).all() else capacity


def _dynamics(rng: np.random.Generator, kind: str, n: int, places: int) -> Any:
    cost = float(rng.choice([0.0, 0.25, 1.0]))
    if kind == "matrix":
        matrix = np.round(rng.random((places, places)), 2)
        np.fill_diagonal(matrix, 0.0)
        matrix[:, -1] = 0.0  # going idle is free; another task may be that cheap as well
        return SwitchingCost(matrix)
    if kind == "battery":
        return Battery(cost, drain=0.5, charge=0.25)
    if kind == "entries":
        return Battery(cost, drain=0.5, charge=0.25, pay_for="entries")
    if kind == "units":
        lengths = rng.integers(1, 3, n)
        return UnitCommitment(rng.random(n), lengths, lengths, rng.random(n), rng.choice([-2, -1, 1, 2], n))
    if kind == "tiring":
        return Tiring(price=float(rng.choice([0.7, 0.2])))
    if kind == "dictator":
        return Dictator(0.5)
    return SwitchingCost(cost, idle_is_free=kind == "free")


def _add_limit(
    rng: np.random.Generator,
    shape: tuple[int, int, int],
    capacity: np.ndarray,
    initial: list[int] | None,
    limits: list[Any],
    sums: list[Sum],
    teams: list[tuple[int, int, float, list[int]]],
) -> None:
    T, n, m = shape
    penalty = float(rng.choice([0.3, 1.0])) if rng.random() < 0.4 else None
    kind = rng.choice(["once", "visits", "cover", "work", "handovers", "each", "weight", "sparse", "team"])
    tasks = sorted({int(j) for j in rng.integers(0, m, 2)})
    agents = sorted({int(i) for i in rng.integers(0, n, 2)})
    steps = sorted({int(k) for k in rng.integers(0, T, 2)})
    bound = int(rng.integers(0, 3))

    def serves(k: int, i: int, j: int, b: np.ndarray) -> bool:
        return bool(b[k, i, j] > 0)

    if kind == "once":
        limits.append(Limit.once(tasks, bound, penalty=penalty))
        sums += [
            Sum(lambda k, i, a, j, b, t=t: serves(k, i, j, b) and j == t, bound, penalty=penalty)
            for t in tasks
        ]
    elif kind == "visits":
        limits.append(Limit.visits(tasks, bound, penalty=penalty))

        def begins(k: int, i: int, a: int | None, j: int, b: np.ndarray, t: int) -> bool:
            goes_on = k > 0 and a == j and serves(k - 1, i, j, b)
            return serves(k, i, j, b) and j == t and not goes_on

        sums += [
            Sum(lambda k, i, a, j, b, t=t: begins(k, i, a, j, b, t), bound, penalty=penalty) for t in tasks
        ]
    elif kind == "cover":
        served = bool(steps[0] % 2)  # no number drawn for it, so that a seed gives the problem that it gave
        limits.append(Limit.cover(tasks, bound, steps, served=served, penalty=penalty))
        sums += [
            Sum(
                lambda k, i, a, j, b, s=s: k == s and j in tasks and (not served or serves(k, i, j, b)),
                at_least=bound,
                penalty=penalty,
            )
            for s in steps
        ]
    elif kind == "work":
        low, high = (bound, math.inf) if rng.random() < 0.3 else (-math.inf, bound)
        limits.append(Limit.work(agents, None if math.isinf(high) else high, None if math.isinf(low) else low,
                                 penalty=penalty))  # fmt: skip
        sums += [
            Sum(lambda k, i, a, j, b, o=o: i == o and serves(k, i, j, b), high, low, penalty) for o in agents
        ]
    elif kind in ("handovers", "each"):
        limits.append(Limit.handovers(bound, agents, kind == "each", penalty=penalty))
        groups = [[i] for i in agents] if kind == "each" else [agents]
        sums += [Sum(lambda k, i, a, j, b, g=g: i in g and a is not None and a != j, bound, penalty=penalty)
                 for g in groups]  # fmt: skip
    elif kind == "team":
        if capacity[steps].min(axis=0)[tasks[0]] >= 1:
            needs = int(rng.integers(1, min(n, int(capacity[steps, tasks[0]].max())) + 1))
            limits.append(Team(tasks[0], needs, 0.8, steps))
            teams.append((tasks[0], needs, 0.8, steps))
    else:
        weight = np.round(rng.normal(0.3, 1.0, (T, n, m)), 1)
        given: Any = weight
        if kind == "sparse":
            import scipy.sparse as sp

            weight[rng.random(shape) < 0.5] = 0.0
            given = [sp.csr_array(step) for step in weight]
        high = float(np.round(rng.normal(1.0, 1.0), 1))
        low = high - 2.0 if rng.random() < 0.5 else -math.inf
        limits.append(Limit(given, high, None if math.isinf(low) else low, penalty=penalty))
        # the documented slack of sums that are not whole
        high += 0.0 if _whole(weight, high) else 1e-9 * max(1.0, abs(high))
        low -= 0.0 if math.isinf(low) or _whole(weight, low) else 1e-9 * max(1.0, abs(low))
        sums.append(Sum(lambda k, i, a, j, b: weight[k, i, j], high, low, penalty))


def _whole(weight: np.ndarray, bound: float) -> bool:
    return bool((weight == np.rint(weight)).all()) and bound == round(bound)


def placed(plan: Any) -> IntArray:
    """A plan as an array."""
    return np.array(plan, dtype=np.int64)


def feasible(seed: int, kind: str, count: int) -> Iterator[tuple[Tiny, float]]:
    """So many random problems of a kind that have a plan, each with its optimum over all plans."""
    rng = np.random.default_rng(seed)
    while count > 0:
        made = tiny(rng, kind, plans=400)
        best = -math.inf if made is None else made.optimum()[0]
        if made is not None and math.isfinite(best):
            count -= 1
            yield made, best
