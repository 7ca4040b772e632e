"""Windows in which agents idle wherever there is room, against the exact method and by what any plan must keep."""

from __future__ import annotations

import numpy as np
import pytest
from switching_problems import crowded, settled

from sapopt import SAP, SwitchingCost, solve
from sapopt.running.rollout import rollout
from sapopt.solvers import HAA, Exact
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.flow_programme import solve_flow
from sapopt.solvers.dual_decomposition.network_plans.idle_places import IdlePlaces, idle_flow, idles_freely
from sapopt.solvers.dual_decomposition.network_plans.rolling_windows import rolling_windows
from sapopt.solvers.dual_decomposition.network_plans.window_search import Effort, improve_window


@pytest.mark.parametrize("seed", range(24))
def test_the_whole_horizon_is_exact(seed: int) -> None:
    """One window over all steps, which leaves nothing out, is the problem, whether tasks are spare or not."""
    n = 4 + seed % 3
    problem = crowded(seed, n, n + seed % 2, 6, share=0.4, idle_is_free=True)
    arrays, prices = Arrays.of(problem), settled(problem)
    plan, agents = rollout(problem, HAA()).plan, np.arange(n)
    flow = idle_flow(arrays, plan, prices, agents, 0, problem.T, 1e6)
    places = IdlePlaces.of(arrays, plan, 0, problem.T)
    found = solve_flow(flow, plan, problem.m, places=places)
    assert found is not None
    assert problem.evaluate(found).value == pytest.approx(solve(problem, Exact()).value, abs=2e-3)


@pytest.mark.parametrize("seed", range(40))
def test_windows_are_plans_and_lose_nothing(seed: int) -> None:
    """For all agents at once, and for groups of them where the network is too large."""
    rng = np.random.default_rng(seed)
    n, steps = int(rng.integers(10, 25)), int(rng.integers(4, 20))
    problem = crowded(seed, n, n + 3 * (seed % 2), steps, idle_is_free=True)
    arrays, prices = Arrays.of(problem), settled(problem)
    assert idles_freely(arrays)
    plan = rollout(problem, HAA()).plan
    for turn in range(4):
        length = int(rng.integers(2, steps + 1))
        first = int(rng.integers(0, steps - length + 1))
        effort = Effort(length, [60_000, 300, 100][turn % 3])
        found = improve_window(arrays, plan, prices, effort, first, first + length, seed, lambda: np.inf)
        kept = np.r_[0:first, first + length : steps]
        np.testing.assert_array_equal(found[kept], plan[kept])
        assert problem.evaluate(found).value >= problem.evaluate(plan).value - 1e-9
        plan = found


def test_rolling_windows_are_nearly_exact() -> None:
    """Against the exact method, of problems whose horizon is longer than a window."""
    found = best = 0.0
    for seed in range(12):
        problem = crowded(seed, 5, 6, 14, share=0.6, idle_is_free=True)
        start = rollout(problem, HAA()).plan
        plan = rolling_windows(Arrays.of(problem), start, settled(problem), np.random.default_rng(0))
        assert plan is not None
        value, optimum = problem.evaluate(plan).value, solve(problem, Exact()).value
        assert value <= optimum + 1e-6
        found, best = found + value, best + optimum
    assert found >= 0.98 * best


def test_who_idles_stays_where_it_may() -> None:
    """Else on a task that is left and on which it earns nothing, though it could earn something on another."""
    benefits = np.zeros((2, 2, 4))
    benefits[:, 0, 0] = 1.0
    benefits[1, 1, 1] = 0.1
    arrays = Arrays.of(SAP(benefits, SwitchingCost(0.5, idle_is_free=True), np.array([0, 3])))
    places = IdlePlaces.of(arrays, np.zeros((2, 2), np.int64), 0, 2)
    np.testing.assert_array_equal(places.placed(np.array([[0, 4], [0, 4]]), np.zeros(0)), [[0, 3], [0, 3]])
    places = IdlePlaces(arrays, 0, 2, np.array([0, 1]))
    np.testing.assert_array_equal(places.placed(np.array([[0, 4], [0, 4]]), np.zeros(0)), [[0, 1], [0, 2]])


def test_where_it_does_not_apply() -> None:
    """Not where idling costs a move, and not where most pairs are worth something."""
    assert not idles_freely(Arrays.of(crowded(0, 20, 20, 6)))
    dense = np.random.default_rng(0).random((6, 20, 20))
    assert not idles_freely(Arrays.of(SAP(dense, SwitchingCost(0.5, idle_is_free=True))))
