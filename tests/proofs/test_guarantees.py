"""The a-priori guarantees: against brute force on small problems, and the known counterexamples."""

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, SwitchingCost, solve
from sapopt.proofs.guarantees import guarantee
from sapopt.solvers import HAA, HAAL

KNOWN = json.loads((Path(__file__).parents[1] / "data" / "theorem_counterexamples.json").read_text())[
    "instances"
]


def plans(problem: SAP) -> itertools.product:
    """All plans of a tiny problem."""
    return itertools.product(list(itertools.permutations(range(problem.m), problem.n)), repeat=problem.T)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 2), st.integers(1, 3), st.booleans())
def test_the_ratios_hold_for_what_they_cover(seed: int, n: int, steps: int, start: bool) -> None:
    """HAA and HAAL(2) reach both ratios of the optimum by brute force; refined >= c / (1 + c)."""
    rng = np.random.default_rng(seed)
    initial = rng.permutation(3)[:n] if start else None
    problem = SAP(rng.integers(0, 8, (steps, n, 3)).astype(float), SwitchingCost(rng.integers(0, 6)), initial)
    optimum = max(problem.evaluate(np.array(plan)).value for plan in plans(problem))
    promise = guarantee(problem)
    assert promise.refined_ratio >= promise.ratio - 1e-12
    for solver in (HAA(), HAAL(2)):
        assert promise.covers(solver)
        assert solve(problem, solver).value >= promise.refined_ratio * optimum - 1e-9
    assert not promise.covers(HAAL(3))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(3, 5))
def test_least_benefit_is_exact(seed: int, n: int, m: int) -> None:
    """B is the least value over all assignments and steps, for dense and sparse forms."""
    rng = np.random.default_rng(seed)
    benefits = rng.integers(0, 4, (2, n, m)) * rng.integers(0, 2, (2, n, m))
    agents = np.arange(n)
    least = min(step[agents, list(x)].sum() for step in benefits for x in itertools.permutations(range(m), n))
    for form in (benefits, [sp.csr_array(step) for step in benefits]):
        promise = guarantee(SAP(form, SwitchingCost(1.0)))
        assert promise.least_benefit == least
        assert promise.least_benefit_by_entry == n * benefits.min() <= least
        assert promise.handover_size == n


@pytest.mark.parametrize("known", [x for x in KNOWN if "benefits" in x and "c" in x], ids=lambda x: x["name"])
def test_c_of_the_known_instances(known: dict) -> None:
    """c is what the published counterexamples state."""
    if not isinstance(known.get("cost"), (int, float)):
        pytest.fail(f"{known['name']} states no single cost")
    problem = SAP(known["benefits"], SwitchingCost(known["cost"]), known["initial_assignment"])
    assert guarantee(problem).c == pytest.approx(known["c"])


def test_conditions_of_the_switching_cost() -> None:
    """Strict where every move costs; not where idling or a pair of tasks is free."""
    benefits = np.ones((2, 2, 3))
    free = np.ones((3, 3)) - np.eye(3)
    free[0, 1] = 0.0
    for dynamics, strict in (
        (SwitchingCost(1.0), "yes"), (SwitchingCost(0.0), "no"), (SwitchingCost(1.0, idle_is_free=True), "no"),
        (SwitchingCost(free), "no"), (SwitchingCost(np.ones((3, 3)) - np.eye(3)), "yes"),
    ):  # fmt: skip
        conditions = guarantee(SAP(benefits, dynamics)).conditions
        assert (conditions.vanishing, conditions.strict_penalty, conditions.assignment_dominated) == (
            "yes",
            strict,
            "yes",
        )
    assert guarantee(SAP(benefits, SwitchingCost(0.0))).c == math.inf


class Tired:
    """Every agent loses 1 from its second step on the same task, and the state counts the steps."""

    handover_limit = 0.0

    def __init__(self, tiring: bool) -> None:
        self.tiring = tiring

    def initial_state(self, problem: SAP) -> tuple:
        return ((), 0)

    def handover(self, k: int, state: tuple) -> np.ndarray:
        eta = np.full((2, 3), 0.0 if not state[0] else -2.0)
        for i, j in enumerate(state[0]):
            eta[i, j] = -1.0 * self.tiring
        return eta

    def transition(self, k: int, state: tuple, assignment: np.ndarray) -> tuple:
        return (tuple(int(j) for j in assignment), (state[1] + 1) * self.tiring)

    def key(self, state: tuple) -> tuple:
        return state


def test_conditions_of_a_user_are_enumerated() -> None:
    """A small user-defined model is decided by visiting its states; without a size of handovers nothing is promised."""
    tired = guarantee(SAP(np.ones((3, 2, 3)), Tired(True))).conditions
    assert (tired.vanishing, tired.strict_penalty, tired.assignment_dominated) == ("no", "yes", "yes")
    plain = guarantee(SAP(np.ones((3, 2, 3)), Tired(False)))
    assert (plain.conditions.vanishing, plain.conditions.strict_penalty) == ("yes", "yes")
    assert plain.conditions.assignment_dominated == "yes"
    assert math.isnan(plain.c)
    assert plain.ratio == 0.0


def test_forbidden_pairs_and_negative_benefits() -> None:
    """B counts allowed assignments only; negative values promise nothing."""
    benefits = np.array([[[-np.inf, 2.0, 3.0], [1.0, 5.0, -np.inf]]])
    promise = guarantee(SAP(benefits, SwitchingCost(1.0)))
    assert promise.least_benefit == 3.0
    negative = guarantee(SAP(benefits - 4.0, SwitchingCost(1.0)))
    assert negative.ratio == 0.0
    assert math.isnan(negative.c)
