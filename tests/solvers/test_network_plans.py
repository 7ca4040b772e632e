"""What the plan builder of the plain switching rule begins with."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from switching_problems import walking

from sapopt.solvers.dual_decomposition.network_plans import NetworkPlans
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.plans import REPRICED, ROLLING


@pytest.mark.parametrize(
    ("gap", "left", "phases"),
    [
        (0.001, 60.0, [ROLLING]),
        (0.001, math.inf, [ROLLING, REPRICED]),
        (0.015, 60.0, [ROLLING, REPRICED]),
        (0.1, 60.0, [ROLLING, "rolling windows"]),
    ],
)
def test_the_gap_of_the_first_plan_says_what_comes_next(gap: float, left: float, phases: list[str]) -> None:
    """Windows of the plan at once, prices improved on the way, or rolling windows; without a clock never the first."""
    problem = walking(0, cost=1.0)
    prices = np.zeros((problem.T, problem.m))
    search = SimpleNamespace(
        problem=problem, best=np.tile(np.arange(problem.n), (problem.T, 1)), settled_prices=prices, gap=gap,
        seconds_left=left, rng=np.random.default_rng(0), most_repricings=20, iteration_seconds=1e-4,
        report=lambda phase: False, repricing=lambda count: lambda k, state, later: later,
    )  # fmt: skip
    found = NetworkPlans(Arrays.of(problem), threads=1).rolling(search)  # type: ignore[arg-type]
    assert [phase for phase, _ in found] == phases
