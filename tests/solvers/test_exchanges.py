"""Exchanges of segments: what they say a plan gains is what it gains, and no plan gets worse or infeasible."""

from __future__ import annotations

import numpy as np
import pytest
from pair_problems import KINDS, owners, problem_of, some_plan
from switching_problems import optimum, tiny

from sapopt import SAP, solve
from sapopt.domains.tiny import tiny_problems
from sapopt.dynamics import SyntheticSwitching
from sapopt.formulations.dual import ascend
from sapopt.solvers.dual_decomposition import DualDecomposition
from sapopt.solvers.dual_decomposition.exchanges.cells import good_cells
from sapopt.solvers.dual_decomposition.exchanges.kernels import anneal, draw
from sapopt.solvers.dual_decomposition.exchanges.rule import pair_rule, total_value


@pytest.mark.parametrize("kind", KINDS)
def test_values_are_those_of_the_problem(kind: str) -> None:
    """The compiled value of a plan is what `evaluate` says."""
    for seed in range(12):
        problem = problem_of(kind, seed)
        plan = some_plan(problem, np.random.default_rng(seed))
        if np.isfinite(problem.evaluate(plan).value):
            assert total_value(pair_rule(problem), plan) == pytest.approx(problem.evaluate(plan).value)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("temperature", [0.0, 0.2])
def test_gains_are_true(kind: str, temperature: float) -> None:
    """After an annealing the plan is feasible, gained what was said, and lost nothing where no loss is taken."""
    for seed in range(6):
        problem = problem_of(kind, seed)
        rng = np.random.default_rng(seed)
        plan = some_plan(problem, rng)
        before = problem.evaluate(plan).value
        if not np.isfinite(before):
            continue
        cells = np.argwhere(problem.benefits.dense() > -np.inf)[:, [1, 0, 2]].astype(np.int32)
        owner, dice = owners(problem, plan), rng.integers(1, 2**31 - 400, size=2)
        gained = anneal(pair_rule(problem), cells, plan, owner, dice, temperature, 3000, 0.1)
        assert problem.evaluate(plan).value == pytest.approx(before + gained)
        assert temperature > 0.0 or gained >= 0.0
        np.testing.assert_array_equal(owner, owners(problem, plan))


def test_other_rules_have_none() -> None:
    """Where more than two assignments in a row decide, or agents share a state, there is no such rule."""
    for name, problem in tiny_problems():
        local = name.startswith(("SwitchingCost", "SyntheticSwitching")) and problem.model.is_agent_local
        assert (pair_rule(problem) is not None) == local, name


@pytest.mark.parametrize("seed", range(4))
def test_losses_are_those_of_paths(seed: int) -> None:
    """A cell's loss is the agent's best path less the best one through the cell, found by closing all others."""
    problem = problem_of("uniform", 2 * seed)
    oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
    assert oracle is not None
    prices = ascend(oracle, max_iterations=30).prices
    cells = good_cells(problem, prices, 0.5)
    for i, k, j in cells[:20]:
        only = prices.copy()
        only[k] = np.where(np.arange(problem.m) == j, prices[k], np.inf)
        assert oracle.best_path(int(i), prices)[0] - oracle.best_path(int(i), only)[0] <= 0.5 + 1e-9


def test_numbers_are_spread_evenly() -> None:
    """Mean and variance of ten thousand draws, none of them 0 or 1."""
    dice = np.array([17, 4711])
    drawn = np.array([draw(dice) for _ in range(10_000)])
    assert 0.0 < drawn.min() < drawn.max() < 1.0
    assert abs(drawn.mean() - 0.5) < 0.01
    assert abs(drawn.var() - 1 / 12) < 0.003


def test_the_search_uses_them_and_stays_below_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where dives have nothing to say exchanges have their turn; the same seed gives the same plan."""
    monkeypatch.setattr("sapopt.solvers.dual_decomposition.portfolio.Dives.of", lambda problem, threads: None)
    problem = SAP(np.random.default_rng(0).random((32, 10, 14)), SyntheticSwitching(0.4, forfeit=0.2))
    options = DualDecomposition(iterations=30, rounds=3, sweeps=2, repricing=0)
    first, second = (solve(problem, options, seed=3) for _ in range(2))
    assert "exchanges" in {record["phase"] for record in first.trace}
    np.testing.assert_array_equal(first.plan, second.plan)
    assert first.bound is not None
    assert first.value <= first.bound


def test_never_above_the_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """On tiny problems of every form the plan is worth no more than the best of all plans."""
    monkeypatch.setattr("sapopt.solvers.dual_decomposition.portfolio._LEAST_CELLS", 0)
    for seed in range(12):
        problem = tiny(seed)
        result = solve(problem, DualDecomposition(iterations=40, rounds=3, sweeps=3), seed=seed)
        assert result.value <= optimum(problem) + 1e-9
