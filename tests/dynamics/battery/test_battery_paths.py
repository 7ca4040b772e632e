"""Longest paths of agents on batteries: against enumeration, the plain local states, and differences of soft values."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from batteries import Case, cases, random_case
from hypothesis import given
from hypothesis import strategies as st

from sapopt import SAP, Benefits
from sapopt.dynamics import Battery
from sapopt.dynamics.battery.paths import BatteryPaths
from sapopt.dynamics.paths.oracles import FirstValueOracle, LocalOracle, SoftPathOracle


def oracle(case: Case, form: str = "sparse") -> BatteryPaths:
    problem = case.problem(form)
    made = problem.model.path_oracle(problem.benefits, problem.initial_state())
    assert isinstance(made, BatteryPaths)
    return made


def plain(case: Case) -> LocalOracle:
    problem = case.problem()
    return LocalOracle(problem.benefits, problem.model.local_model(problem.benefits, problem.initial_state()))


def some_prices(seed: int, case: Case, *, closed: bool = False) -> np.ndarray:
    rng = np.random.default_rng([seed, 7])
    T, _, m = case.benefits.shape
    prices = rng.random((T, m)) * rng.integers(0, 2, (T, m))
    if closed:
        prices[rng.random(prices.shape) < 0.15] = np.inf
    return prices


def priced(case: Case, prices: np.ndarray, agent: int, path: Any, *, first: int = 0) -> float:
    paid = sum(prices[k, j] for k, j in enumerate(path) if k >= first)
    return case.walk(agent, path)[0] - paid


@given(cases(most=(4, 2, 3)), st.integers(0, 99), st.sampled_from(["dense", "sparse"]))
def test_paths_are_the_longest(case: Case, seed: int, form: str) -> None:
    """All rules, closed cells among them, against enumeration; the paths attain their value."""
    prices = some_prices(seed, case, closed=True)
    made = oracle(case, form)
    values, plan = made.best_paths(prices)
    first = made.first_values(prices)
    for i in range(made.shape[1]):
        best = max(priced(case, prices, i, path) for path in case.paths())
        value, path = made.best_path(i, prices)
        for found, way in ((values[i], plan[:, i]), (value, path)):
            assert found == pytest.approx(best, abs=1e-9)
            if math.isfinite(best):
                assert priced(case, prices, i, way) == pytest.approx(best, abs=1e-9)
        for j in range(made.shape[2]):
            best = max(priced(case, prices, i, path, first=1) for path in case.paths() if path[0] == j)
            assert first[i, j] == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_longer_paths_agree_with_the_plain_states(seed: int) -> None:
    """Windows too long to enumerate, from every kind of start, with forbidden pairs."""
    case = random_case(seed, steps=12, n=3, m=5)
    rng = np.random.default_rng(seed)
    case.benefits[rng.random(case.benefits.shape) < 0.1] = -np.inf
    case.benefits[:, :, 0] = np.maximum(case.benefits[:, :, 0], 0.0)
    prices = some_prices(seed, case)
    made, reference = oracle(case), plain(case)
    assert isinstance(made, FirstValueOracle)
    values, plan = made.best_paths(prices)
    np.testing.assert_allclose(values, reference.best_paths(prices)[0], atol=1e-9)
    np.testing.assert_allclose(made.first_values(prices), reference.first_values(prices), atol=1e-9)
    for i in range(3):
        assert priced(case, prices, i, plan[:, i]) == pytest.approx(values[i], abs=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_sparse_first_values_are_the_dense_ones(seed: int) -> None:
    """But for a constant for every agent."""
    case = random_case(seed, steps=1 + seed % 4, n=3, m=5)
    made = oracle(case)
    prices = some_prices(seed, case)
    dense, gains = made.first_values(prices), made.first_gains(prices).toarray()
    difference = dense - gains
    np.testing.assert_allclose(difference, np.broadcast_to(difference[:, :1], difference.shape), atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_a_window_that_goes_on_values_charge(seed: int) -> None:
    """Paths end with the value of what is left, hard and soft; nobody dies; more charge is worth more, ever less."""
    case = random_case(seed, steps=4, n=2, m=3)
    problem = case.problem("sparse")
    state = problem.initial_state()
    made = problem.model.window_oracle(problem.benefits, state)
    end = made.rule.end
    worth = np.diff(end)[1:]
    assert (worth >= 0).all()
    assert (np.diff(worth) <= 1e-9).all()
    prices = some_prices(seed, case)
    values, plan = made.best_paths(prices)
    unit = problem.dynamics.units.unit
    for i in range(2):

        def total(path: Any, i: int = i) -> float:
            return priced(case, prices, i, path) + end[int(case.walk(i, path)[1][-1] / unit)]

        best = max(total(path) for path in case.paths())
        assert values[i] == pytest.approx(best, abs=1e-9)
        assert total(plan[:, i]) == pytest.approx(best, abs=1e-9)
        survives = any(case.walk(i, path)[1][-1] > 0 for path in case.paths())
        assert case.walk(i, plan[:, i])[1][-1] > 0 or not survives
        weights = [math.exp((total(path) - best) / 0.4) for path in case.paths()]
        soft, _ = made.soft_paths(prices, 0.4)
        assert soft[i] == pytest.approx(best + 0.4 * math.log(sum(weights)), abs=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_soft_values_bound_the_hard_ones_and_usage_is_their_slope(seed: int) -> None:
    """Soft values lie above the hard ones, approach them, and -usage is their derivative by the prices."""
    case = random_case(seed, steps=7, n=2, m=4)
    prices = some_prices(seed, case)
    made = oracle(case)
    assert isinstance(made, SoftPathOracle)
    hard, _ = made.best_paths(prices)
    for temperature in (0.3, 0.02):
        values, usage = made.soft_paths(prices, temperature)
        assert (values >= hard - 1e-9).all()
        np.testing.assert_allclose(usage.sum(axis=1), made.shape[1], atol=1e-6)
        h = 1e-5
        for k, j in itertools.product(range(prices.shape[0]), range(prices.shape[1])):
            up, down = prices.copy(), prices.copy()
            up[k, j] += h
            down[k, j] -= h
            rise = made.soft_paths(up, temperature)[0].sum() - made.soft_paths(down, temperature)[0].sum()
            assert -rise / (2 * h) == pytest.approx(usage[k, j], abs=1e-4)
    cold = max(1e-3, 1.01 * made.coldest)
    assert (made.soft_paths(prices, cold)[0] <= hard + cold * 7 * math.log(4)).all()


def test_soft_values_count_every_path_once() -> None:
    """At any temperature, the sum over all paths by enumeration."""
    for seed in range(8):
        case = random_case(seed, steps=4, n=2, m=3)
        prices = some_prices(seed, case)
        values, _ = oracle(case).soft_paths(prices, 0.4)
        for i in range(2):
            weights = [math.exp(priced(case, prices, i, path) / 0.4) for path in case.paths()]
            assert values[i] == pytest.approx(0.4 * math.log(sum(weights)), abs=1e-9)


def test_soft_paths_stay_finite_over_long_horizons() -> None:
    """Full and empty batteries differ by far more than a float can hold, and all prices of a step may be high."""
    rng = np.random.default_rng(5)
    T, n, m = 80, 6, 90
    benefits = Benefits(np.where(rng.random((T, n, m)) < 0.03, rng.random((T, n, m)) * 5, 0.0))
    prices = rng.random((T, m)) * 3 + 4.0
    for pay_for in ("moves", "entries"):
        problem = SAP(benefits, Battery(0.5, pay_for=pay_for), np.arange(n))
        made = problem.model.path_oracle(benefits, problem.initial_state())
        hard, _ = made.best_paths(prices)
        values, usage = made.soft_paths(prices, 0.002)
        assert np.isfinite(usage).all()
        assert usage.min() > -1e-9
        np.testing.assert_allclose(usage.sum(axis=1), n, atol=1e-6)
        assert (values >= hard - 1e-6).all()
        assert (values <= hard + 0.5).all()


def test_what_makes_no_sense_is_refused() -> None:
    """Prices or a state of a wrong shape."""
    case = random_case(1)
    with pytest.raises(ValueError, match="prices"):
        oracle(case).best_paths(np.zeros((2, 2)))
    other = random_case(1, n=3, m=4)
    with pytest.raises(ValueError, match="state"):
        BatteryPaths(case.benefits, case.dynamics, other.problem().initial_state())
