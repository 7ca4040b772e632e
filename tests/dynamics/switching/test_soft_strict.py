"""The smoothed paths of the strict rule against the recursion written out over all places, and both ways of waiting."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp

from sapopt import SAP, SwitchingCost
from sapopt.dynamics.switching import paths, soft_waits
from sapopt.dynamics.switching.paths import StrictSwitching


@st.composite
def windows(draw: st.DrawFn) -> tuple[StrictSwitching, np.ndarray, float]:
    """A window in which agents can wait on tasks out of sight, prices, and a temperature."""
    T, n = draw(st.integers(1, 9)), draw(st.integers(1, 4))
    m = n + draw(st.integers(12, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    benefits = rng.random((T, n, m)) * (rng.random((T, n, m)) < 0.08)
    if draw(st.booleans()):
        benefits[rng.random(benefits.shape) < 0.01] -= 1.0
    cost = draw(st.sampled_from([0.05, 0.5, 2.0]))
    problem = SAP(benefits, SwitchingCost(cost), rng.permutation(m)[:n] if draw(st.booleans()) else None)
    oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
    # Prices of up to 4 at the lowest temperatures weigh less than floats can hold.
    prices = (
        rng.random((T, m))
        * draw(st.sampled_from([0.0, 0.2, 4.0]))
        * (rng.random((T, m)) < draw(st.sampled_from([0.5, 1.0])))
    )
    temperature = max(draw(st.sampled_from([1.0, 0.05, 0.005])), 1.05 * oracle.coldest)
    return oracle, prices, temperature


def written_out(oracle: StrictSwitching, prices: np.ndarray, temperature: float) -> np.ndarray:
    """Soft values (n,) by the recursion in logarithms over the slots and, for waiting, a copy of every free task."""
    window, slots = oracle.window, oracle.slots
    T, n, m = oracle.shape
    copies = np.flatnonzero(~oracle.excluded) if oracle.park else np.empty(0, dtype=int)
    move = -oracle.cost / temperature
    values = np.empty(n)
    for i in range(n):
        own = slots.task[slots.ptr[i] : slots.ptr[i + 1]]
        places = np.concatenate([own, copies])
        total = None
        for k in range(T):
            log_weight = -prices[k, places] / temperature
            row = slice(window.indptr[k * n + i], window.indptr[k * n + i + 1])
            for task, benefit in zip(window.indices[row], window.data[row], strict=True):
                log_weight[np.flatnonzero(own == task)[0]] += benefit / temperature
            if total is None:
                entered = np.full(len(places), move if window.held[i] >= 0 else 0.0)
                if window.held[i] >= 0:
                    at = np.flatnonzero(own == window.held[i])[0]
                    entered[at] = np.logaddexp(entered[at], 0.0)
            else:
                entered = np.logaddexp(total, logsumexp(total) + move)
            total = entered + log_weight
        values[i] = temperature * logsumexp(total)
    return values


@settings(max_examples=80, deadline=None)
@given(windows())
def test_values_are_those_of_the_recursion(case: tuple[StrictSwitching, np.ndarray, float]) -> None:
    """Whatever the prices and the temperature, the soft values are those of the plain recursion in logarithms."""
    oracle, prices, temperature = case
    values, usage = oracle.soft_paths(prices, temperature)
    assert values == pytest.approx(written_out(oracle, prices, temperature), rel=1e-9, abs=1e-9)
    # Every agent holds one place at every step; who waits with a probability below a millionth is left out.
    assert usage.sum(axis=1) == pytest.approx(np.full(oracle.shape[0], oracle.shape[1]), rel=1e-4)


@settings(max_examples=80, deadline=None)
@given(windows())
def test_weights_and_logarithms_agree(case: tuple[StrictSwitching, np.ndarray, float]) -> None:
    """Waiting by weights and waiting by their logarithms give the same values and the same usage."""
    oracle, prices, temperature = case
    values, usage = oracle.soft_paths(prices, temperature)
    least, soft_waits.LEAST = soft_waits.LEAST, np.inf
    try:
        by_logs, usage_by_logs = oracle.soft_paths(prices, temperature)
    finally:
        soft_waits.LEAST = least
    # The logarithms leave out what weighs less than exp(-30) of a step, which for the value is a millionth at most.
    assert values == pytest.approx(by_logs, rel=1e-5, abs=1e-6)
    assert usage == pytest.approx(usage_by_logs, abs=1e-4)


@settings(max_examples=40, deadline=None)
@given(windows())
def test_one_call_and_several_agree(case: tuple[StrictSwitching, np.ndarray, float]) -> None:
    """What a short window does in one call is what a long one does call by call, to the last few bits."""
    oracle, prices, temperature = case
    values, usage = oracle.soft_paths(prices, temperature)
    most, paths._ONE_CALL = paths._ONE_CALL, 0
    try:
        one_by_one, usage_one_by_one = oracle.soft_paths(prices, temperature)
    finally:
        paths._ONE_CALL = most
    assert values == pytest.approx(one_by_one, rel=1e-12, abs=1e-12)
    assert usage == pytest.approx(usage_one_by_one, rel=1e-12, abs=1e-12)


def test_prices_beyond_floats_take_the_logarithms() -> None:
    """Where every task is dear at some step, weights would underflow: the logarithms still give the right value."""
    rng = np.random.default_rng(5)
    T, n, m = 8, 2, 30
    benefits = rng.random((T, n, m)) * (rng.random((T, n, m)) < 0.05)
    problem = SAP(benefits, SwitchingCost(0.5))
    oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
    assert isinstance(oracle, StrictSwitching)
    assert oracle.park
    prices = np.where(np.arange(m) % T == np.arange(T)[:, None], 0.0, 3.0)
    temperature = 0.005
    smoothing = oracle.smoothing(prices, temperature)
    assert not soft_waits.waits(smoothing, smoothing.weight.max(axis=1), oracle.excluded).linear
    values, _ = oracle.soft_paths(prices, temperature)
    assert values == pytest.approx(written_out(oracle, prices, temperature), rel=1e-9)
