"""Agents that hold nothing beside others that do: every way to say what they pay agrees with the plain states."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import Benefits, SwitchingCost
from sapopt.data.matrices import GainMatrix
from sapopt.data.windows import WindowSums
from sapopt.dynamics.paths.first_rows import FirstRowsOracle
from sapopt.dynamics.paths.oracles import FirstValueOracle, LocalOracle, SoftPathOracle

T, N, M = 3, 3, 4
COSTS = 0.3 * (1.0 - np.eye(M)) + 0.1 * np.triu(np.ones((M, M)), 1)


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.sampled_from(["one cost", "idle is free", "matrix"]), st.booleans())
def test_paths_and_matrices_agree(seed: int, kind: str, sparse: bool) -> None:
    """Paths, first values, handover matrices, entries and intervals are those of the states in plain words."""
    rng = np.random.default_rng(seed)
    dense = np.round(rng.random((T, N, M)), 2) * (rng.random((T, N, M)) < 0.5)
    benefits = Benefits([sp.csr_array(step) for step in dense]) if sparse else Benefits(dense)
    rule = SwitchingCost(COSTS if kind == "matrix" else 0.3, kind == "idle is free").bind(benefits)
    state = rng.permutation(M)[:N]
    state[rng.random(N) < 0.5] = -1
    plain = LocalOracle(benefits, rule.local_model(benefits, state))
    oracle = rule.path_oracle(benefits, state)
    prices = np.round(rng.random((T, M)), 1) * 0.3
    values, plan = oracle.best_paths(prices)
    assert values == pytest.approx(plain.best_paths(prices)[0], abs=1e-12)
    assert oracle.best_path(1, prices)[0] == pytest.approx(values[1], abs=1e-12)
    assert isinstance(oracle, FirstValueOracle)
    firsts = plain.first_values(prices)
    assert oracle.first_values(prices) == pytest.approx(firsts, abs=1e-12)
    if isinstance(oracle, FirstRowsOracle):
        assert oracle.first_rows(prices).toarray() == pytest.approx(firsts, abs=1e-12)
    if isinstance(oracle, SoftPathOracle):
        # the softened maximum is never below the maximum, and above it by no more than all paths count
        soft, usage = oracle.soft_paths(prices, 0.05)
        assert (soft >= values - 1e-9).all()
        assert (soft <= values + 0.05 * np.log(float(M**T)) + 1e-9).all()
        assert usage.sum() == pytest.approx(T * N)
    eta = rule.handover(0, state)
    windows = WindowSums(benefits)
    hat = rule.interval(windows, 0, 2, state)
    expected = dense[0] + dense[1] + eta
    assert (hat.toarray() if isinstance(hat, GainMatrix) else hat) == pytest.approx(expected, abs=1e-12)
    for tasks in itertools.permutations(range(M), N):
        chosen = np.array(tasks)
        assert np.array_equal(rule.handover_at(0, state, chosen) + 0.0, eta[np.arange(N), chosen] + 0.0)
    for i in np.flatnonzero(state < 0):
        charged = dense[0, i] > 0 if kind == "idle is free" else np.ones(M, dtype=bool)
        assert np.array_equal(eta[i], np.where(charged, 0.0 if kind == "matrix" else -0.3, 0.0) + 0.0)
