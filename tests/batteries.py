"""Small problems with batteries, and their rules once more in exact fractions, agent by agent."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from hypothesis import strategies as st
from strategies import as_form, sizes

from sapopt import SAP
from sapopt.dynamics import Battery

CHARGES = (("0.2", "0.1", "1"), ("0.5", "0.25", "1"), ("1", "1", "2"), ("0.3", "0.2", "0.7"), ("2", "0", "3"))
"""Drain, charge, capacity."""


@dataclass(frozen=True, eq=False)
class Case:
    """A problem as plain numbers."""

    benefits: np.ndarray
    cost: float
    charges: tuple[str, str, str]
    first: tuple[str, ...]
    initial: tuple[int, ...] | None
    pay_for: Any

    @property
    def dynamics(self) -> Battery:
        drain, charge, capacity = (float(x) for x in self.charges)
        first = [float(x) for x in self.first]
        return Battery(self.cost, drain, charge, capacity, pay_for=self.pay_for, initial_charge=first)

    def problem(self, form: str = "dense") -> SAP:
        return SAP(as_form(self.benefits, form), self.dynamics, self.initial)

    def walk(self, agent: int, path: Any) -> tuple[float, list[Fraction]]:
        """Value of an agent's path by the rules as written, and its charge after every step."""
        drain, charge, capacity = (Fraction(x) for x in self.charges)
        level, total, levels = Fraction(self.first[agent]), 0.0, []
        before = None if self.initial is None else self.initial[agent]
        worked = before is not None
        for k, j in enumerate(path):
            benefit = float(self.benefits[k, agent, j])
            works = benefit > 0 and level > 0
            if works:
                stays = before == j and (worked or self.pay_for == "moves")
                free = k == 0 and self.initial is None
                total += benefit - (0.0 if stays or free else self.cost)
                level = max(level - drain, Fraction(0))
            else:
                total += min(benefit, 0.0)
                if level > 0:
                    level = min(level + charge, capacity)
            before, worked = j, works
            levels.append(level)
        return total, levels

    def score(self, plan: Any) -> float:
        return sum(self.walk(i, [row[i] for row in plan])[0] for i in range(self.benefits.shape[1]))

    def paths(self) -> Any:
        return itertools.product(range(self.benefits.shape[2]), repeat=self.benefits.shape[0])

    def plans(self) -> Any:
        steps, n, m = self.benefits.shape
        return itertools.product(itertools.permutations(range(m), n), repeat=steps)


def random_case(seed: int, *, steps: int = 6, n: int = 2, m: int = 3, negative: bool = True) -> Case:
    """A case with many zeros and, if wanted, some negative benefits."""
    rng = np.random.default_rng(seed)
    worth = rng.random((steps, n, m)) * 2 - (0.5 if negative else 0.0)
    benefits = np.where(rng.random((steps, n, m)) < 0.6, worth, 0.0)
    charges = CHARGES[seed % len(CHARGES)]
    unit = Fraction(charges[1]) or Fraction(1)
    most = int(Fraction(charges[2]) / unit)
    first = tuple(str(float(unit * rng.integers(0 if rng.random() < 0.2 else 1, most + 1))) for _ in range(n))
    initial = None if seed % 3 == 0 else tuple(int(j) for j in rng.permutation(m)[:n])
    return Case(
        benefits, float(rng.choice([0.0, 0.3, 1.0])), charges, first, initial, ("moves", "entries")[seed % 2]
    )


@st.composite
def cases(draw: Any, most: tuple[int, int, int] = (6, 3, 4)) -> Case:
    """Cases of a few steps, agents and tasks."""
    steps, n, m = draw(sizes(most=most))
    return random_case(draw(st.integers(0, 10_000)), steps=steps, n=n, m=m, negative=draw(st.booleans()))
