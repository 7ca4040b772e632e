"""Agents that work at most so many steps on end, against every plan of small rosters."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from sapopt import SAP, bound, certify, solve, verify
from sapopt.dynamics import AtMostInARow
from sapopt.solvers import HAA, HAAL, DualLookahead, Exact


def value(benefits: Any, plan: Any, most: int, cost: float, worked: Any) -> float:
    """Value of a plan by the definition, -inf if somebody works too long."""
    total = 0.0
    for i in range(benefits.shape[1]):
        days = int(worked[i])
        for k, row in enumerate(plan):
            task = row[i]
            if task < 0 or benefits[k, i, task] == 0:
                days = 0
                continue
            if days == most:
                return -np.inf
            total += benefits[k, i, task] - (cost if days == 0 else 0.0)
            days += 1
    return total


@pytest.mark.parametrize("seed", range(12))
def test_every_plan_of_a_small_roster(seed: int) -> None:
    """The value of every plan is that of the definition, and the optimum the best of them."""
    rng = np.random.default_rng(seed)
    T, n, m = int(rng.integers(1, 6)), 2 if seed % 3 == 0 else 1, 2
    T = min(T, 4) if n == 2 else T
    benefits = np.round(rng.normal(0.8, 0.8, (T, n, m)), 2) * (rng.random((T, n, m)) < 0.8)
    most, cost, worked = int(rng.integers(1, 4)), 0.3, rng.integers(0, 2, n)
    problem = SAP(benefits, AtMostInARow(most, cost, worked), idle=True, capacity=2)
    best = -np.inf
    for flat in itertools.product(range(-1, m), repeat=T * n):
        plan = np.array(flat).reshape(T, n)
        expected = value(benefits, plan, most, cost, worked)
        best = max(best, expected)
        if rng.random() < 0.05:
            try:
                assert problem.evaluate(plan).value == pytest.approx(expected)
            except ValueError as error:
                assert "forbidden" in str(error)  # noqa: PT017  # often there is no error
                assert expected == -np.inf
    result = solve(problem, Exact())
    assert result.value == pytest.approx(best)
    assert bound(problem).value >= best - 1e-9
    assert verify(certify(problem, result), problem)
    for policy in (HAA(), HAAL(2), DualLookahead(3, 10)):
        assert solve(problem, policy).value <= best + 1e-9


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((0,), "most must be a whole number of steps"),
        ((2.5,), "most must be a whole number of steps"),
        ((2, -1.0), "cost must be one finite number"),
        ((2, 0.0, [3, 0]), "worked must be a list of whole numbers in 0..2"),
        ((2, 0.0, [0]), "worked has 1 entries for 2 agents"),
    ],
)
def test_bad_numbers_are_refused(options: Any, said: str) -> None:
    """Each gets one clear line."""
    with pytest.raises(ValueError, match=said):
        SAP(np.ones((2, 2, 3)), AtMostInARow(*options))
