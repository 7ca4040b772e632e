"""Dives: what they say a plan gains is what it gains, and no plan gets worse or infeasible."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pair_problems import KINDS, owners, problem_of, some_plan
from switching_problems import optimum, tiny

from sapopt import SAP, SwitchingCost, solve
from sapopt.data.types import IntArray
from sapopt.dynamics.paths.oracles import path_oracle
from sapopt.formulations.dual import ascend
from sapopt.kernels.jit import compiled_always
from sapopt.solvers.dual_decomposition import DualDecomposition
from sapopt.solvers.dual_decomposition.dives.candidates import candidates, work_for
from sapopt.solvers.dual_decomposition.dives.kernels import Pace, dive
from sapopt.solvers.dual_decomposition.exchanges.rule import pair_rule


def dived(
    problem: SAP, plan: IntArray, agents: Any, first: int, last: int, *, widest: int = 99, least: float = -np.inf,
    cells: Any = None, over: int = 0,
) -> tuple[float, IntArray]:  # fmt: skip
    """A dive from a plan, of which the owners are kept along; the gain and the new plan."""
    rule = pair_rule(problem)
    if cells is None:
        cells = np.argwhere(problem.benefits.dense() > -np.inf)[:, [1, 0, 2]].astype(np.int32)
    listed = candidates(rule, cells, plan, widest)
    work = work_for(listed, (problem.T, problem.n, problem.m))
    oracle = path_oracle(problem.model, problem.benefits, problem.initial_state())
    prices = ascend(oracle, max_iterations=40).prices
    new, owner = plan.copy(), owners(problem, plan)
    pace = Pace(0.05, np.exp(-rule.matrix / 0.05), 10, 0.02, 0.98)
    gained = dive(
        rule, listed, pace, new, owner, np.asarray(agents), first, last, prices, least, np.array([over]), work
    )
    np.testing.assert_array_equal(owner, owners(problem, new))
    return gained, new


@pytest.mark.parametrize("kind", KINDS)
def test_gains_are_true(kind: str) -> None:
    """The plan after a dive is feasible and gained what was said; only the agents and steps asked for changed."""
    for seed in range(8):
        problem = problem_of(kind, seed)
        rng = np.random.default_rng(seed)
        plan = some_plan(problem, rng)
        if not np.isfinite(before := problem.evaluate(plan).value):
            continue
        first = int(rng.integers(0, problem.T))
        last = int(rng.integers(first + 1, problem.T + 1))
        agents = np.sort(rng.permutation(problem.n)[: 1 + seed % problem.n])
        gained, new = dived(problem, plan, agents, first, last)
        if np.isfinite(gained):
            assert problem.evaluate(new).value == pytest.approx(before + gained)
        assert np.isfinite(gained) == bool(np.isfinite(problem.evaluate(new).value)) or (new == plan).all()
        kept = np.ones_like(plan, dtype=bool)
        kept[first:last, agents] = False
        np.testing.assert_array_equal(new[kept], plan[kept])


def test_a_loss_is_taken_back() -> None:
    """From an optimal plan nothing is gained, and the plan stays as it is."""
    for seed in range(6):
        problem = problem_of("uniform", 3 * seed + 1)
        best = solve(problem, DualDecomposition(), seed=0).plan
        gained, new = dived(problem, best, np.arange(problem.n), 0, problem.T, least=1e-6)
        if gained == -np.inf:
            np.testing.assert_array_equal(new, best)
        else:
            assert problem.evaluate(new).value > problem.evaluate(best).value


def test_agents_without_a_candidate_get_what_is_left() -> None:
    """Where all agents want the same few tasks, or none but those of a poor plan are listed, the plan is whole."""
    problem = problem_of("uniform", 1)
    plan = some_plan(problem, np.random.default_rng(1))
    few = np.array([[i, k, j] for i in range(problem.n) for k in range(problem.T) for j in (0, 1)], np.int32)
    for cells, widest in ((few, 2), (few[:0], 1)):
        gained, new = dived(problem, plan, np.arange(problem.n), 0, problem.T, widest=widest, cells=cells)
        assert problem.evaluate(new).value == pytest.approx(problem.evaluate(plan).value + gained)


def test_the_end_of_the_time_leaves_the_plan() -> None:
    """A dive that is stopped changes nothing."""
    problem = problem_of("matrix", 1)
    plan = some_plan(problem, np.random.default_rng(1))
    gained, new = dived(problem, plan, np.arange(problem.n), 0, problem.T, over=1)
    assert gained == -np.inf
    np.testing.assert_array_equal(new, plan)


def test_a_dive_finds_good_plans() -> None:
    """On dense problems with a task for every agent one dive over the whole horizon is within 3 % of the bound."""
    problem = SAP(np.random.default_rng(0).random((8, 8, 8)), SwitchingCost(0.5))
    plan = np.tile(np.arange(8), (8, 1))
    oracle = path_oracle(problem.model, problem.benefits, None)
    with compiled_always():
        gained, _ = dived(problem, plan, np.arange(8), 0, 8)
    assert problem.evaluate(plan).value + gained > 0.97 * ascend(oracle, max_iterations=200).bound


def test_the_search_uses_them_and_stays_below_the_bound() -> None:
    """On problems whose gap stays open dives have their turn; the same seed gives the same plan."""
    problem = SAP(np.random.default_rng(0).random((32, 10, 10)), SwitchingCost(0.5))
    options = DualDecomposition(iterations=30, rounds=3, sweeps=2, repricing=0)
    first, second = (solve(problem, options, seed=3) for _ in range(2))
    assert "dives" in {record["phase"] for record in first.trace}
    np.testing.assert_array_equal(first.plan, second.plan)
    assert first.bound is not None
    assert first.value <= first.bound


def test_large_problems_have_them_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planning from sparse values of windows is followed by dives and exchanges where there is time."""
    monkeypatch.setattr("sapopt.solvers.dual_decomposition.solver._LARGE", 0)
    rng = np.random.default_rng(2)
    benefits = rng.random((32, 10, 12)) * (rng.random((32, 10, 12)) < 0.7)
    problem = SAP(benefits, SwitchingCost(0.4))
    result = solve(problem, DualDecomposition(iterations=40, rounds=4, sweeps=2, repricing=0), seed=0)
    assert {"dives", "exchanges"} & {record["phase"] for record in result.trace}
    assert result.bound is not None
    assert result.value <= result.bound


def test_never_above_the_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """On tiny problems of every form the plan is worth no more than the best of all plans."""
    monkeypatch.setattr("sapopt.solvers.dual_decomposition.portfolio._LEAST_CELLS", 0)
    for seed in range(12, 20):
        problem = tiny(seed)
        result = solve(problem, DualDecomposition(iterations=40, rounds=4, sweeps=3), seed=seed)
        assert result.value <= optimum(problem) + 1e-9
