"""The smoothed paths where idling is free against the recursion written out over all tasks, at any temperature."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp

from sapopt import SAP, SwitchingCost
from sapopt.dynamics.switching.paths import IdleFreeSwitching

Case = tuple[SAP, IdleFreeSwitching, np.ndarray, float]


@st.composite
def windows(draw: st.DrawFn) -> Case:
    """A window, some of whose benefits are not positive, prices, and a temperature."""
    T, n = draw(st.integers(1, 7)), draw(st.integers(1, 4))
    m = n + draw(st.integers(0, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    benefits = rng.random((T, n, m)) * (rng.random((T, n, m)) < draw(st.sampled_from([0.1, 0.6])))
    if draw(st.booleans()):
        benefits[rng.random(benefits.shape) < 0.05] -= 1.0
    cost = draw(st.sampled_from([0.05, 0.5, 2.0]))
    start = rng.permutation(m)[:n] if draw(st.booleans()) else None
    problem = SAP(benefits, SwitchingCost(cost, idle_is_free=True), start)
    prices = rng.random((T, m)) * draw(st.sampled_from([0.0, 0.2, 4.0]))
    prices *= rng.random((T, m)) < draw(st.sampled_from([0.5, 1.0]))
    oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
    return problem, oracle, prices, draw(st.sampled_from([1.0, 0.05, 0.005, 0.0005]))


def written_out(problem: SAP, prices: np.ndarray, temperature: float) -> tuple[np.ndarray, np.ndarray]:
    """Soft values (n,) and usage (T, m) by a recursion in logarithms over all tasks, forward and backward.

    Whoever holds a task with an entry came from that task, or from anywhere for what a move costs; a task without
    an entry is entered for nothing from anywhere.
    """
    T, n, m = problem.T, problem.n, problem.m
    benefits, cost = problem.benefits.dense(), problem.dynamics.cost
    values, usage = np.empty(n), np.zeros((T, m))
    for i in range(n):
        weight = (benefits[:, i] - prices) / temperature
        stay = np.where(benefits[:, i] != 0.0, 0.0, -np.inf)
        move = np.where(benefits[:, i] > 0.0, -cost / temperature, 0.0)
        ahead = np.empty((T, m))
        held = np.full(m, -np.inf)
        if problem.initial_assignment is None:
            move[0] = 0.0
        else:
            held[problem.initial_assignment[i]] = 0.0
        for k in range(T):
            before = held if k == 0 else ahead[k - 1]
            anywhere = 0.0 if k == 0 else logsumexp(before)
            ahead[k] = weight[k] + np.logaddexp(before + stay[k], anywhere + move[k])
        behind = np.zeros((T, m))
        for k in range(T - 2, -1, -1):
            later = weight[k + 1] + behind[k + 1]
            behind[k] = np.logaddexp(later + stay[k + 1], logsumexp(later + move[k + 1]))
        total = logsumexp(ahead[-1])
        values[i] = temperature * total
        usage += np.exp(ahead + behind - total)
    return values, usage


@settings(max_examples=150, deadline=None)
@given(windows())
def test_values_and_usage_are_those_of_the_recursion(case: Case) -> None:
    """Also where the weight of a move, exp(-4000), is far below what floats can hold."""
    problem, oracle, prices, temperature = case
    values, usage = oracle.soft_paths(prices, temperature)
    expected, expected_usage = written_out(problem, prices, temperature)
    assert values == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert usage == pytest.approx(expected_usage, abs=1e-6)


@settings(max_examples=50, deadline=None)
@given(windows())
def test_cold_paths_are_the_best_ones(case: Case) -> None:
    """Near the temperature of nothing the values are those of the hard recursion."""
    _, oracle, prices, _ = case
    soft, usage = oracle.soft_paths(prices, 1e-9)
    best, _ = oracle.best_paths(prices)
    assert oracle.coldest == 0.0
    assert soft == pytest.approx(best, abs=1e-6)
    assert usage.sum(axis=1) == pytest.approx(np.full(oracle.shape[0], oracle.shape[1]), rel=1e-6)
