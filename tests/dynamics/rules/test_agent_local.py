"""Rule-based dynamics: everything that is derived from the rule agrees with the rule and with enumeration."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rule_problems import MAKERS, Learning, committing, learning, riding, slewing

from sapopt import SAP, bound, solve
from sapopt.data.windows import WindowSums
from sapopt.dynamics import AgentLocal
from sapopt.dynamics.paths.oracles import (
    FirstValueOracle,
    LocalModel,
    LocalOracle,
    SoftPathOracle,
    SteppingOracle,
)
from sapopt.solvers import HAA, HAAL, DualLookahead, Exact, Greedy, NoHandover

Make = Callable[[int], SAP]
makers = pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)


def oracles(problem: SAP) -> tuple[AgentLocal, LocalOracle]:
    """The compiled oracle and the plain one."""
    state = problem.initial_state()
    plain = problem.model.local_model(problem.benefits, state)
    assert isinstance(plain, LocalModel)
    return problem.model.path_oracle(problem.benefits, state), LocalOracle(problem.benefits, plain)


def random_prices(problem: SAP, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = (problem.T, problem.m)
    return rng.random(shape) * (rng.random(shape) < 0.6)


@makers
def test_compiled_paths_are_those_of_the_plain_recursion(make: Make) -> None:
    for seed in range(6):
        problem = make(seed)
        compiled, plain = oracles(problem)
        assert isinstance(compiled, FirstValueOracle)
        for prices in (np.zeros((problem.T, problem.m)), random_prices(problem, seed)):
            values, plan = compiled.best_paths(prices)
            expected, _ = plain.best_paths(prices)
            np.testing.assert_allclose(values, expected, atol=1e-9)
            for i in range(problem.n):
                value, path = compiled.best_path(i, prices)
                assert value == pytest.approx(expected[i])
                np.testing.assert_array_equal(path, plan[:, i])
                # The path is worth what it is said to be, by the rule itself.
                state = problem.initial_state()
                total = 0.0
                for k in range(problem.T):
                    row = np.delete(np.arange(problem.m), path[k])[: problem.n]
                    row[i] = path[k]
                    total += problem.beta_hat(k, state)[i, path[k]] - prices[k, path[k]]
                    state = problem.transition(k, state, row)
                assert total == pytest.approx(expected[i])
            np.testing.assert_allclose(compiled.first_values(prices), plain.first_values(prices), atol=1e-9)


@makers
def test_prices_of_infinity_forbid(make: Make) -> None:
    """With all tasks but one per step closed, that one is taken."""
    problem = make(1)
    compiled, plain = oracles(problem)
    rng = np.random.default_rng(0)
    for i in range(problem.n):
        prices = np.full((problem.T, problem.m), np.inf)
        only = rng.integers(0, problem.m, problem.T)
        prices[np.arange(problem.T), only] = 0.0
        value, path = compiled.best_path(i, prices)
        np.testing.assert_array_equal(path, only)
        assert value == pytest.approx(plain.best_path(i, prices)[0])


@makers
def test_placing_is_one_best_path_after_the_other(make: Make) -> None:
    for seed in range(4):
        problem = make(seed)
        compiled, _ = oracles(problem)
        prices = random_prices(problem, seed)
        plan = solve(problem, HAA()).plan.copy()
        expected, steps = plan.copy(), np.arange(problem.T)
        closed = prices.copy()
        closed[steps[:, None], plan] = np.inf
        still = closed.copy()
        order = np.random.default_rng(seed).permutation(problem.n)
        compiled.place(order, closed, prices, plan)
        for i in order:
            still[steps, expected[:, i]] = prices[steps, expected[:, i]]
            value, path = compiled.best_path(i, still)
            state, worth = problem.initial_state(), 0.0
            for k in range(problem.T):  # ties may differ, the value may not
                row = np.delete(np.arange(problem.m), plan[k, i])[: problem.n]
                row[i] = plan[k, i]
                worth += problem.beta_hat(k, state)[i, plan[k, i]] - still[k, plan[k, i]]
                state = problem.transition(k, state, row)
            assert worth == pytest.approx(value)
            expected[:, i] = plan[:, i]
            still[steps, expected[:, i]] = np.inf
        np.testing.assert_array_equal(closed, still)
        problem.check_plan(plan)


@makers
def test_after_a_step_the_paths_are_those_of_the_rest(make: Make) -> None:
    """Going on by a step and starting anew from the state that follows are the same, to the end of the horizon."""
    for seed in range(4):
        problem = make(seed)
        state, plan = problem.initial_state(), solve(problem, HAA()).plan
        onward = problem.model.path_oracle(problem.benefits, state)
        assert isinstance(onward, SteppingOracle)
        for k in range(problem.T - 1):
            onward = onward.after(plan[k])
            state = problem.transition(k, state, plan[k])
            anew = problem.model.path_oracle(problem.benefits.slice(k + 1, problem.T), state)
            assert onward.shape == anew.shape
            prices = 0.1 + random_prices(problem, seed)[k + 1 :]
            for mine, its in zip(onward.best_paths(prices), anew.best_paths(prices), strict=True):
                np.testing.assert_allclose(mine, its)
            np.testing.assert_allclose(onward.first_values(prices), anew.first_values(prices))
            for mine, its in zip(onward.soft_paths(prices, 0.3), anew.soft_paths(prices, 0.3), strict=True):
                np.testing.assert_allclose(mine, its)


def test_a_forbidden_step_is_refused() -> None:
    """Going on by a task that the rule forbids."""

    class Stubborn(Learning):
        def rule(self, k: int, agent: Any, local: Any, task: Any, benefit: Any) -> Any:
            eta, after = super().rule(k, agent, local, task, benefit)
            return np.where((benefit > 0) & (task == 1), -np.inf, eta), after

    problem = SAP(np.ones((2, 1, 3)), Stubborn(0.3))
    oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
    assert oracle.after(np.array([0])).shape == (1, 1, 3)
    with pytest.raises(ValueError, match="agent 0 may not take task 1"):
        oracle.after(np.array([1]))


@makers
def test_soft_paths(make: Make) -> None:
    """Cold: the hard values from above. Usage is the gradient, by differences, and adds up to one task an agent."""
    problem = make(2)
    compiled, _ = oracles(problem)
    assert isinstance(compiled, SoftPathOracle)
    prices = 0.1 + np.random.default_rng(3).random((problem.T, problem.m))  # no ties
    hard, _ = compiled.best_paths(prices)
    soft, _ = compiled.soft_paths(prices, 1e-4)
    assert (soft >= hard - 1e-12).all()
    np.testing.assert_allclose(soft, hard, atol=1e-2)
    _, usage = compiled.soft_paths(prices, 0.3)
    np.testing.assert_allclose(usage.sum(axis=1), problem.n)
    for k, j in ((0, 0), (1, 1), (problem.T - 1, problem.m - 1)):
        ends = []
        for sign in (1, -1):
            moved = prices.copy()
            moved[k, j] += sign * 1e-6
            ends.append(compiled.soft_paths(moved, 0.3)[0].sum())
        assert usage[k, j] == pytest.approx(-(ends[0] - ends[1]) / 2e-6, abs=1e-4)


@makers
def test_heuristics_exact_bound(make: Make) -> None:
    """Heuristic <= optimum by brute force = optimum by the network <= bound."""
    solvers = (NoHandover(), Greedy(), HAA(), HAAL(2), HAAL(3, keep_plan=True), DualLookahead(3))
    for seed in range(4):
        problem = make(seed)
        best = solve(problem, Exact(method="dp")).value
        assert solve(problem, Exact(method="network")).value == pytest.approx(best, abs=1e-6)
        assert bound(problem, time_limit=1.0).value >= best - 1e-9
        for solver in solvers:
            assert solve(problem, solver).value <= best + 1e-9


@makers
def test_without_competition_the_bound_is_met(make: Make) -> None:
    """A single agent meets no other: free prices prove its optimum, and the dual lookahead over all steps finds it."""
    problem = make(5)
    alone = {"n": 1} if make is not committing else {"n": 1, "blocks": 3}
    problem = make(5, **alone)
    best = solve(problem, Exact(method="dp")).value
    assert bound(problem).value == pytest.approx(best, abs=1e-6)
    assert solve(problem, DualLookahead(problem.T)).value == pytest.approx(best, abs=1e-6)


@makers
def test_interval_is_what_holding_brings(make: Make) -> None:
    """An interval's matrix holds, up to nothing, the value of holding a task from `start` on, agent by agent."""
    problem = make(3)
    windows = WindowSums(problem.benefits)
    sparse = WindowSums(SAP([*map(_csr, problem.benefits.dense())], problem.dynamics).benefits)
    state = problem.transition(0, problem.initial_state(), np.arange(problem.n))
    for stop in (2, 3, problem.T):
        matrices = [problem.model.interval(w, 1, stop, state) for w in (windows, sparse)]
        for matrix in matrices:
            # rows are right up to a constant each that sums up to nothing
            full = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
            expected = np.empty((problem.n, problem.m))
            for i in range(problem.n):
                for j in range(problem.m):
                    row = np.delete(np.arange(problem.m), j)[: problem.n]
                    row[i] = j
                    now, total = state, 0.0
                    for k in range(1, stop):
                        total += problem.beta_hat(k, now)[i, j]
                        now = problem.transition(k, now, row)
                    expected[i, j] = total
            shift = expected - full
            np.testing.assert_allclose(shift, np.repeat(shift[:, :1], problem.m, axis=1), atol=1e-9)
            assert shift[:, 0].sum() == pytest.approx(0.0, abs=1e-9)


