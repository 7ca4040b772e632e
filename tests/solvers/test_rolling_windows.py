"""Rolling windows against enumeration and against the rolling assignment."""

from __future__ import annotations

import numpy as np
import pytest
from switching_problems import optimum, tiny, walking

from sapopt import SAP
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.dual import ascend
from sapopt.kernels import clock
from sapopt.running.rollout import rollout
from sapopt.solvers import HAA
from sapopt.solvers.dual_decomposition.network_plans import rolling_windows as module
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


@pytest.mark.parametrize(("cost", "seeds", "gain"), [(1.0, 5, 1.001), (3.0, 10, 1.01)])
def test_dear_moves_are_planned_better_than_step_by_step(cost: float, seeds: int, gain: float) -> None:
    """On average over small constellations whose moves cost as much as some visits earn, or more than most."""
    windows = steps = 0.0
    for seed in range(seeds):
        problem = walking(seed, cost=cost)
        prices = prices_of(problem)
        plan, other = planned(problem, prices), plan_by_futures(Arrays.of(problem), prices)
        assert plan is not None
        assert other is not None
        windows += problem.evaluate(plan).value
        steps += problem.evaluate(other).value
    assert windows > gain * steps


def test_prices_are_improved_before_every_window_but_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """`reprice` sees the step, what the agents hold, and the prices of the steps to come.

    Where windows have places to wait it gains less than its time is worth, and is not called.
    """
    problem = walking(0, cost=2.0)
    seen: list[int] = []

    def reprice(k: int, held: IntArray, prices: FloatArray) -> FloatArray:
        assert held.shape == (problem.n,)
        assert len(prices) == problem.T - k
        seen.append(k)
        return prices

    assert planned(problem, prices_of(problem), reprice=reprice) is not None
    assert not seen
    monkeypatch.setattr(module, "can_wait", lambda arrays: False)
    assert planned(problem, prices_of(problem), reprice=reprice) is not None
    assert seen[0] > 0
    assert seen == sorted(set(seen))


@pytest.mark.parametrize("options", [{"seconds": 0.0}, {"stop": lambda: True}])
def test_no_time_no_plan(options: dict[str, object]) -> None:
    """It ends at once, without a plan."""
    problem = walking(0)
    assert planned(problem, prices_of(problem), **options) is None


def is_assignment(plan: IntArray) -> bool:
    """Whether nobody shares a task at any step."""
    return all(len(np.unique(row)) == len(row) for row in plan)


def test_a_network_that_cannot_fit_leaves_nobody_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the smallest network is too large as well, it is taken whole: all agents plan, and no two on one task."""
    monkeypatch.setattr(module, "_ARCS", 5)
    for seed in range(3):
        problem = walking(seed, cost=1.0)
        plan = planned(problem, prices_of(problem))
        assert plan is not None
        assert is_assignment(plan)


@pytest.mark.parametrize("seconds", [10.0, 20.0, 60.0])
def test_a_plan_that_is_cut_short_goes_on_as_before(seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock on which every look takes a second: what was planned until then is kept, what follows too."""
    problem = walking(0, cost=1.0)
    prices, start = prices_of(problem), rollout(problem, HAA()).plan
    time = iter(range(10**6))
    monkeypatch.setattr(clock, "now", lambda: float(next(time)))
    repricings: list[int] = []

    def reprice(k: int, held: IntArray, later: FloatArray) -> FloatArray:
        repricings.append(k)
        return later

    plan = rolling_windows(
        Arrays.of(problem), start, prices, np.random.default_rng(0), reprice=reprice, seconds=seconds
    )
    assert plan is not None
    assert is_assignment(plan)
    assert (plan != start).any()
    assert next(time) <= seconds + 6
    assert len(repricings) <= seconds


def test_pace_takes_smaller_networks_where_short_windows_are_too_slow() -> None:
    """Windows get shorter first and their networks smaller then; with time to spare both grow again."""
    pace = module._Pace(6, 60_000)
    for _ in range(20):
        pace.learn(took=2.0, allowed=1.0)
    assert pace.length == module._SHORTEST
    assert pace.arcs == module._FEWEST_ARCS
    for _ in range(40):
        pace.learn(took=0.1, allowed=1.0)
    assert pace.length == module._LONGEST
    assert pace.arcs == 60_000


def test_windows_with_places_grow_longer_before_they_grow_denser() -> None:
    """They get shorter first, where time is short, and are never so sparse that they are worth nothing."""
    pace = module._WaitingPace(10, 0.0, agents=100)
    assert pace.arcs == 10 * 100 * module._DENSITY
    for _ in range(20):
        pace.learn(took=2.0, allowed=1.0)
    assert (pace.length, pace.density) == (module._SHORTEST, module._SPARSEST)
    assert pace.kept == module._SHORTEST - 1  # late: more is kept than should be
    lengths = []
    for _ in range(60):
        pace.learn(took=0.1, allowed=1.0)
        if pace.length < module._LONGEST_SPELLS:
            assert pace.density <= module._DENSITY / module._SLOWLY
        lengths.append(pace.length)
    assert lengths == sorted(lengths)
    assert (pace.length, pace.density) == (module._LONGEST_SPELLS, module._DENSEST)
    assert pace.arcs == pace.length * 100 * pace.density
    assert module._SHORTEST // 2 <= pace.kept <= pace.length // 2


def test_a_network_is_looked_for_near_the_last_one() -> None:
    """Reduced costs far above the last window's are not tried, until one fits that is larger."""
    pace = module._WaitingPace(10, 0.0, agents=100)
    regrets = module._WAITING_REGRETS
    assert pace.ladder(regrets) == regrets
    pace.regret = regrets[8]
    assert (
        pace.ladder(regrets)[0]
        <= module._REACH * regrets[8]
        < regrets[regrets.index(pace.ladder(regrets)[0]) - 1]
    )
    pace.regret = regrets[-1]
    assert regrets[-1] in pace.ladder(regrets)


def test_a_window_that_gave_nothing_is_tried_again_with_half_the_network(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Until there are no fewer arcs; only then do the agents go on as before."""
    problem = walking(0, cost=1.0)
    prices, sizes = prices_of(problem), []
    whole = module._fitting_flow

    def fitting(*options: object) -> object:
        pace = options[-2]
        assert isinstance(pace, module._Pace)
        sizes.append(pace.arcs)
        return whole(*options)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "_fitting_flow", fitting)
    monkeypatch.setattr(module, "solve_flow", lambda *_, **__: None)
    start = rollout(problem, HAA()).plan
    plan = rolling_windows(Arrays.of(problem), start, prices, np.random.default_rng(0), seconds=1e3)
    np.testing.assert_array_equal(plan, start)  # with places to wait
    assert sizes[1] == sizes[0] / 2
    sizes.clear()
    monkeypatch.setattr(module, "can_wait", lambda arrays: False)
    plan = rolling_windows(Arrays.of(problem), start, prices, np.random.default_rng(0), seconds=1e3)
    np.testing.assert_array_equal(plan, start)
    assert sizes[:5] == [60_000, 30_000, 15_000, 7_500, 4_000]
    assert set(sizes[5:]) <= {4_000, 4_000 / module._FEWER}


def test_repricing_takes_no_more_than_its_share() -> None:
    """A repricing that takes two windows' time comes after every fifth."""
    pace = module._Pace(6, 60_000)
    count = 0
    for _ in range(50):
        if pace.has_credit(1.0):
            pace.repriced(2.0)
            count += 1
    assert 9 <= count <= 11
