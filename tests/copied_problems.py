"""Small problems with copies of agents and tasks, and their rule in plain words."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np
from hypothesis import strategies as st
from strategies import arrays, as_form, quarters, sizes, sparse_quarters

from sapopt import SAP
from sapopt.dynamics import SyntheticSwitching


@dataclass(frozen=True, eq=False)
class Case:
    """A problem as plain numbers."""

    benefits: np.ndarray
    options: dict[str, Any]
    initial: tuple[int, ...] | None

    def problem(self, form: str = "dense") -> SAP:
        return SAP(as_form(self.benefits, form), SyntheticSwitching(**self.options), self.initial)

    def label(self, which: str, index: int) -> int:
        return index if self.options.get(which) is None else int(self.options[which][index])

    def score(self, plan: Any) -> float:
        """Value of a plan by the rule, in words: who held what is a set of (real agent, real task)."""
        held = None
        if self.initial is not None:
            held = {(self.label("agent_of", i), self.label("task_of", j)) for i, j in enumerate(self.initial)}
        total = 0.0
        for k, row in enumerate(plan):
            now = set()
            for i, j in enumerate(row):
                b = self.benefits[k, i, j]
                total += b
                pair = (self.label("agent_of", i), self.label("task_of", j))
                if held is not None and pair not in held and (b > 0 or not self.options["idle_is_free"]):
                    total -= self.options["cost"] + self.options["forfeit"] * max(b, 0.0)
                if b > 0 or not self.options["needs_sight"]:
                    now.add(pair)
            held = now
        return float(total)

    def best(self) -> float:
        """Value of the best of all plans."""
        steps, n, m = self.benefits.shape
        rows = list(permutations(range(m), n))
        return max(self.score(plan) for plan in product(rows, repeat=steps))


@st.composite
def cases(draw: Any, plans: int = 10**9, groups: bool | None = None) -> Case:
    """Small problems with and without copies of agents and tasks."""
    steps, n, m = draw(sizes(plans, (3, 3, 4)))
    benefits = draw(arrays((steps, n, m), draw(st.sampled_from([quarters, sparse_quarters]))))
    grouped = draw(st.booleans()) if groups is None else groups
    options = {
        "cost": draw(st.sampled_from([0.0, 0.5, 1.25])),
        "forfeit": draw(st.sampled_from([0.0, 0.5, 1.0])),
        "agent_of": [draw(st.integers(0, 1)) for _ in range(n)] if grouped else None,
        "task_of": draw(st.none() | st.lists(st.integers(0, 2), min_size=m, max_size=m)),
        "idle_is_free": draw(st.booleans()),
        "needs_sight": draw(st.booleans()),
    }
    initial = draw(st.none() | st.permutations(range(m)).map(lambda p: tuple(p[:n])))
    return Case(benefits, options, initial)
