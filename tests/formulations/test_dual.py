"""The Lagrangian dual: bounds against brute force, and the manners of the ascent."""

from __future__ import annotations

import itertools
import math
import time
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from strategies import Instance

from sapopt import SAP, Benefits, SwitchingCost, bound, solve
from sapopt.dynamics.paths.oracles import LocalOracle
from sapopt.dynamics.switching.states import SwitchingStates
from sapopt.formulations.dual import ascend, dual_value, rigorous_bound
from sapopt.solvers import DualDecomposition, Exact

RULES = ("strict", "idle is free", "matrix", "matrix, idle is free")


def make(seed: int, rule: str) -> Instance:
    """A tiny instance: n <= 3, m <= 4, T <= 4."""
    rng = np.random.default_rng([seed, RULES.index(rule), 7])
    T, n = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    m = int(rng.integers(max(n, 2), 5))
    benefits = np.where(rng.random((T, n, m)) < 0.6, rng.normal(0.6, 0.7, (T, n, m)), 0.0)
    cost: Any = float(rng.random())
    if rule.startswith("matrix"):
        cost = rng.random((m, m))
        np.fill_diagonal(cost, 0.0)
    initial = None if rng.random() < 0.5 else tuple(int(j) for j in rng.permutation(m)[:n])
    return Instance(benefits, cost, rule.endswith("idle is free"), initial)


def oracle_of(problem: SAP) -> Any:
    return problem.model.path_oracle(problem.benefits, problem.initial_state())


@pytest.mark.parametrize("rule", RULES)
def test_no_prices_bound_below_the_optimum(rule: str) -> None:
    """Random prices, and those of an ascent: optimum <= bound; dense and sparse alike; the ascent helps."""
    rng = np.random.default_rng(3)
    for seed in range(12):
        instance = make(seed, rule)
        optimum = instance.best()
        made = oracle_of(instance.problem())
        bounds = []
        for scale in (0.0, 0.1, 1.0):
            prices = scale * rng.random((made.shape[0], made.shape[2]))
            here = dual_value(made, prices)
            assert here.bound >= optimum
            assert here.bound >= here.value
            bounds.append(here.bound)
        found = ascend(made, max_iterations=150)
        assert optimum <= found.bound <= bounds[0]
        assert found.bound == dual_value(made, found.prices).bound
        same = ascend(oracle_of(instance.problem("sparse")), max_iterations=150)
        assert same.bound == pytest.approx(found.bound, abs=1e-9)


def test_the_bound_is_tight_where_agents_do_not_compete() -> None:
    """One agent: the dual is exact at zero prices."""
    for seed in range(5):
        instance = make(seed, "strict")
        single = Instance(instance.benefits[:, :1], instance.cost, False, None)
        made = oracle_of(single.problem())
        assert ascend(made, max_iterations=5).bound == pytest.approx(single.best(), abs=1e-9)


def test_the_ascent_reaches_the_relaxation_of_one_step() -> None:
    """With a single step the dual is that of an assignment problem, which has no gap."""
    rng = np.random.default_rng(11)
    for n, m in ((5, 5), (4, 7)):
        instance = Instance(rng.random((1, n, m)))
        made = oracle_of(instance.problem())
        from scipy.optimize import linear_sum_assignment

        rows, columns = linear_sum_assignment(-instance.benefits[0])
        best = float(instance.benefits[0][rows, columns].sum())
        assert best <= ascend(made).bound <= best * 1.002


def test_scaling_the_benefits_scales_the_ascent() -> None:
    """Nothing depends on the unit of the benefits."""
    instance = make(4, "strict")
    plain = ascend(oracle_of(instance.problem()), max_iterations=100)
    scaled = Instance(1024.0 * instance.benefits, 1024.0 * instance.cost, False, instance.initial)
    large = ascend(oracle_of(scaled.problem()), max_iterations=100)
    assert large.bound == pytest.approx(1024.0 * plain.bound, rel=1e-6)


def test_lowering_prices_never_hurts() -> None:
    """D is not larger after every step's prices were moved down to zero."""
    instance = make(2, "strict")
    made = oracle_of(instance.problem())
    prices = 0.5 + np.random.default_rng(0).random((made.shape[0], made.shape[2]))
    values, _ = made.best_paths(prices)
    assert dual_value(made, prices).value <= values.sum() + prices.sum() + 1e-9


def crowded() -> SAP:
    """Several agents who want the same tasks."""
    rng = np.random.default_rng(9)
    benefits = np.where(rng.random((12, 8, 10)) < 0.4, rng.random((12, 8, 10)), 0.0)
    return Instance(benefits, 0.3).problem()


