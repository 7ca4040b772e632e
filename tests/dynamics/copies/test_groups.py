"""Paths of groups of copies: valid for every plan, smoothed and plain forms alike, proofs and forgeries."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from copied_problems import Case, cases
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from strategies import arrays, plans_of

from sapopt import SAP, CertificateError, bound, certify, solve, verify
from sapopt.dynamics import SyntheticSwitching
from sapopt.dynamics.copies.groups import GroupPaths
from sapopt.dynamics.paths.oracles import FirstValueOracle, SoftPathOracle, SteppingOracle
from sapopt.formulations.dual import dual_value
from sapopt.formulations.dual.smooth import DampedOracle
from sapopt.proofs.plain import plain_bound
from sapopt.solvers import DualDecomposition, DualLookahead, Exact

eighths = st.integers(0, 8).map(lambda x: x / 4)


def grouped(case: Case) -> SAP:
    """The problem of a case, with all agents copies of one where none of them has copies."""
    labels = case.options["agent_of"]
    assume(len(labels) > 1)
    if len(set(labels)) == len(labels):
        labels = [0] * len(labels)
    return replace(case, options=case.options | {"agent_of": labels}).problem("sparse")


def oracle_of(problem: SAP) -> GroupPaths:
    """Its paths."""
    made = problem.model.path_oracle(problem.benefits, problem.initial_state())
    assert isinstance(made, GroupPaths)
    return made


@given(cases(groups=True), st.data())
def test_any_prices_bound_any_plan(case: Case, data: st.DataObject) -> None:
    """Whatever the prices of tasks and places: paths and prices are worth at least as much as every plan."""
    problem = grouped(case)
    oracle = oracle_of(problem)
    T, n, columns = oracle.shape
    prices = data.draw(arrays((T, columns), eighths))
    plan = data.draw(plans_of(problem.benefits.shape))
    here = dual_value(oracle, prices)
    assert here.bound >= problem.evaluate(plan).value
    assert plain_bound(problem, here.prices) == pytest.approx(here.value, abs=1e-9)
    assert (here.usage[:, : problem.m].sum(axis=1) == n).all()
    assert (here.usage[:, problem.m :].sum(axis=1) == n).all()
    for i in range(n):
        value, path = oracle.best_path(i, here.prices)
        assert value == here.path_values[i]
        np.testing.assert_array_equal(path, here.plan[:, i])


@settings(max_examples=15)
@given(cases(groups=True), st.data())
def test_smoothed_paths(case: Case, data: st.DataObject) -> None:
    """Smoothed values lie above the plain ones, come down to them, and have the usage for a slope."""
    problem = grouped(case)
    oracle = oracle_of(problem)
    assert isinstance(oracle, SoftPathOracle)
    assert isinstance(oracle, DampedOracle)
    T, n, columns = oracle.shape
    prices = data.draw(arrays((T, columns), eighths))
    values, _ = oracle.best_paths(prices)
    soft, usage = oracle.soft_paths(prices, 0.7)
    assert (soft >= values - 1e-9).all()
    np.testing.assert_allclose(usage[:, : problem.m].sum(axis=1), n)
    np.testing.assert_allclose(usage[:, problem.m :].sum(axis=1), n)
    bump = np.zeros(prices.shape)
    at = data.draw(st.integers(0, T - 1)), data.draw(st.integers(0, columns - 1))
    bump[at] = 1e-6
    slope = (oracle.soft_paths(prices - bump, 0.7)[0] - oracle.soft_paths(prices + bump, 0.7)[0]).sum()
    assert slope / 2e-6 == pytest.approx(usage[at], abs=1e-5)
    cold = max(1.05 * oracle.coldest, 0.01)
    np.testing.assert_allclose(
        oracle.soft_paths(prices, cold)[0], values, atol=cold * T * np.log(n * problem.m + 1) + 1e-9
    )


@settings(max_examples=15)
@given(cases(groups=True), st.data())
def test_stepping_and_first_values(case: Case, data: st.DataObject) -> None:
    """Going on by a step is the oracle of the rest; first values are the rule's first step and the best rest."""
    problem = grouped(case)
    oracle = oracle_of(problem)
    assert isinstance(oracle, FirstValueOracle)
    assert isinstance(oracle, SteppingOracle)
    T, n, columns = oracle.shape
    prices = data.draw(arrays((T, columns), eighths))
    plan = data.draw(plans_of(problem.benefits.shape))
    state = problem.initial_state()
    first = oracle.first_values(prices)
    after = problem.transition(0, state, plan[0])
    earned = problem.beta_hat(0, state)[np.arange(n), plan[0]]
    onward = np.zeros(n)
    if T > 1:
        rest = problem.model.path_oracle(problem.benefits.slice(1, T), after)
        onward = rest.best_paths(prices[1:])[0]
        went = oracle.after(plan[0])
        np.testing.assert_array_equal(went.best_paths(prices[1:])[0], onward)
        np.testing.assert_allclose(went.first_values(prices[1:]), rest.first_values(prices[1:]))
    np.testing.assert_allclose(first[np.arange(n), plan[0]], earned + onward)


@settings(max_examples=10)
@given(cases(plans=300, groups=True))
def test_plans_and_proofs(case: Case) -> None:
    """Plans are below the optimum and bounds above; a certificate holds, and what claims more does not."""
    problem = grouped(case)
    best = solve(problem, Exact(method="dp")).value
    result = solve(problem, DualDecomposition(iterations=60, rounds=2, sweeps=5))
    assert result.value <= best + 1e-9
    assert result.bound is not None
    assert result.bound >= best - 1e-9
    assert solve(problem, DualLookahead(2, iterations=5)).value <= best + 1e-9
    certificate = certify(problem, result)
    assert certificate.bound >= best - 1e-9
    assert verify(certificate, problem).bound == certificate.bound
    for forged in (
        replace(certificate, bound=np.nextafter(certificate.bound, -np.inf)),
        replace(certificate, value=certificate.value + 0.25),
        replace(certificate, prices=certificate.prices[:, : problem.m]),
        replace(certificate, prices=-1.0 - certificate.prices),
    ):
        with pytest.raises(CertificateError):
            verify(forged, problem)


def test_decayed_copies_are_bounded_tightly(tmp_path: Any) -> None:
    """Beams of falling worth: the bound is within a few percent of the optimum, and a file of the proof verifies."""
    rng = np.random.default_rng(0)
    base = rng.random((3, 2, 5)) * (rng.random((3, 2, 5)) < 0.8)
    benefits = base.repeat(2, axis=1) * np.array([1.0, 0.8, 1.0, 0.8])[:, None]
    problem = SAP(benefits, SyntheticSwitching(0.3, agent_of=[0, 0, 1, 1]))
    best = solve(problem, Exact(method="dp")).value
    proven = bound(problem)
    assert best <= proven.value <= 1.03 * best
    assert proven.prices is not None
    assert proven.prices.shape == (3, 5 + 4)
    result = solve(problem, DualDecomposition())
    certify(problem, result).save(tmp_path / "c.npz")
    assert verify(tmp_path / "c.npz", problem).bound <= 1.03 * best


def test_prices_of_a_wrong_shape() -> None:
    """The message tells that places have prices."""
    problem = SAP(np.ones((2, 2, 3)), SyntheticSwitching(agent_of=[0, 0]))
    with pytest.raises(ValueError, match=r"\(T, m \+ n\) = \(2, 5\)"):
        plain_bound(problem, np.zeros((2, 3)))
    with pytest.raises(ValueError, match="tasks, then places"):
        oracle_of(problem).best_paths(np.zeros((2, 3)))
