"""Small random problems, and a reference that scores and enumerates plans by the definition alone.

Nothing here calls the code under test, except `Instance.problem`, which builds the problem to be tested.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st

from sapopt import SAP, Benefits, SwitchingCost

FORMS = ("dense", "sparse", "function", "sparse function")


@dataclass(frozen=True, eq=False)
class Instance:
    """A problem as plain arrays."""

    benefits: np.ndarray  # (T, n, m)
    cost: Any = 0.0  # number or (m, m)
    idle_is_free: bool = False
    initial: tuple[int, ...] | None = None

    def problem(self, form: str = "dense") -> SAP:
        """The same numbers in one of FORMS."""
        return SAP(as_form(self.benefits, form), SwitchingCost(self.cost, self.idle_is_free), self.initial)

    def charge(self, k: int, agent: int, before: int | None, task: int) -> float:
        """What agent pays for holding `task` at step k after `before`."""
        if before is None or before == task or (self.idle_is_free and not self.benefits[k, agent, task] > 0):
            return 0.0
        return float(self.cost if np.ndim(self.cost) == 0 else self.cost[before][task])

    def step_values(self, plan: Any) -> tuple[list[float], list[float], int]:
        """Benefit and charge of every step, and the number of changes, of a plan (T, n)."""
        benefit, charge, changes = [], [], 0
        before: Any = [None] * len(plan[0]) if self.initial is None else self.initial
        for k, row in enumerate(plan):
            benefit.append(math.fsum(self.benefits[k, i, j] for i, j in enumerate(row)))
            charge.append(math.fsum(self.charge(k, i, before[i], j) for i, j in enumerate(row)))
            changes += sum(b is not None and b != j for b, j in zip(before, row, strict=True))
            before = row
        return benefit, charge, changes

    def score(self, plan: Any) -> float:
        """Value of a plan by eq. 2.1 to 2.4."""
        benefit, charge, _ = self.step_values(plan)
        return math.fsum(benefit) - math.fsum(charge)

    def best(self) -> float:
        """Value of the best of all plans, by enumeration; -inf if forbidden pairs leave none."""
        steps, n, m = self.benefits.shape
        rows = list(itertools.permutations(range(m), n))

        def from_step(k: int, before: tuple[int, ...] | None, so_far: float) -> float:
            if k == steps:
                return so_far
            held: Any = [None] * n if before is None else before
            top = -math.inf
            for row in rows:
                worth = sum(self.benefits[k, i, j] - self.charge(k, i, held[i], j) for i, j in enumerate(row))
                if worth > -math.inf:
                    top = max(top, from_step(k + 1, row, so_far + worth))
            return top

        return from_step(0, self.initial, 0.0)


def as_form(benefits: np.ndarray, form: str) -> Any:
    """A (T, n, m) array in one of FORMS."""
    if form == "dense":
        return benefits
    if form == "sparse":
        return [sp.csr_array(step) for step in benefits]
    wrap: Callable[[np.ndarray], Any] = sp.csr_array if form == "sparse function" else np.array
    return Benefits.from_function(lambda k: wrap(benefits[k]), benefits.shape)


def full_assignment_exists(allowed: np.ndarray) -> bool:
    """Whether an (n, m) mask admits a full assignment, by trying all."""
    n, m = allowed.shape
    return any(all(allowed[i, j] for i, j in enumerate(row)) for row in itertools.permutations(range(m), n))


# Quarters are exact in binary: sums in any order are equal, and ties are true ties.
quarters = st.integers(-8, 16).map(lambda x: x / 4)
sparse_quarters = st.one_of(st.just(0.0), st.just(0.0), st.integers(0, 12).map(lambda x: x / 4))


@st.composite
def arrays(draw: Any, shape: tuple[int, ...], elements: st.SearchStrategy[float]) -> np.ndarray:
    """Arrays of a shape with drawn elements."""
    count = math.prod(shape)
    return np.array(draw(st.lists(elements, min_size=count, max_size=count)), dtype=np.float64).reshape(shape)


@st.composite
def sizes(draw: Any, plans: int = 10**9, most: tuple[int, int, int] = (4, 4, 6)) -> tuple[int, int, int]:
    """Sizes (T, n, m) with n <= m and at most `plans` plans."""
    n = draw(st.integers(1, most[1]))
    m = draw(st.integers(n, most[2]))
    steps = draw(st.integers(1, most[0]))
    while steps > 1 and math.perm(m, n) ** steps > plans:
        steps -= 1
    return steps, n, m


@st.composite
def instances(
    draw: Any, plans: int = 10**9, most: tuple[int, int, int] = (4, 4, 6), forbid: bool = False
) -> Instance:
    """Problems with every form of the switching cost, dense or with many zeros, with and without an initial task."""
    steps, n, m = shape = draw(sizes(plans, most))
    elements = draw(st.sampled_from([quarters, sparse_quarters]))
    benefits = draw(arrays(shape, elements))
    if forbid:
        for k in range(steps):
            mask = draw(arrays((n, m), st.sampled_from([0.0, 0.0, 1.0]))) > 0
            # An assignment that stays allowed keeps the step feasible.
            mask[np.arange(n), draw(st.permutations(range(m)))[:n]] = False
            benefits[k][mask] = -np.inf
    cost: Any = draw(st.sampled_from([0.0, 0.25, 1.0, 5.0]))
    if draw(st.booleans()):
        cost = draw(arrays((m, m), st.integers(0, 6).map(lambda x: x / 4)))
        np.fill_diagonal(cost, 0.0)
    initial = draw(st.none() | st.permutations(range(m)).map(lambda p: tuple(p[:n])))
    return Instance(benefits, cost, draw(st.booleans()), initial)


@st.composite
def plans_of(draw: Any, shape: tuple[int, int, int]) -> np.ndarray:
    """Plans (T, n) without a task taken twice."""
    steps, n, m = shape
    return np.array([draw(st.permutations(range(m)))[:n] for _ in range(steps)])


def random_instances(count: int, seed: int, steps: int, n: int, m: int) -> Iterator[Instance]:
    """Tie-free instances of one size; the cost alternates between a number and a matrix."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        cost: Any = 0.3
        if index % 2:
            cost = rng.random((m, m))
            np.fill_diagonal(cost, 0.0)
        initial = tuple(int(j) for j in rng.permutation(m)[:n]) if index % 3 else None
        yield Instance(rng.random((steps, n, m)), cost, index % 4 > 1, initial)