def _csr(step: np.ndarray) -> object:
    import scipy.sparse as sp

    return sp.csr_array(step)


@makers
def test_forms_of_the_handover_agree(make: Make) -> None:
    problem = make(4)
    rng = np.random.default_rng(0)
    state = problem.initial_state()
    for k in range(problem.T):
        row = rng.permutation(problem.m)[: problem.n]
        eta = problem.handover(k, state)
        np.testing.assert_array_equal(
            problem.model.handover_at(k, state, row), eta[np.arange(problem.n), row]
        )
        idle = problem.benefits.dense()[k] == 0
        for i in range(problem.n):
            assert len(set(eta[i, idle[i]])) <= 1  # where there is no benefit, all tasks are the same
        state = problem.transition(k, state, row)


@pytest.mark.parametrize("make", [slewing, riding, committing])
def test_save_load_fingerprint(make: Make, tmp_path: Path) -> None:
    problem = make(1)
    problem.save(tmp_path / "p.npz")
    again = SAP.load(tmp_path / "p.npz")
    assert again.fingerprint == problem.fingerprint
    plan = solve(problem, HAA()).plan
    assert again.evaluate(plan).value == problem.evaluate(plan).value
    for item in dataclasses.fields(problem.dynamics):
        if item.name == "benefits":
            continue
        value = np.asarray(getattr(problem.dynamics, item.name))
        if item.name in ("pick_up", "drop_off", "home"):
            other = (value + 1) % len(problem.dynamics.travel)
        elif item.name == "travel":
            other = value + 1 - np.eye(len(value), dtype=np.int64)
        else:
            other = -value if item.name == "initial" else value + 1
        if value.ndim == 0:
            other = other.item()
        changed = dataclasses.replace(problem.dynamics, **{item.name: other})
        assert SAP(problem.benefits, changed, problem.initial_assignment).fingerprint != problem.fingerprint