def test_runs_repeat_and_resume() -> None:
    """The same run twice gives the same numbers; stopping and resuming changes nothing."""
    made = oracle_of(crowded())
    whole = ascend(made, max_iterations=400)
    again = ascend(made, max_iterations=400)
    assert whole.bound == again.bound
    np.testing.assert_array_equal(whole.prices, again.prices)
    part = ascend(made, max_iterations=400, callback=lambda iteration, *_: iteration >= 120)
    assert part.iterations == 121
    rest = ascend(made, part.prices, state=part.state, max_iterations=300)
    assert rest.bound <= part.bound
    assert rest.bound == pytest.approx(whole.bound, rel=1e-3)


def test_a_warm_start_is_never_made_worse() -> None:
    """From good prices, with any number of iterations."""
    made = oracle_of(crowded())
    good = ascend(made)
    for count in (1, 3, 40):
        assert ascend(made, good.prices, max_iterations=count).bound <= good.bound


def test_limits_targets_and_callbacks_stop_it() -> None:
    """Whatever stops it, the bound is proven and the prices belong to it."""
    problem = crowded()
    made = oracle_of(problem)
    began = time.monotonic()
    short = ascend(made, time_limit=0.2)
    assert time.monotonic() - began < 5.0
    late = ascend(made, time_limit=0.0)
    assert late.iterations == 1
    good = ascend(made)
    met = ascend(made, target=good.bound, tolerance=0.02)
    assert met.converged
    assert met.iterations < good.iterations
    seen: list[float] = []

    def watch(iteration: int, bound: float, prices: np.ndarray) -> bool:
        assert (prices >= 0).all()
        seen.append(bound)
        return iteration == 4

    stopped = ascend(made, callback=watch)
    assert stopped.iterations == 5
    assert seen == sorted(seen, reverse=True)
    for result in (short, late, met, stopped):
        assert result.bound == dual_value(made, result.prices).bound
        assert (np.diff(result.history[:, 2]) <= 0).all()


def test_any_oracle_can_be_ascended() -> None:
    """A generic local model has no soft paths: subgradient steps must do."""
    instance = make(6, "strict")
    problem = instance.problem()
    states = SwitchingStates(problem.dynamics, problem.m, problem.initial_assignment)  # type: ignore[arg-type]
    generic = LocalOracle(Benefits(instance.benefits), states)
    found = ascend(generic, max_iterations=300)
    best = ascend(oracle_of(problem))
    assert instance.best() <= found.bound <= best.bound * 1.02 + 1e-9


def test_the_padding_covers_the_rounding() -> None:
    """The bound is not below the exact sum of the parts it is made of."""
    rng = np.random.default_rng(1)
    values = rng.normal(size=1000) * 10.0 ** rng.integers(-8, 8, 1000)
    prices = rng.random((7, 50)) * 10.0 ** rng.integers(-8, 8, (7, 50))
    exact = sum(map(Fraction, values.tolist())) + sum(map(Fraction, prices.ravel().tolist()))
    assert Fraction(rigorous_bound(values, prices)) >= exact
    assert rigorous_bound(np.array([-math.inf]), prices) == -math.inf


@pytest.mark.parametrize("prices", [np.full((12, 10), -1.0), np.full((12, 10), np.nan), np.zeros((3, 3))])
def test_prices_that_prove_nothing_are_refused(prices: np.ndarray) -> None:
    """Negative, not finite, of a wrong shape."""
    with pytest.raises(ValueError, match="prices"):
        ascend(oracle_of(crowded()), prices)


@pytest.mark.parametrize("order", [(1e16, 1.0, -1e16), (1.0, 1e16, -1e16), (1e16, -1e16, 1.0)])
def test_numbers_that_cancel_out(order: tuple[float, ...]) -> None:
    """Sums of both signs lose their last bits: no bound falls below the optimum, 1, and none is called proven by it."""
    problem = SAP(np.array(order)[:, None, None])
    assert problem.evaluate(np.zeros((3, 1), dtype=int)).value == 1.0
    assert bound(problem).value >= 1.0
    for solver in (DualDecomposition(), Exact(), Exact("milp"), Exact("dp")):
        result = solve(problem, solver)
        assert result.value == 1.0
        assert result.bound is None or result.bound >= 1.0


@pytest.mark.parametrize("matrix", [False, True])
def test_exact_methods_where_numbers_cancel_out(matrix: bool) -> None:
    """With benefits of 1e16 and -1e16 beside small ones, bounds hold for the best of all plans, added up exactly."""
    rows = list(itertools.permutations(range(3), 2))
    for seed in range(8):
        rng = np.random.default_rng(seed)
        benefits = rng.choice([1e16, -1e16, 1.0, 0.5], (3, 2, 3))
        cost = 0.25 * (1 - np.eye(3)) * rng.integers(1, 4, (3, 3)) if matrix else 0.25
        problem = SAP(benefits, SwitchingCost(cost))
        best = max(problem.evaluate(np.array(plan)).value for plan in itertools.product(rows, repeat=3))
        assert bound(problem).value >= best
        for solver in (DualDecomposition(iterations=50), Exact(), Exact("milp"), Exact("dp")):
            result = solve(problem, solver)
            assert result.value <= best
            assert result.bound is None or result.bound >= best
