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
from own_conditions import Tired

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
    assert not promise.covers(HAAL(2, exact_intervals=True))
    assert promise.covers(HAAL(3, keep_plan=True, exact_intervals=True))


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
        assert promise.handover_size == n  # m >= 3, so that all n can move at once


@pytest.mark.parametrize("known", [x for x in KNOWN if "benefits" in x and "c" in x], ids=lambda x: x["name"])
def test_c_of_the_known_instances(known: dict) -> None:
    """c is what the published counterexamples state."""
    if not isinstance(known.get("cost"), (int, float)):
        pytest.fail(f"{known['name']} states no single cost")
    problem = SAP(known["benefits"], SwitchingCost(known["cost"]), known["initial_assignment"])
    assert guarantee(problem).c == pytest.approx(known["c"])


def test_nothing_is_promised_where_pairs_are_forbidden() -> None:
    """An agent that may not stay can be made to pay more than the theorem allows for; the reason is given."""
    problem = SAP([[[1, 1.1]], [[1, -np.inf]]], 10.0)
    promise = guarantee(problem)
    assert solve(problem, HAA()).value == pytest.approx(-7.9)
    assert promise.ratio == promise.refined_ratio == 0.0
    assert not promise.covers(HAA())
    assert "some pairs are forbidden" in promise.statement


class Staying:
    """One agent that is paid for staying, and pays for a move; the state is the task it held."""

    handover_limit, handover_floor = 1.0, -2.0

    def initial_state(self, problem: SAP) -> int:
        return 0

    def handover(self, k: int, state: int) -> np.ndarray:
        eta = np.full((1, 3), -2.0)
        eta[0, state] = 1.0
        return eta

    def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
        return int(assignment[0])


class EveryStepCharged(Staying):
    """The same, but the first step charges every task: nobody held anything."""

    handover_limit, handover_floor = 1.0, -2.0

    def handover(self, k: int, state: int) -> np.ndarray:
        return np.full((1, 3), -2.0) if k == 0 else super().handover(k, state)


def test_staying_may_pay() -> None:
    """Definition 3.5.1 asks for eta >= 0 at the task that is kept: a bonus is no obstacle; |H| is its full range."""
    rng = np.random.default_rng(5)
    for _ in range(30):
        problem = SAP(rng.integers(3, 9, (3, 1, 3)), Staying())
        promise = guarantee(problem)
        assert promise.applies
        assert promise.handover_size == 3.0
        assert promise.c == promise.least_benefit / 3.0
        optimum = max(problem.evaluate(np.array(plan)).value for plan in plans(problem))
        for solver in (HAA(), HAAL(2), HAAL(3, keep_plan=True)):
            assert solve(problem, solver).value >= max(promise.ratio, promise.refined_ratio) * optimum - 1e-9


def test_a_first_step_that_charges_everything_is_no_start() -> None:
    """The proof compares with staying, at the first step too; where that is impossible nothing is promised."""
    promise = guarantee(SAP(np.ones((3, 1, 3)), EveryStepCharged()))
    assert promise.conditions.vanishing == "yes"
    assert promise.conditions.fair_start == "no"
    assert promise.ratio == 0.0


def test_without_a_size_of_handovers_nothing_is_promised() -> None:
    """A user's dynamics that does not say what handovers can cost."""
    promise = guarantee(SAP(np.ones((3, 2, 3)), Tired(False)))
    assert promise.conditions.vanishing == "yes"
    assert math.isnan(promise.c)
    assert promise.ratio == 0.0
    assert "does not say how much handovers can cost" in promise.statement


def test_forbidden_pairs_and_negative_benefits() -> None:
    """B counts allowed assignments only; negative values promise nothing."""
    benefits = np.array([[[-np.inf, 2.0, 3.0], [1.0, 5.0, -np.inf]]])
    promise = guarantee(SAP(benefits, SwitchingCost(1.0)))
    assert promise.least_benefit == 3.0
    negative = guarantee(SAP(benefits - 4.0, SwitchingCost(1.0)))
    assert negative.ratio == 0.0
    assert math.isnan(negative.c)
