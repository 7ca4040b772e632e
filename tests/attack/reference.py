"""Rules and optima written from the definitions, in rational arithmetic; nothing here comes from the library.

A rule is ``step(k, state, tasks) -> (value, state)`` with exact values, None for a forbidden pair. The optimum is that
of all plans, by dynamic programming over all assignments and states.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

Step = Callable[[int, Any, tuple[int, ...]], "tuple[Fraction, Hashable] | None"]


@dataclass(frozen=True)
class Reference:
    """A problem by its definition: sizes, first state, and what a step is worth."""

    T: int
    n: int
    m: int
    start: Hashable
    step: Step

    def value(self, plan: Any) -> Fraction | None:
        """Exact value of a plan, None if it has a forbidden pair or gives one task to two agents."""
        state, total = self.start, Fraction(0)
        for k, row in enumerate(plan):
            tasks = tuple(int(j) for j in row)
            if len(set(tasks)) < self.n or not all(0 <= j < self.m for j in tasks):
                return None
            out = self.step(k, state, tasks)
            if out is None:
                return None
            total, state = total + out[0], out[1]
        return total

    def optimum(self) -> Fraction | None:
        """Exact value of the best plan, None if there is none."""
        best: dict[Hashable, Fraction] = {self.start: Fraction(0)}
        for k in range(self.T):
            after: dict[Hashable, Fraction] = {}
            for state, worth in best.items():
                for tasks in itertools.permutations(range(self.m), self.n):
                    out = self.step(k, state, tasks)
                    if out is not None and worth + out[0] > after.get(out[1], worth + out[0] - 1):
                        after[out[1]] = worth + out[0]
            best = after
        return max(best.values()) if best else None


def exact(benefits: Any) -> list[list[list[Fraction | None]]]:
    """Benefits as fractions, None where a pair is forbidden."""
    return [
        [[None if x == float("-inf") else Fraction(float(x)) for x in row] for row in step]
        for step in benefits
    ]


def _entries(step: Any, tasks: tuple[int, ...]) -> list[Fraction] | None:
    entries = [step[i][j] for i, j in enumerate(tasks)]
    return None if None in entries else entries


def switching(benefits: Any, cost: Any, free: bool, initial: Any) -> Reference:
    """Every change of task costs; if idling is free, only a change to a task of positive benefit."""
    b = exact(benefits)
    T, n, m = len(b), len(b[0]), len(b[0][0])
    fee = [
        [Fraction(float(cost[a][c] if hasattr(cost, "__len__") else cost)) for c in range(m)]
        for a in range(m)
    ]

    def step(k: int, held: Any, tasks: tuple[int, ...]) -> tuple[Fraction, Hashable] | None:
        entries = _entries(b[k], tasks)
        if entries is None:
            return None
        total = sum(entries, Fraction(0))
        for i, j in enumerate(tasks):
            if held is not None and held[i] != j and (not free or entries[i] > 0):
                total -= fee[held[i]][j]
        return total, tasks

    return Reference(T, n, m, None if initial is None else tuple(int(j) for j in initial), step)


def battery(
    benefits: Any,
    cost: float,
    drain: Fraction,
    charge: Fraction,
    capacity: Fraction,
    pay_for: str,
    initial: Any,
) -> Reference:
    """Work drains and idling charges; who reached 0 is dead: it gains nothing and pays nothing more."""
    b = exact(benefits)
    T, n, m = len(b), len(b[0]), len(b[0][0])
    fee = Fraction(float(cost))

    def step(k: int, state: Any, tasks: tuple[int, ...]) -> tuple[Fraction, Hashable] | None:
        held, levels, working = state
        entries = _entries(b[k], tasks)
        if entries is None:
            return None
        total, after, busy = Fraction(0), [], []
        for i, j in enumerate(tasks):
            alive = levels[i] > 0
            works = alive and entries[i] > 0
            total += entries[i] if alive else min(entries[i], Fraction(0))
            if works and held is not None:
                stays = held[i] == j and (pay_for == "moves" or working[i])
                total -= 0 if stays else fee
            level = levels[i]
            if alive:
                level = max(level - drain, Fraction(0)) if works else min(level + charge, capacity)
            after.append(level)
            busy.append(works)
        return total, (tasks, tuple(after), tuple(busy))

    first = None if initial is None else tuple(int(j) for j in initial)
    return Reference(T, n, m, (first, (capacity,) * n, (initial is not None,) * n), step)


def dictator(benefits: Any, values: Any, leads_to: Any, leader: int, start: int) -> Reference:
    """One state for all, set by the leader's task, adds to the benefits of everybody."""
    b = exact(benefits)
    T, n, m = len(b), len(b[0]), len(b[0][0])

    def step(k: int, state: Any, tasks: tuple[int, ...]) -> tuple[Fraction, Hashable] | None:
        entries = _entries(b[k], tasks)
        if entries is None:
            return None
        extra = sum((Fraction(float(values[state][i][j])) for i, j in enumerate(tasks)), Fraction(0))
        return sum(entries, Fraction(0)) + extra, int(leads_to[state][tasks[leader]])

    return Reference(T, n, m, start, step)


def copies(
    benefits: Any, cost: float, forfeit: float, agent_of: Any, task_of: Any, free: bool, initial: Any
) -> Reference:
    """A pair pays nothing if some copy of its real agent held some copy of its real task, else cost and forfeit."""
    b = exact(benefits)
    T, n, m = len(b), len(b[0]), len(b[0][0])

    def step(k: int, held: Any, tasks: tuple[int, ...]) -> tuple[Fraction, Hashable] | None:
        entries = _entries(b[k], tasks)
        if entries is None:
            return None
        total = sum(entries, Fraction(0))
        for i, j in enumerate(tasks):
            if held is None or (agent_of[i], task_of[j]) in held:
                continue
            if not free or entries[i] > 0:
                total -= Fraction(float(cost)) + Fraction(float(forfeit)) * max(entries[i], Fraction(0))
        return total, frozenset((agent_of[i], task_of[j]) for i, j in enumerate(tasks))

    first = (
        None if initial is None else frozenset((agent_of[i], task_of[int(j)]) for i, j in enumerate(initial))
    )
    return Reference(T, n, m, first, step)


def commitment(
    benefits: Any, start_up: Any, up: Any, down: Any, idling: Any, initial: Any, shut_down: Any
) -> Reference:
    """Units that stay on and off for their minimum times; an order against these is not obeyed."""
    b = exact(benefits)
    T, n, m = len(b), len(b[0]), len(b[0][0])

    def step(k: int, state: Any, tasks: tuple[int, ...]) -> tuple[Fraction, Hashable] | None:
        entries = _entries(b[k], tasks)
        if entries is None:
            return None
        total, after = Fraction(0), []
        for i, entry in enumerate(entries):
            on, ordered = state[i] > 0, entry != 0
            may_stop, may_start = state[i] >= up[i], -state[i] >= down[i]
            runs = (ordered and (on or may_start)) or (on and not may_stop)
            if ordered and runs:
                total += entry - (0 if on else Fraction(float(start_up[i])))
            elif runs:
                total -= Fraction(float(idling[i]))
            elif on:
                total -= Fraction(float(shut_down[i]))
            if runs:
                after.append(min(state[i] + 1, up[i]) if on else 1)
            else:
                after.append(-1 if on else max(state[i] - 1, -down[i]))
        return total, tuple(after)

    first = tuple(max(-int(d), min(int(s), int(u))) for s, u, d in zip(initial, up, down, strict=True))
    return Reference(T, n, m, first, step)
