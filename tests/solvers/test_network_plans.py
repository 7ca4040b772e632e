"""What the plan builder of the plain switching rule begins with."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from switching_problems import walking

from sapopt import SAP, SwitchingCost, solve
from sapopt.solvers import DualDecomposition
from sapopt.solvers.dual_decomposition.network_plans import NetworkPlans, builder
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.builder import WHOLE
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
        problem=problem, best=np.tile(np.arange(problem.n), (problem.T, 1)), value=0.0, settled_prices=prices, gap=gap,
        seconds_left=left, rng=np.random.default_rng(0), most_repricings=20, iteration_seconds=1e-4,
        report=lambda phase: False, repricing=lambda count: lambda k, state, later: later,
    )  # fmt: skip
    found = NetworkPlans(Arrays.of(problem), threads=1).rolling(search)  # type: ignore[arg-type]
    assert [phase for phase, _ in found] == phases


def test_the_whole_horizon_is_solved_where_windows_end_below_the_optimum() -> None:
    """9 agents, 12 tasks, 20 steps: `Exact` proves 120.8305, windows of ten steps end at 120.7589."""
    problem = SAP(np.random.default_rng(21).random((20, 9, 12)), SwitchingCost(0.5))
    found = solve(problem, DualDecomposition(), time_limit=40.0, seed=21)
    assert found.value == pytest.approx(120.830456, abs=1e-6)


def test_cells_that_no_better_plan_uses_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The network's reduced cost is the distance between bound and plan, and it is tried again once that has shrunk."""
    problem = walking(0, cost=1.0)
    arrays = Arrays.of(problem)
    plans = NetworkPlans(arrays, threads=1)
    seen: list[float] = []
    whole = builder.restricted_flow

    def network(*options: Any) -> object:
        seen.append(options[6])
        return whole(*options)

    monkeypatch.setattr(builder, "restricted_flow", network)
    best = np.tile(np.arange(problem.n), (problem.T, 1))
    prices = np.zeros((problem.T, problem.m))
    value = arrays.value(best)
    for distance in (4.0, 3.9, 3.0, 0.0):
        search = SimpleNamespace(
            best=best, settled_prices=prices, value=value, bound=value + distance, seconds_left=10.0,
            report=lambda phase: False,
        )  # fmt: skip
        for phase, plan in plans._whole(search):  # type: ignore[arg-type]
            assert phase == WHOLE
            assert arrays.value(plan) >= value - 1e-9
    assert seen == pytest.approx([4.0, 3.0])
