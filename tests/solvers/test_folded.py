"""Problems whose limits fold into a plain one, against every plan, and against the way over the graph."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from sapopt import SAP, Limit, SwitchingCost, bound, certify, solve, verify
from sapopt.formulations.limited import building
from sapopt.solvers import DualDecomposition
from tests.folded_problems import plain


@pytest.fixture
def too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """No graph fits."""
    monkeypatch.setattr(building, "_MOST_ARCS", 0)


def drawn(seed: int, kinds: tuple[str, ...] = ("handovers", "covers", "work", "loose")) -> SAP:
    """A tiny problem with limits that fold."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    m = n + int(rng.integers(0, 2))
    T = 2 if m == 4 else int(rng.integers(2, 5 if n < 3 else 4))
    benefits = np.round(rng.normal(0.3, 1.0, (T, n, m)) * (rng.random((T, n, m)) < 0.6), 2)
    if rng.random() < 0.7:
        benefits = np.abs(benefits)
    limits: list[Any] = []
    for kind in rng.choice(kinds, int(rng.integers(1, 4))):
        if kind == "handovers":
            who = None if rng.random() < 0.5 else [int(rng.integers(n))]
            limits.append(Limit.handovers(int(rng.integers(0, T)), who, each=True))
        elif kind == "covers":
            task, penalty = int(rng.integers(m)), round(float(rng.random()) + 0.1, 2)
            limits.append(Limit.cover(task, 1, served=bool(rng.integers(2)), penalty=penalty))
        elif kind == "work":  # more than anybody can do, and what is not wanted at all
            limits.append(Limit.work(at_least=T, penalty=0.3))
            limits.append(Limit(rng.integers(0, 3, (T, n, m)), at_most=0, penalty=0.2))
        else:
            limits.append(Limit.work(at_most=T))
    initial = rng.permutation(m)[:n] if rng.random() < 0.5 else None
    cost = round(float(rng.random()), 2)
    return SAP(benefits, SwitchingCost(cost), initial, limits=limits)


def optimum(problem: SAP) -> float:
    """The best value of all plans that keep the hard limits."""
    best = -math.inf
    for steps in itertools.product(itertools.permutations(range(problem.m), problem.n), repeat=problem.T):
        try:
            best = max(best, problem.evaluate(np.array(steps)).value)
        except ValueError:
            continue
    return best


@pytest.mark.parametrize("seed", range(30))
def test_a_plan_is_worth_the_same(seed: int) -> None:
    """A plan within the limits is worth as much in the plain problem, less what is paid anyhow; others break one."""
    problem = drawn(seed)
    found, rng = plain(problem), np.random.default_rng(seed)
    for _ in range(20):
        plan = np.array([rng.permutation(problem.m)[: problem.n] for _ in range(problem.T)])
        value = found.problem.evaluate(plan).value - found.paid
        if (found.take_ups(plan) <= found.most).all():
            assert problem.evaluate(plan).value == pytest.approx(value, abs=1e-9)
        else:
            with pytest.raises(ValueError, match="above at_most"):
                problem.evaluate(plan)


def check(problem: SAP) -> float:
    """Compare plan, bound and certificate with the optimum; what the plan lacks."""
    best = optimum(problem)
    result = solve(problem, DualDecomposition(iterations=300, rounds=2, sweeps=5), seed=1)
    assert result.bound is not None
    assert result.bound >= best - 1e-12
    assert result.value <= best + 1e-9
    proven = bound(problem)
    assert proven.value >= best - 1e-12
    certificate = certify(problem, result)
    assert certificate.bound >= best - 1e-12
    assert certificate.bound <= result.bound + 1e-6
    assert verify(certificate, problem).value <= best + 1e-9
    return best - result.value


@pytest.mark.usefixtures("too_large")
@pytest.mark.parametrize("seed", range(6))
def test_against_all_plans(seed: int) -> None:
    """No bound is below the optimum, no plan breaks a limit, and certificates hold on the whole problem."""
    check(drawn(seed))


@pytest.mark.slow
@pytest.mark.usefixtures("too_large")
@pytest.mark.parametrize("first", range(0, 300, 50))
def test_hundreds_against_all_plans(first: int) -> None:
    """The same for hundreds; nearly all plans are the best."""
    lacks = [check(drawn(seed)) for seed in range(first, first + 50)]
    assert np.mean(np.array(lacks) < 1e-6) > 0.8
