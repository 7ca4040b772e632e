"""Windows in which agents wait wherever there is room, against the exact method and by what any plan must keep."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import SAP, SwitchingCost, solve
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.dual import ascend
from sapopt.running.rollout import rollout
from sapopt.solvers import HAA, DualDecomposition, Exact
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.flow_programme import solve_flow
from sapopt.solvers.dual_decomposition.network_plans.rolling_windows import rolling_windows
from sapopt.solvers.dual_decomposition.network_plans.rounds import Rounds
from sapopt.solvers.dual_decomposition.network_plans.waiting_places import (
    Places,
    can_wait,
    wait_anywhere,
    waiting_flow,
)
from sapopt.solvers.dual_decomposition.network_plans.window_search import Effort, improve_window


def crowded(seed: int, n: int, m: int, steps: int, share: float = 0.15, **options: object) -> SAP:
    """Few visits of some steps, and hardly a spare task to wait on."""
    rng = np.random.default_rng(seed)
    benefits = np.zeros((steps, n, m))
    for _ in range(int(share * n * m)):
        first = rng.integers(steps)
        benefits[first : first + rng.integers(1, 5), rng.integers(n), rng.integers(m)] = rng.random()
    cost = float(rng.choice([0.2, 0.5, 1.0]))
    initial = rng.permutation(m)[:n] if seed % 2 else None
    return SAP(benefits, SwitchingCost(cost, **options), initial)  # type: ignore[arg-type]


def settled(problem: SAP) -> FloatArray:
    """Prices."""
    return ascend(problem.model.path_oracle(problem.benefits, problem.initial_state())).prices


@pytest.mark.parametrize("seed", range(24))
def test_the_whole_horizon_is_exact(seed: int) -> None:
    """One window over all steps, which leaves nothing out, is the problem."""
    n = 4 + seed % 3
    problem = crowded(seed, n, n + seed % 2, 6, share=0.4)
    arrays, prices = Arrays.of(problem), settled(problem)
    plan, agents = rollout(problem, HAA()).plan, np.arange(n)
    flow = waiting_flow(arrays, plan, prices, agents, 0, problem.T, 1e6)
    places = Places.of(arrays, flow, plan, prices, agents, 0, problem.T, 1e6)
    found = solve_flow(flow, plan, problem.m, places=places)
    assert found is not None
    best = solve(problem, Exact()).value
    assert problem.evaluate(found).value == pytest.approx(best, abs=2e-3)


@pytest.mark.parametrize("seed", range(40))
def test_windows_are_plans_and_lose_nothing(seed: int) -> None:
    """For all agents at once, and for groups of them where the network is too large."""
    rng = np.random.default_rng(seed)
    n, steps = int(rng.integers(10, 25)), int(rng.integers(4, 14))
    problem = crowded(seed, n, n + seed % 2, steps)
    arrays, prices = Arrays.of(problem), settled(problem)
    assert wait_anywhere(arrays)
    plan = rollout(problem, HAA()).plan
    for turn in range(4):
        length = int(rng.integers(2, min(steps, 10) + 1))
        first = int(rng.integers(0, steps - length + 1))
        effort = Effort(length, [60_000, 300, 100][turn % 3])
        found = improve_window(arrays, plan, prices, effort, first, first + length, seed, lambda: np.inf)
        kept = np.r_[0:first, first + length : steps]
        np.testing.assert_array_equal(found[kept], plan[kept])
        assert problem.evaluate(found).value >= problem.evaluate(plan).value - 1e-9
        plan = found


def test_they_gain_more_than_a_few_places_at_random(monkeypatch: pytest.MonkeyPatch) -> None:
    """On average, with as many tasks as agents: the same windows with random tasks to wait on gain less than half."""

    def gained(problem: SAP, plan: IntArray, prices: FloatArray) -> float:
        before = problem.evaluate(plan).value
        for first in (0, 3, 6, 9):
            plan = improve_window(
                Arrays.of(problem), plan, prices, Effort(6, 60_000), first, min(first + 6, problem.T), 0, lambda: np.inf
            )  # fmt: skip
        return problem.evaluate(plan).value - before

    module = "sapopt.solvers.dual_decomposition.network_plans.window_search"
    anywhere = at_random = 0.0
    for seed in range(6):
        problem = crowded(seed, 60, 60, 12, share=0.1)
        prices, start = settled(problem), solve(problem, DualDecomposition(rounds=0, sweeps=0)).plan
        anywhere += gained(problem, start, prices)
        with monkeypatch.context() as patch:
            patch.setattr(f"{module}.wait_anywhere", lambda arrays: False)
            at_random += gained(problem, start, prices)
    assert anywhere > 2.0 * at_random + 0.3


def ahead(problem: SAP, prices: FloatArray) -> IntArray:
    """The plan of rolling windows, from HAA's."""
    start = rollout(problem, HAA()).plan
    plan = rolling_windows(Arrays.of(problem), start, prices, np.random.default_rng(0))
    assert plan is not None
    return plan


