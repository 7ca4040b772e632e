"""Switching costs of copies: the rule, pair by pair; sparse, dense and compiled forms against it."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from copied_problems import Case, cases
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import FORMS, arrays, as_form, plans_of

from sapopt import SAP, Benefits, SwitchingCost, bound, certify, solve, verify
from sapopt.data.matrices import GainMatrix
from sapopt.data.windows import WindowSums
from sapopt.dynamics import SyntheticSwitching
from sapopt.dynamics.paths.oracles import FirstValueOracle, LocalOracle, SoftPathOracle, path_oracle
from sapopt.solvers import HAA, HAAL, DualDecomposition, DualLookahead, Exact, Greedy, NoHandover


@settings(max_examples=30)
@given(cases(), st.data())
def test_evaluation_is_the_rule(case: Case, data: st.DataObject) -> None:
    """Every form of the benefits gives the value of the rule; so do the full handover matrices."""
    plan = data.draw(plans_of(case.benefits.shape))
    for form in FORMS:
        problem = case.problem(form)
        found = problem.evaluate(plan)
        assert found.value == pytest.approx(case.score(plan))
        state, total = problem.initial_state(), 0.0
        for k, row in enumerate(plan):
            total += problem.beta_hat(k, state)[np.arange(problem.n), row].sum()
            state = problem.transition(k, state, row)
        assert total == pytest.approx(found.value)


@settings(max_examples=30)
@given(cases(), st.data())
def test_intervals(case: Case, data: st.DataObject) -> None:
    """The sparse matrix of an interval is the dense one: window sum plus the handover at its first step."""
    steps, n, m = case.benefits.shape
    start = data.draw(st.integers(0, steps - 1))
    stop = data.draw(st.integers(start + 1, steps))
    before = np.array(data.draw(st.permutations(range(m)))[:n])
    for form in FORMS:
        problem = case.problem(form)
        state = problem.initial_state() if start == 0 else problem.transition(start - 1, None, before)
        expected = case.benefits[start:stop].sum(axis=0) + problem.handover(start, state)
        windows = WindowSums(Benefits(as_form(case.benefits, form)))  # in just this form, whatever suits it
        matrix = problem.model.interval(windows, start, stop, state)
        if form.startswith("sparse"):
            assert isinstance(matrix, GainMatrix), "a sparse problem must never become dense"
        values = matrix.toarray() if isinstance(matrix, GainMatrix) else matrix
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-12)


@settings(max_examples=12)
@given(cases(plans=600))
def test_exact_heuristics_and_bound(case: Case) -> None:
    """Heuristic <= exact = best of all plans <= bound."""
    problem, best = case.problem("sparse"), case.best()
    found = solve(problem, Exact(method="dp"))
    assert found.value == pytest.approx(best)
    solvers: list[Any] = [HAA(), HAAL(2), Greedy(), NoHandover()]
    if problem.model.is_agent_local:
        solvers.append(DualLookahead(2, iterations=5))
    for solver in solvers:
        assert solve(problem, solver).value <= best + 1e-9
    assert bound(problem, time_limit=0.1).value >= best - 1e-9


@settings(max_examples=15)
@given(cases(plans=500, groups=False))
def test_network_and_certificate(case: Case) -> None:
    """Without copies of agents the network solves it, and a certificate verifies with the plain recursion."""
    problem = case.problem("sparse")
    found = solve(problem, Exact())
    assert found.value == pytest.approx(case.best())
    certificate = certify(problem, found, time_limit=0.2)
    assert certificate.value == pytest.approx(found.value)
    assert certificate.bound >= found.value - 1e-9


@given(cases(groups=False), st.data())
def test_paths_are_those_of_the_plain_model(case: Case, data: st.DataObject) -> None:
    """Values, plans and first values of the compiled oracle against the generic one; soft values against both."""
    problem = case.problem("sparse")
    T, n, m = case.benefits.shape
    state = problem.initial_state()
    oracle = problem.model.path_oracle(problem.benefits, state)
    assert isinstance(oracle, SoftPathOracle)
    assert isinstance(oracle, FirstValueOracle)
    plain = LocalOracle(case.benefits, problem.model.local_model(problem.benefits, state))
    prices = data.draw(arrays((T, m), st.integers(0, 8).map(lambda x: x / 4)))
    values, plan = oracle.best_paths(prices)
    np.testing.assert_allclose(values, plain.best_paths(prices)[0], atol=1e-12)
    np.testing.assert_allclose(oracle.first_values(prices), plain.first_values(prices), atol=1e-12)
    alone = {**case.options, "agent_of": None}
    for i in range(n):
        one = Case(case.benefits[:, [i]], alone, None if case.initial is None else (case.initial[i],))
        paid = prices[np.arange(T), plan[:, i]].sum()
        assert one.score(plan[:, [i]]) - paid == pytest.approx(values[i])
        assert oracle.best_path(i, prices)[0] == pytest.approx(values[i])
    warm, step = 0.7, 1e-6
    soft, usage = oracle.soft_paths(prices, warm)
    np.testing.assert_allclose(usage.sum(axis=1), n)
    assert (soft >= values - 1e-9).all()
    bump = np.zeros((T, m))
    at = data.draw(st.integers(0, T - 1)), data.draw(st.integers(0, m - 1))
    bump[at] = step
    slope = (oracle.soft_paths(prices - bump, warm)[0] - oracle.soft_paths(prices + bump, warm)[0]).sum()
    assert slope / (2 * step) == pytest.approx(usage[at], abs=1e-5)
    cold = max(oracle.coldest, 0.01)
    np.testing.assert_allclose(
        oracle.soft_paths(prices, cold)[0], values, atol=cold * T * np.log(m + 1) + 1e-9
    )


def test_no_copies_is_switching_cost() -> None:
    """Without copies and forfeit every solver finds what it finds with `SwitchingCost`."""
    benefits = np.random.default_rng(2).random((5, 3, 5))
    for free in (False, True):
        plain = SAP(benefits, SwitchingCost(0.3, idle_is_free=free), [0, 1, 2])
        copy = SAP(benefits, SyntheticSwitching(0.3, idle_is_free=free), [0, 1, 2])
        for solver in (HAA(), HAAL(3), DualLookahead(3)):
            assert solve(copy, solver).value == pytest.approx(solve(plain, solver).value)
        assert bound(copy).value == pytest.approx(bound(plain).value, rel=1e-3)


def test_keys_forget_which_copy() -> None:
    """States that differ only in which copy holds what are one state; others are not."""
    model = SAP(np.zeros((1, 4, 5)), SyntheticSwitching(1.0, agent_of=[0, 0, 1, 1])).model
    assert model.key(np.array([3, 1, 0, 2])) == model.key(np.array([1, 3, 2, 0]))
    assert model.key(np.array([3, 1, 0, 2])) != model.key(np.array([3, 0, 1, 2]))
    assert model.key(None) != model.key(np.array([0, 1, 2, 3]))


def test_only_local_models_are_local() -> None:
    """The state of copies is that of their group, whose paths have prices of places too; see test_groups."""
    benefits = np.ones((2, 2, 3))
    local = SAP(benefits, SyntheticSwitching(task_of=[0, 0, 1])).model
    assert local.is_agent_local
    assert not local.has_places
    grouped = SAP(benefits, SyntheticSwitching(agent_of=[0, 0])).model
    assert not grouped.is_agent_local
    assert grouped.local_model(grouped.benefits, None) is None
    assert grouped.takes_prices
    assert grouped.price_columns(2, 3) == 5


def test_files(tmp_path: Path) -> None:
    """Every field survives a file, and a certificate of the loaded problem verifies."""
    dynamics = SyntheticSwitching(0.2, 0.5, None, [0, 0, 1, 2], True, True)
    problem = SAP(np.random.default_rng(1).random((4, 2, 4)), dynamics, [0, 2])
    problem.save(tmp_path / "p.npz")
    again = SAP.load(tmp_path / "p.npz")
    assert again.fingerprint == problem.fingerprint
    assert repr(again.dynamics) == repr(dynamics)
    result = solve(again, DualLookahead(2))
    certify(again, result).save(tmp_path / "c.npz")
    assert verify(tmp_path / "c.npz", problem).value == pytest.approx(result.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cost": -1.0}, "cost must be a number, finite and not negative"),
        ({"cost": np.zeros((2, 2))}, "cost must be a number"),
        ({"forfeit": 1.5}, "forfeit must be a number, between 0 and 1"),
        ({"agent_of": [0, -1]}, "agent_of"),
        ({"task_of": [[0, 1]]}, "task_of"),
        ({"idle_is_free": 1}, "idle_is_free must be True or False"),
        ({"needs_sight": "yes"}, "needs_sight must be True or False"),
    ],
)
def test_bad_options(options: dict[str, Any], message: str) -> None:
    """Each is a ValueError that names the argument."""
    with pytest.raises(ValueError, match=message):
        SyntheticSwitching(**options)


def test_labels_must_fit() -> None:
    """One label for every agent and every task."""
    with pytest.raises(ValueError, match="agent_of has 2 labels, but the benefits have 3 agents"):
        SAP(np.ones((1, 3, 3)), SyntheticSwitching(agent_of=[0, 1]))


@pytest.mark.parametrize("start", [None, [0, 1]])
def test_no_weight_in_the_range_of_floats(start: list[int] | None) -> None:
    """High prices on all that an agent may hold leave no weight: nothing is divided by it."""
    benefits = np.array([[[0.703, 0.277], [0.216, -np.inf]], [[0.126, 0.163], [-np.inf, 0.771]]])
    for dynamics in (
        SyntheticSwitching(0.25, 0.5, task_of=[1, 0]), SyntheticSwitching(0.25, 0.5),
        SyntheticSwitching(0.0, 1.0, idle_is_free=True, needs_sight=True),
    ):  # fmt: skip
        problem = SAP(benefits, dynamics, start)
        best = solve(problem, Exact(method="dp")).value
        assert best <= bound(problem).value < 3.0
        for method in (DualDecomposition(), DualLookahead(2), Exact()):
            result = solve(problem, method)
            assert result.value == pytest.approx(best)
            assert result.bound is None or result.bound >= best - 1e-12


@pytest.mark.parametrize("temperature", [100.0, 1.0, 0.01])
@pytest.mark.parametrize("seed", range(12))
def test_smoothed_paths_where_much_is_forfeited(seed: int, temperature: float) -> None:
    """Against all paths, one by one: what is forfeited may be a hundred thousand temperatures."""
    rng = np.random.default_rng(seed)
    T, m = 4, 4
    benefits = np.where(
        rng.random((T, 1, m)) < 0.5, 0.0, np.round(10.0 ** rng.uniform(-2.0, 3.0, (T, 1, m)), 3)
    )
    benefits[rng.random(benefits.shape) < 0.1] *= -1.0
    start = (int(rng.integers(m)),) if seed % 2 else None
    dynamics = SyntheticSwitching(0.0, 1.0, task_of=[0, 0, 1, 2] if seed % 3 else None, needs_sight=True)
    problem = SAP(benefits, dynamics, start)
    prices = np.where(rng.random((T, m)) < 0.5, 0.0, 10.0 ** rng.uniform(-2.0, 2.0, (T, m)))
    plans = np.array(list(product(range(m), repeat=T)))
    worth = np.array([problem.evaluate(plan[:, None]).value for plan in plans])
    worth -= prices[np.arange(T), plans].sum(axis=1)
    weight = np.exp((worth - worth.max()) / temperature)
    oracle = path_oracle(problem.model, problem.benefits, problem.initial_state())
    assert isinstance(oracle, SoftPathOracle)
    assert oracle.coldest <= temperature
    values, usage = oracle.soft_paths(prices, temperature)
    assert values[0] == pytest.approx(worth.max() + temperature * np.log(weight.sum()), rel=1e-12)
    shares = [[weight[plans[:, k] == j].sum() / weight.sum() for j in range(m)] for k in range(T)]
    np.testing.assert_allclose(usage, shares, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_smoothed_paths_at_any_prices(seed: int) -> None:
    """However high the prices, smoothed values are no numbers or above the longest paths."""
    rng = np.random.default_rng(seed)
    benefits = np.where(rng.random((3, 2, 3)) < 0.2, -np.inf, rng.random((3, 2, 3)) - 0.2)
    benefits[:, [0, 1], [0, 1]] = 0.1  # some plan is allowed
    idle, sight = bool(rng.integers(2)), bool(rng.integers(2))
    problem = SAP(benefits, SyntheticSwitching(0.3, 0.5, idle_is_free=idle, needs_sight=sight))
    oracle = path_oracle(problem.model, problem.benefits, None)
    cold = 1.05 * max(oracle.coldest, 1e-3)
    for size in (1.0, 1e3, 1e6):
        prices = size * rng.random((3, 3))
        values, usage = oracle.soft_paths(prices, cold)
        if np.isfinite(values).all():
            assert (values >= oracle.best_paths(prices)[0] - 1e-9 * size).all()
            assert size > 1.0 or usage.sum(axis=1) == pytest.approx(2.0, rel=1e-6)
    lifted, _ = oracle.soft_paths(np.full((3, 3), 1e6), cold)
    level, _ = oracle.soft_paths(np.zeros((3, 3)), cold)
    np.testing.assert_allclose(lifted + 3e6, level, rtol=0, atol=1e-6)
