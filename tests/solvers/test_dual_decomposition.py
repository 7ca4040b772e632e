"""DualDecomposition against enumeration on tiny problems, and its controls."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from switching_problems import optimum, tiny, walking

from sapopt import SAP, SwitchingCost, solve
from sapopt.problem.result import Status
from sapopt.running.control import Run
from sapopt.solvers import DualLookahead
from sapopt.solvers.dual_decomposition import DualDecomposition
from sapopt.solvers.dual_decomposition.early import looked_ahead
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.priced_futures import plan_by_futures
from sapopt.solvers.dual_decomposition.network_plans.sparse_rolling import plan_by_first_rows

QUICK = DualDecomposition(iterations=80, rounds=4, sweeps=10)


def test_tiny_problems_meet_enumeration() -> None:
    """value <= optimum <= bound on 200 problems of every form, and the optimum is found on 95 % of them."""
    found = 0
    for seed in range(200):
        problem = tiny(seed)
        best = optimum(problem)
        result = solve(problem, QUICK, seed=seed)
        assert result.value <= best + 1e-9
        assert result.bound is not None
        assert best <= result.bound + 1e-9
        found += result.value >= best - 1e-9
    assert found >= 190


def test_small_problem_is_solved_well() -> None:
    """A chain of passing tasks: within 1 % of the proven bound, and the trace tells how it came about."""
    problem = walking()
    result = solve(problem, QUICK)
    assert result.gap is not None
    assert result.gap < 0.01
    values = [record["value"] for record in result.trace]
    bounds = [record["bound"] for record in result.trace]
    assert values == sorted(values)
    assert bounds == sorted(bounds, reverse=True)
    assert values[-1] == pytest.approx(result.value)
    assert result.prices is not None
    assert result.prices.shape == (problem.T, problem.m)


def test_no_spare_task() -> None:
    """With as many agents as tasks, agents can only swap."""
    result = solve(walking(n=16), QUICK)
    assert result.gap is not None
    assert result.gap < 0.02


def test_same_seed_same_plan() -> None:
    """Without a time limit the seed decides everything."""
    problem = walking(3)
    first, second = (solve(problem, QUICK, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first.plan, second.plan)
    assert first.bound == second.bound


def test_warm_start_is_never_made_worse() -> None:
    """Neither a good plan nor a bad one comes back worse, however little is done."""
    problem = walking(1)
    good = solve(problem, QUICK)
    lazy = DualDecomposition(iterations=1, rounds=0, sweeps=0)
    assert solve(problem, lazy, start=good).value >= good.value - 1e-9
    for seed in range(5):
        rng = np.random.default_rng(seed)
        plan = np.array([rng.permutation(problem.m)[: problem.n] for _ in range(problem.T)])
        assert solve(problem, lazy, start=plan).value >= problem.evaluate(plan).value


def test_relabelled_agents_keep_the_bound() -> None:
    """The bound does not depend on the order of the agents."""
    problem = walking(2)
    order = np.random.default_rng(0).permutation(problem.n)
    relabelled = SAP(problem.benefits.dense()[:, order], SwitchingCost(0.4))
    first, second = solve(problem, QUICK), solve(relabelled, QUICK)
    assert first.bound == pytest.approx(second.bound, rel=1e-3)
    assert first.value <= second.bound + 1e-9
    assert second.value <= first.bound + 1e-9


def test_time_limit_gives_incumbent_and_bound() -> None:
    """A run that is cut short still has both, in time."""
    problem = walking(4, T=60, n=60, m=80)
    solve(walking(), QUICK)  # compile
    result = solve(problem, DualDecomposition(tolerance=0.0), time_limit=1.5)
    if result.status is Status.OPTIMAL:
        assert result.gap == pytest.approx(0.0, abs=1e-9)
    else:  # what is neither proven nor cut off has come to its end before
        assert result.status is (Status.TIME_LIMIT if result.runtime >= 1.5 else Status.FEASIBLE)
    # 10 % over, and what one uninterruptible call may take on a machine that others use too.
    assert result.runtime < 1.1 * 1.5 + 1.0
    assert result.bound is not None
    assert result.value <= result.bound


def test_callback_ends_the_run() -> None:
    """A true answer stops the run; progress reports value and bound."""
    seen = []

    def stop(progress: Any) -> bool:
        seen.append(progress)
        return len(seen) > 5

    result = solve(walking(), QUICK, callback=stop)
    assert result.status is Status.INTERRUPTED
    assert all(p.value is not None for p in seen)
    assert seen[-1].bound is not None


def test_interruption_returns_the_incumbent() -> None:
    """Ctrl-C hands back the best plan and bound so far."""
    count = 0

    def interrupt(progress: Any) -> None:
        nonlocal count
        count += 1
        if count == 30:
            raise KeyboardInterrupt

    result = solve(walking(), QUICK, callback=interrupt)
    assert result.status is Status.INTERRUPTED
    assert result.bound is not None


@pytest.mark.parametrize("options", [{"iterations": 0}, {"threads": 0}, {"rounds": -1}, {"tolerance": -1.0}])
def test_bad_options(options: dict[str, Any]) -> None:
    """The error names the option."""
    with pytest.raises(ValueError, match=next(iter(options))):
        DualDecomposition(**options)


@pytest.mark.parametrize("n", [12, 16])
def test_windowed_plans(n: int) -> None:
    """Looking at the whole horizon they are as good as the dense rolling assignment; shorter or repriced, nearly so."""
    problem = walking(n=n)
    prices = solve(problem, DualDecomposition(iterations=80, rounds=0, sweeps=0, repricing=0)).prices
    assert prices is not None
    dense = plan_by_futures(Arrays.of(problem), prices)
    assert dense is not None
    target = problem.evaluate(dense).value
    for options in ({"window": problem.T}, {"window": 8}, {"window": 8, "iterations": 10}):
        plan = plan_by_first_rows(problem, prices, **options)
        assert plan is not None
        assert problem.evaluate(plan).value >= 0.98 * target
    assert plan_by_first_rows(problem, prices, lambda: True) is None


def test_large_problems_are_planned_from_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """The way of thousands of agents, at a size that can be tested."""
    monkeypatch.setattr("sapopt.solvers.dual_decomposition.solver._LARGE", 0)
    for problem in (walking(n=16), walking()):
        result = solve(problem, QUICK)
        assert result.gap is not None
        assert result.gap < 0.02
        assert "rolling assignment" in {record["phase"] for record in result.trace}


def test_windowed_plans_need_sparse_values() -> None:
    """Where idling is free the first values have no sparse form."""
    problem = SAP(np.ones((3, 2, 3)), SwitchingCost(0.1, idle_is_free=True))
    with pytest.raises(ValueError, match="sparse"):
        plan_by_first_rows(problem, np.zeros((3, 3)))


def test_looks_ahead_early() -> None:
    """Where few pairs are worth something, a run with a time limit has the plan of a receding horizon first."""
    rng = np.random.default_rng(5)
    benefits = rng.random((10, 8, 12)) * (rng.random((10, 8, 12)) < 0.3)
    problem = SAP(benefits, 0.3)
    found = list(looked_ahead(problem, Run(time_limit=1e6), lambda phase: False))
    np.testing.assert_array_equal(found[0][1], solve(problem, DualLookahead(8)).plan)
    begun = solve(problem, DualDecomposition(rounds=1), time_limit=2.0, start=found[0][1])
    assert "looking ahead" not in {line["phase"] for line in begun.trace}
    assert begun.value >= problem.evaluate(found[0][1]).value
