"""More rules written from their definitions: slewing, rides, interference, and dynamics of users."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from fractions import Fraction
from typing import Any

from attack.reference import Reference, _entries, exact, switching

Local = Callable[[int, int, Any, int, Fraction], tuple[Fraction, Hashable]]
"""``rule(k, agent, local state, task, benefit) -> (handover, local state after)``."""


def agents(benefits: Any, start: tuple[Any, ...], rule: Local) -> Reference:
    """Agents that have a state each."""
    b = exact(benefits)
    T, n, m = len(b), len(b[0]), len(b[0][0])

    def step(k: int, state: Any, tasks: tuple[int, ...]) -> tuple[Fraction, Hashable] | None:
        entries = _entries(b[k], tasks)
        if entries is None:
            return None
        played = [rule(k, i, state[i], j, entries[i]) for i, j in enumerate(tasks)]
        return sum(entries, Fraction(0)) + sum(eta for eta, _ in played), tuple(after for _, after in played)

    return Reference(T, n, m, start, step)


def slewing(benefits: Any, cost: float, satellites: Any, targets: Any, initial: Any) -> Reference:
    """Cost times the angle between the old and the new direction; straight down where no task was seen."""

    def angle(k: int, i: int, old: int | None, new: int) -> float:
        here = [float(x) for x in satellites[k][i]]
        one = [-h if old is None else float(t) - h for t, h in zip(targets[old or 0], here, strict=True)]
        other = [float(t) - h for t, h in zip(targets[new], here, strict=True)]
        across = [one[a - 2] * other[a - 1] - one[a - 1] * other[a - 2] for a in range(3)]
        return math.atan2(math.hypot(*across), math.fsum(x * y for x, y in zip(one, other, strict=True)))

    def rule(k: int, i: int, local: Any, task: int, benefit: Fraction) -> tuple[Fraction, Hashable]:
        if benefit <= 0:
            return Fraction(0), ("down", None)
        kind, old = local
        turns = kind != "anywhere" and old != task
        fee = Fraction(float(cost) * angle(k, i, old, task)) if turns else Fraction(0)
        return -fee, ("at", task)

    n = len(benefits[0])
    start: list[Any] = [("anywhere", None)] * n
    if initial is not None:
        start = [("at", int(j)) if benefits[0][i][j] > 0 else ("down", None) for i, j in enumerate(initial)]
    return agents(benefits, tuple(start), rule)


def rides(
    benefits: Any, travel: Any, pick_up: Any, drop_off: Any, home: Any, patience: int, cost: float
) -> Reference:
    """Who can be at the pick-up in time goes there, pays for the empty way and is free at the drop-off."""

    def rule(k: int, i: int, local: Any, task: int, benefit: Fraction) -> tuple[Fraction, Hashable]:
        free, place = max(local[0], k), local[1]
        if benefit <= 0:
            return Fraction(0), (max(free, k + 1), place)
        pick, drop = int(pick_up[task]), int(drop_off[task])
        empty = int(travel[place][pick])
        if free + empty > k + patience:
            return -benefit, (max(free, k + 1), place)
        done = free + empty + int(travel[pick][drop])
        return -Fraction(float(cost)) * empty, (max(done, k + 1), drop)

    return agents(benefits, tuple((0, int(place)) for place in home), rule)


def interference(benefits: Any, pairs: Any, loss: Any, cost: float, free: bool, initial: Any) -> Reference:
    """Switching costs, and a loss for every listed pair of tasks that are both served."""
    b, plain = exact(benefits), switching(benefits, cost, free, initial)

    def step(k: int, held: Any, tasks: tuple[int, ...]) -> tuple[Fraction, Hashable] | None:
        out = plain.step(k, held, tasks)
        if out is None:
            return None
        served = {j for i, j in enumerate(tasks) if (b[k][i][j] or 0) > 0}
        lost = [
            Fraction(float(x)) for (a, c), x in zip(pairs, loss, strict=True) if a in served and c in served
        ]
        return out[0] - sum(lost, Fraction(0)), out[1]

    return Reference(plain.T, plain.n, plain.m, plain.start, step)


def learning(benefits: Any, bonus: float) -> Reference:
    """A bonus for doing a task again, twice of it from the third time on; a step without work forgets."""

    def rule(k: int, i: int, local: Any, task: int, benefit: Fraction) -> tuple[Fraction, Hashable]:
        if benefit <= 0:
            return Fraction(0), None
        if local is None or local[0] != task:
            return Fraction(0), (task, 0)
        return Fraction(float(bonus)) * (1 + local[1]), (task, 1)

    return agents(benefits, (None,) * len(benefits[0]), rule)


def tiring(benefits: Any, price: float) -> Reference:
    """Work takes a level of strength (0 to 2, at first 1), rest gives one back, and work at level 0 has its price."""

    def rule(k: int, i: int, level: Any, task: int, benefit: Fraction) -> tuple[Fraction, Hashable]:
        if benefit <= 0:
            return Fraction(0), min(level + 1, 2)
        return -Fraction(float(price)) if level == 0 else Fraction(0), max(level - 1, 0)

    return agents(benefits, (1,) * len(benefits[0]), rule)


def leader(benefits: Any, bonus: float) -> Reference:
    """All but agent 0 get a bonus on the task that agent 0 held last (at first task 0)."""
    b = exact(benefits)
    T, n, m = len(b), len(b[0]), len(b[0][0])

    def step(k: int, last: Any, tasks: tuple[int, ...]) -> tuple[Fraction, Hashable] | None:
        entries = _entries(b[k], tasks)
        if entries is None:
            return None
        followers = sum(j == last for j in tasks[1:])
        return sum(entries, Fraction(0)) + followers * Fraction(float(bonus)), tasks[0]

    return Reference(T, n, m, 0, step)
