"""Rolling windows against enumeration and against the rolling assignment."""

from __future__ import annotations

import numpy as np
import pytest
from switching_problems import optimum, tiny, walking

from sapopt import SAP
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.dual import ascend
from sapopt.running.rollout import rollout
from sapopt.solvers import HAA
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.priced_futures import plan_by_futures
from sapopt.solvers.dual_decomposition.network_plans.rolling_windows import rolling_windows


def prices_of(problem: SAP) -> FloatArray:
    """Settled prices."""
    return ascend(problem.model.path_oracle(problem.benefits, problem.initial_state())).prices


def planned(problem: SAP, prices: FloatArray, **options: object) -> IntArray | None:
    """The plan of the rolling windows, from HAA's."""
    start = rollout(problem, HAA()).plan
    return rolling_windows(Arrays.of(problem), start, prices, np.random.default_rng(0), **options)  # type: ignore[arg-type]


def test_tiny_problems_meet_enumeration() -> None:
    """A window that covers the horizon is solved exactly, up to what its regrets leave out."""
    found = 0
    for seed in range(60):
        problem = tiny(seed)
        plan = planned(problem, prices_of(problem))
        assert plan is not None
        value, best = problem.evaluate(plan).value, optimum(problem)
        assert value <= best + 1e-9
        found += value >= best - 1e-3 * abs(best)
    assert found >= 54


def test_dear_moves_are_planned_better_than_step_by_step() -> None:
    """On average over five small constellations whose moves cost as much as some visits earn."""
    windows = steps = 0.0
    for seed in range(5):
        problem = walking(seed, cost=1.0)
        prices = prices_of(problem)
        plan, other = planned(problem, prices), plan_by_futures(Arrays.of(problem), prices)
        assert plan is not None
        assert other is not None
        windows += problem.evaluate(plan).value
        steps += problem.evaluate(other).value
    assert windows > 1.003 * steps


def test_prices_are_improved_before_every_window_but_the_first() -> None:
    """`reprice` sees the step, what the agents hold, and the prices of the steps to come."""
    problem = walking(0, cost=2.0)
    seen: list[int] = []

    def reprice(k: int, held: IntArray, prices: FloatArray) -> FloatArray:
        assert held.shape == (problem.n,)
        assert len(prices) == problem.T - k
        seen.append(k)
        return prices

    assert planned(problem, prices_of(problem), reprice=reprice) is not None
    assert seen[0] > 0
    assert seen == sorted(set(seen))


@pytest.mark.parametrize("options", [{"seconds": 0.0}, {"stop": lambda: True}])
def test_no_time_no_plan(options: dict[str, object]) -> None:
    """It ends at once, without a plan."""
    problem = walking(0)
    assert planned(problem, prices_of(problem), **options) is None
