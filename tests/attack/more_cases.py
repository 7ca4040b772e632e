"""Random problems of the rules that `cases` leaves out: paths in space and cities, interference, users' dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from attack import more_reference, reference
from attack.cases import SCALES, _benefits
from attack.reference import Reference
from local_dynamics import Dictator as Leader
from local_dynamics import Tiring
from rule_problems import Learning

from sapopt import SAP, SwitchingCost
from sapopt.dynamics import Battery, Interference, RideHailing, SlewCost

RULES = (
    "slewing", "rides", "interference", "own rule", "own local states", "own global state",
    "changed switching", "changed battery", "changed rule",
)  # fmt: skip
KINDS = ("plain", "tied", "sparse", "mixed", "negative", "forbidden")
POSITIVE = ("slewing", "rides")
"""Rules that take no negative benefits and no forbidden pairs."""


class Doubled(SwitchingCost):
    """A user's subclass that charges twice."""

    def handover(self, k: int, state: Any) -> np.ndarray:
        return np.asarray(2.0 * super().handover(k, state))

    def fingerprint(self) -> list[Any]:
        return ["Doubled 1", self.cost, self.idle_is_free]


class Rewarded(Learning):
    """A user's subclass of an own rule, whose bonus is twice as large."""

    def rule(self, k: int, agent: Any, local: Any, task: Any, benefit: Any) -> Any:
        eta, after = super().rule(k, agent, local, task, benefit)
        return 2.0 * eta, after


class Scaled(Leader):
    """A global state that says how much it can add."""

    @property
    def handover_limit(self) -> float:
        return self.bonus


class Tireless(Battery):
    """A user's subclass without a drain: work leaves the battery as it is."""

    def transition(self, k: int, state: Any, assignment: Any) -> Any:
        return replace(super().transition(k, state, assignment), levels=state.levels)


@dataclass(frozen=True)
class Case:
    """A problem, its definition, what HAAL sees of it (`hat`), its benefits, and the size of its sums."""

    name: str
    problem: SAP | None
    definition: Reference
    hat: Reference
    benefits: Any
    size: Fraction


def case(seed: int) -> Case:
    """A random case; without a problem if that is refused as infeasible."""
    rng = np.random.default_rng([seed, 43])
    rule, kind = RULES[seed % len(RULES)], KINDS[(seed // len(RULES)) % len(KINDS)]
    if rule in POSITIVE and kind in ("negative", "forbidden"):
        kind = "plain"
    scale = float(SCALES[rng.integers(len(SCALES))])
    T, n = int(rng.integers(1, 5)), int(rng.integers(1, 3))
    m = int(rng.integers(n, 5))
    benefits = _benefits(rng, (T, n, m), kind, scale)
    if rule == "rides":  # a request is on offer at one step
        benefits = benefits * (np.arange(T)[:, None] == rng.integers(0, T, m))[:, None, :]
    initial = rng.permutation(m)[:n] if rng.random() < 0.5 else None
    amount = scale * float(rng.choice([0.0, 0.25, 0.7, 3.0]))
    dynamics, definition, hat = _made(rng, rule, benefits, amount, initial)
    finite = np.abs(benefits[np.isfinite(benefits)])
    # No handover is larger than twelve times the amount: slews of up to pi, rides of up to three steps, two losses.
    size = n * T * (2 * Fraction(float(finite.max(initial=0.0))) + 12 * Fraction(amount))
    name = f"{rule}, {kind}, {scale:g}, {T}x{n}x{m}, seed {seed}"
    try:
        problem = SAP(benefits, dynamics, initial)
    except ValueError as error:
        if "full assignment" not in str(error):
            raise
        return Case(name, None, definition, hat, benefits, size)
    return Case(name, problem, definition, hat, benefits, size)


def _made(
    rng: np.random.Generator, rule: str, benefits: Any, amount: float, initial: Any
) -> tuple[Any, Reference, Reference]:
    T, n, m = benefits.shape
    free = bool(rng.random() < 0.5)
    if rule == "interference":
        pairs = [(a, b) for a in range(m) for b in range(a) if rng.random() < 0.6]
        loss = amount * rng.random(len(pairs))
        made: Any = Interference(np.array(pairs, dtype=int).reshape(-1, 2), loss, amount / 2, free)
        told = more_reference.interference(benefits, pairs, loss, amount / 2, free, initial)
        return made, told, reference.switching(benefits, amount / 2, free, initial)
    if rule == "slewing":
        satellites, targets = 7000 + 1000 * rng.normal(size=(T, n, 3)), 3000 * rng.normal(size=(m, 3))
        made = SlewCost(amount, satellites, targets)
        told = more_reference.slewing(benefits, amount, satellites, targets, initial)
    elif rule == "rides":
        travel = rng.integers(1, 4, (3, 3)) * (1 - np.eye(3, dtype=int))
        places, patience = (*rng.integers(0, 3, (2, m)), rng.integers(0, 3, n)), int(rng.integers(0, 4))
        made = RideHailing(travel, *places, patience, amount)
        told = more_reference.rides(benefits, travel, *places, patience, amount)
    elif rule in ("own rule", "changed rule"):
        changed = rule == "changed rule"
        made = (Rewarded if changed else Learning)(amount)
        told = more_reference.learning(benefits, amount * (1 + changed))
    elif rule == "own local states":
        made, told = Tiring(amount), more_reference.tiring(benefits, amount)
    elif rule == "own global state":
        made, told = (Scaled if free else Leader)(amount), more_reference.leader(benefits, amount)
    elif rule == "changed switching":
        made, told = Doubled(amount, free), reference.switching(benefits, 2 * amount, free, initial)
    else:
        made = Tireless(amount, 0.5, 0.25, 1.0)
        whole = (Fraction(0), Fraction(0), Fraction(1))
        told = reference.battery(benefits, amount, *whole, "moves", initial)
    return made, told, told