@pytest.mark.parametrize("spare", [0, 2])
def test_rolling_windows_with_places_are_nearly_exact(spare: int) -> None:
    """Against the exact method, of problems whose horizon is longer than a window."""
    found = best = 0.0
    for seed in range(12):
        problem = crowded(seed, 5, 5 + spare, 14, share=0.6)
        assert can_wait(Arrays.of(problem))
        value, optimum = (
            problem.evaluate(ahead(problem, settled(problem))).value,
            solve(problem, Exact()).value,
        )
        assert value <= optimum + 1e-6
        found, best = found + value, best + optimum
    assert found >= 0.98 * best


@pytest.mark.parametrize("spare", [2, 8])
def test_rolling_windows_gain_by_places(spare: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """On average they lose less than half as much against the bound as with a few tasks drawn at random."""
    module = "sapopt.solvers.dual_decomposition.network_plans.rolling_windows"
    lost = at_random = 0.0
    for seed in range(4):
        problem = crowded(seed, 30, 30 + spare, 16, share=0.15)
        dual = ascend(problem.model.path_oracle(problem.benefits, problem.initial_state()))
        lost += dual.bound - problem.evaluate(ahead(problem, dual.prices)).value
        with monkeypatch.context() as patch:
            patch.setattr(f"{module}.can_wait", lambda arrays: False)
            at_random += dual.bound - problem.evaluate(ahead(problem, dual.prices)).value
    assert 0.0 < 2.0 * lost < at_random


def test_thousands_of_agents_have_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a size that can be tested: with a clock windows improve the plan; without, it is planned again."""
    monkeypatch.setattr("sapopt.solvers.dual_decomposition.solver._LARGE", 0)
    problem = crowded(3, 60, 60, 12, share=0.3)
    method = DualDecomposition(iterations=30, tolerance=0.0)

    def phases(limit: float | None) -> set[str]:
        return {line["phase"] for line in solve(problem, method, time_limit=limit).trace}

    assert any(phase.startswith("windows") for phase in phases(3.0))
    assert not any("windows" in phase for phase in phases(None))


def test_thousands_of_agents_have_as_many_rounds_as_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """One round of windows for each, though there is time for many."""
    monkeypatch.setattr("sapopt.solvers.dual_decomposition.solver._LARGE", 0)
    rounds: list[Effort] = []
    learn = Rounds.learn

    def counted(self: Rounds, effort: Effort, gain: float, seconds: float) -> None:
        rounds.append(effort)
        learn(self, effort, gain, seconds)

    monkeypatch.setattr(Rounds, "learn", counted)
    method = DualDecomposition(iterations=30, tolerance=0.0, rounds=1)
    solve(crowded(3, 60, 60, 12, share=0.3), method, time_limit=3.0)
    assert len(rounds) == 1


def test_where_it_does_not_apply() -> None:
    """Not where tasks are spare, where idling is free, where costs differ, or where most pairs are worth something."""
    assert wait_anywhere(Arrays.of(crowded(0, 20, 20, 6)))
    assert not wait_anywhere(Arrays.of(crowded(0, 20, 30, 6)))
    assert can_wait(Arrays.of(crowded(0, 20, 30, 6)))
    assert not can_wait(Arrays.of(crowded(0, 20, 20, 6, idle_is_free=True)))
    assert not can_wait(Arrays.of(SAP(np.random.default_rng(0).random((6, 20, 20)), SwitchingCost(0.5))))
    costs = SAP(crowded(0, 20, 20, 6).benefits, SwitchingCost(1.0 - np.eye(20)))
    assert not can_wait(Arrays.of(costs))
