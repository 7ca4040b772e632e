"""Random problems with their definitions: all rules, forbidden pairs, negative and tied values, extreme scales."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from attack import reference
from attack.reference import Reference

from sapopt import SAP, SwitchingCost
from sapopt.dynamics import Battery, Dictator, SyntheticSwitching, UnitCommitment

RULES = ("switching", "matrix", "battery", "dictator", "copies", "commitment")
SCALES = (1.0, 1.0, 1e-12, 1e12, 1e-300, 1e150)
KINDS = ("plain", "tied", "negative", "sparse", "forbidden", "mixed")


def problem(seed: int) -> tuple[str, SAP | None, Reference]:
    """Name, problem (None if it is refused as infeasible) and definition of a random case."""
    rng = np.random.default_rng([seed, 17])
    rule, kind = RULES[seed % len(RULES)], KINDS[(seed // len(RULES)) % len(KINDS)]
    scale = float(SCALES[rng.integers(len(SCALES))])
    T, n = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    m = int(rng.integers(n, 5))
    benefits = _benefits(rng, (T, n, m), kind, scale)
    cost = scale * float(rng.choice([0.0, 0.25, 0.7, 3.0]))
    initial = rng.permutation(m)[:n] if rng.random() < 0.5 else None
    dynamics, definition = _made(rng, rule, benefits, cost, scale, initial)
    name = f"{rule}, {kind}, {scale:g}, {T}x{n}x{m}, seed {seed}"
    try:
        return name, SAP(benefits, dynamics, initial), definition
    except ValueError as error:
        if "full assignment" not in str(error):
            raise
        return name, None, definition


def _benefits(rng: np.random.Generator, shape: tuple[int, ...], kind: str, scale: float) -> Any:
    values = rng.random(shape)
    if kind == "tied":
        values = rng.integers(0, 3, shape) / 2.0
    elif kind == "negative":
        values = rng.random(shape) * 2 - 1
    elif kind == "sparse":
        values = values * (rng.random(shape) < 0.4)
    elif kind == "forbidden":
        values = np.where(rng.random(shape) < 0.2, -np.inf, values)
    elif kind == "mixed":
        return values * scale * 10.0 ** rng.integers(-6, 1, shape)
    return values * scale


def _made(
    rng: np.random.Generator, rule: str, benefits: Any, cost: float, scale: float, initial: Any
) -> tuple[Any, Reference]:
    _, n, m = benefits.shape
    free = bool(rng.random() < 0.5)
    if rule == "switching":
        return SwitchingCost(cost, idle_is_free=free), reference.switching(benefits, cost, free, initial)
    if rule == "matrix":
        matrix = scale * rng.random((m, m)) * (1 - np.eye(m))
        return SwitchingCost(matrix, idle_is_free=free), reference.switching(benefits, matrix, free, initial)
    if rule == "battery":
        drain, charge = int(rng.integers(0, 4)), int(rng.integers(0, 3))
        pay_for = str(rng.choice(["moves", "entries"]))
        made = Battery(cost, drain / 4, charge / 4, 1.0, pay_for=pay_for)  # type: ignore[arg-type]
        parts = (Fraction(drain, 4), Fraction(charge, 4), Fraction(1))
        return made, reference.battery(benefits, cost, *parts, pay_for, initial)
    if rule == "dictator":
        states = int(rng.integers(1, 4))
        values = scale * rng.integers(-2, 3, (states, n, m)) / 2.0
        leads_to, leader = rng.integers(0, states, (states, m)), int(rng.integers(n))
        start = int(rng.integers(states))
        made = Dictator(values, leads_to, leader, start)
        return made, reference.dictator(benefits, values, leads_to, leader, start)
    if rule == "copies":
        agent_of, task_of = rng.integers(0, n, n), rng.integers(0, m, m)
        forfeit = float(rng.choice([0.0, 0.5, 1.0]))
        made = SyntheticSwitching(cost, forfeit, agent_of, task_of, free)
        labels = [[int(x) for x in part] for part in (agent_of, task_of)]
        return made, reference.copies(benefits, cost, forfeit, *labels, free, initial)
    up, down = rng.integers(1, 4, n), rng.integers(1, 4, n)
    start_up, idling = scale * rng.random(n), scale * rng.random(n)
    first = rng.integers(1, 4, n) * rng.choice([-1, 1], n)
    shut_down = scale * rng.random(n) * rng.integers(0, 2)
    made = UnitCommitment(start_up, up, down, idling, first, shut_down)
    lists = [[int(x) for x in part] for part in (up, down)]
    return made, reference.commitment(benefits, start_up, *lists, idling, [int(x) for x in first], shut_down)
