"""Jobs that keep an agent busy, against every plan of small problems."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from sapopt import SAP, Limit, bound, certify, solve, verify
from sapopt.dynamics import Jobs
from sapopt.solvers import HAA, DualLookahead, Exact


def value(benefits: Any, plan: Any, length: Any, cost: float) -> float:
    """Value of a plan by the definition, -inf if a busy agent begins something, or a task is begun twice."""
    total, (T, n, _) = 0.0, benefits.shape
    for i in range(n):
        free = 0
        for k in range(T):
            task = plan[k][i]
            if task < 0 or benefits[k, i, task] == 0:
                continue
            if free > k:
                return -np.inf
            total += benefits[k, i, task] - cost
            free = k + length[k, i, task]
    return total


@pytest.mark.parametrize("seed", range(12))
def test_every_plan_of_a_few_jobs(seed: int) -> None:
    """The value of every plan is that of the definition; with each job once, the optimum is the best of them."""
    rng = np.random.default_rng(seed)
    n, m = (2, 2) if seed % 3 == 0 else (1, 3)
    T = 3 if n == 2 else int(rng.integers(1, 6))
    benefits = np.round(rng.normal(0.8, 0.8, (T, n, m)), 2) * (rng.random((T, n, m)) < 0.8)
    given = rng.integers(1, 4, [(m,), (n, 1), (T, n, m), (1, 1, m)][seed % 4])
    length, cost = np.broadcast_to(given, (T, n, m)), 0.1
    problem = SAP(benefits, Jobs(given, cost), idle=True, limits=[Limit.once()])
    best = -np.inf
    for flat in itertools.product(range(-1, m), repeat=T * n):
        plan = np.array(flat).reshape(T, n)
        if any((row == j).sum() > 1 for row in plan for j in range(m)):
            continue
        expected = value(benefits, plan, length, cost)
        for j in range(m):
            if sum(benefits[k, i, j] > 0 for k in range(T) for i in range(n) if plan[k, i] == j) > 1:
                expected = -np.inf
        best = max(best, expected)
        if rng.random() < 0.05:
            try:
                assert problem.evaluate(plan).value == pytest.approx(expected)
            except ValueError as error:
                assert "forbidden" in str(error) or "limit" in str(error)  # noqa: PT017  # often there is no error
                assert expected == -np.inf
    result = solve(problem, Exact())
    assert result.value == pytest.approx(best)
    assert bound(problem).value >= best - 1e-9
    assert verify(certify(problem, result), problem)
    for policy in (HAA(), DualLookahead(3, 10)):
        assert solve(problem, policy).value <= best + 1e-9


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (([0, 1, 1],), "length must be whole numbers of at least 1"),
        (([1, 1],), "does not broadcast"),
        (([[1], [1], [1]],), "does not broadcast"),
        ((1, -1.0), "cost must be one finite number"),
    ],
)
def test_bad_numbers_are_refused(options: Any, said: str) -> None:
    """Each gets one clear line."""
    with pytest.raises(ValueError, match=said):
        SAP(np.ones((2, 2, 3)), Jobs(*options))