def test_own_rule_cannot_be_written() -> None:
    """Files hold data, never code."""
    with pytest.raises(ValueError, match="user-defined"):
        learning(0).save("never.npz")


def test_unbound() -> None:
    with pytest.raises(ValueError, match="belongs to no problem"):
        Learning().handover(0, learning(0).initial_state())


def test_agents_alike_with_different_benefits() -> None:
    """Agents share a graph only if their benefits are equal too."""
    problem = riding(0)
    assert problem.model.path_oracle(problem.benefits, problem.initial_state()).graph.rows == 1
    benefits = problem.benefits.dense().copy()
    k, i, r = (int(x[0]) for x in np.nonzero(benefits))
    benefits[k, i, r] += 1.0
    other = SAP(benefits, problem.dynamics)
    compiled, plain = oracles(other)
    assert compiled.graph.rows == other.n
    prices = random_prices(other, 1)
    np.testing.assert_allclose(compiled.best_paths(prices)[0], plain.best_paths(prices)[0])


def test_prices_of_the_wrong_shape() -> None:
    compiled, _ = oracles(slewing(0))
    with pytest.raises(ValueError, match="prices: expected shape"):
        compiled.best_paths(np.zeros((1, 1)))


@makers
def test_relabelling_agents_changes_nothing(make: Make) -> None:
    """Only the rule's own data know an agent by its number; permuted along with it, the optimum stays."""
    problem = make(6)
    order = np.arange(problem.n)[::-1]
    dynamics = problem.dynamics
    changes = {}
    for name in (
        "satellites_km",
        "home",
        "start_up",
        "minimum_up",
        "minimum_down",
        "idling",
        "initial",
        "shut_down",
    ):
        if hasattr(dynamics, name):
            value = getattr(dynamics, name)
            changes[name] = value[:, order] if name == "satellites_km" else value[order]
    start = problem.initial_assignment
    other = SAP(
        problem.benefits.dense()[:, order],
        dataclasses.replace(dynamics, **changes),
        None if start is None else start[order],
    )
    best = solve(problem, Exact(method="dp")).value
    assert solve(other, Exact(method="dp")).value == pytest.approx(best)
