"""Networks of windows: with hubs and without them the same optimum, with further rows too."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from switching_problems import walking

from sapopt import SAP, SwitchingCost
from sapopt.running.rollout import rollout
from sapopt.solvers import HAA
from sapopt.solvers.dual_decomposition.network_plans import flow_programme as module
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.flow_programme import solve_flow
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import (
    RestrictedFlow,
    restricted_flow,
)


def everywhere(problem: SAP, regret: float = np.inf) -> tuple[RestrictedFlow, np.ndarray, Arrays]:
    """The network of all agents and steps within a regret, without prices, around HAA's plan."""
    arrays = Arrays.of(problem)
    plan = rollout(problem, HAA()).plan
    parking = np.tile(np.arange(problem.m), (problem.n, 1))
    flow = restricted_flow(
        arrays, plan, np.zeros((problem.T, problem.m)), np.arange(problem.n), 0, problem.T, regret, parking
    )
    return flow, plan, arrays


def directly(flow: RestrictedFlow) -> module._Columns:
    """Every arc a column of its own."""
    return module._Columns(flow.tail, flow.head, np.arange(len(flow.tail)), 0)


def both(
    flow: RestrictedFlow, plan: np.ndarray, arrays: Arrays, monkeypatch: pytest.MonkeyPatch, **options: object
) -> tuple[np.ndarray, np.ndarray]:
    """The plans with hubs and without."""
    hubs = solve_flow(flow, plan, arrays.tasks, **options)  # type: ignore[arg-type]
    with monkeypatch.context() as patch:
        patch.setattr(module, "_columns", directly)
        pairs = solve_flow(flow, plan, arrays.tasks, **options)  # type: ignore[arg-type]
    assert hubs is not None
    assert pairs is not None
    return hubs, pairs


@pytest.mark.parametrize("idle_is_free", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_hubs_and_pairs_have_the_same_optimum(
    seed: int, idle_is_free: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moves that meet in a hub earn what they earn pair by pair."""
    problem = walking(seed, T=8, n=4, m=6)
    problem = SAP(problem.benefits, SwitchingCost(0.4, idle_is_free=idle_is_free), problem.initial_assignment)
    flow, plan, arrays = everywhere(problem)
    columns = module._columns(flow)
    assert columns.hubs == problem.n * (problem.T - 1)
    assert len(columns.tail) < len(flow.tail) / 1.5
    hubs, pairs = both(flow, plan, arrays, monkeypatch)
    assert arrays.value(hubs) == pytest.approx(arrays.value(pairs), abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_what_a_regret_leaves_out_may_come_back_by_a_hub(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hub joins every tail with every head, so its optimum is the better one, never the worse."""
    flow, plan, arrays = everywhere(walking(seed, T=10, n=5, m=8), regret=0.8)
    hubs, pairs = both(flow, plan, arrays, monkeypatch)
    assert arrays.value(hubs) >= arrays.value(pairs) - 1e-6
    assert arrays.value(pairs) >= arrays.value(plan) - 1e-6


def test_moves_that_cost_by_the_pair_are_listed_by_the_pair() -> None:
    """Under a matrix of costs there is nothing to share."""
    rng = np.random.default_rng(0)
    cost = rng.random((6, 6))
    np.fill_diagonal(cost, 0.0)
    base = walking(1, T=6, n=4, m=6)
    flow, _, _ = everywhere(SAP(base.benefits, SwitchingCost(cost)))
    columns = module._columns(flow)
    assert columns.hubs == 0
    np.testing.assert_array_equal(columns.arc, np.arange(len(flow.tail)))


@pytest.mark.parametrize("seed", range(4))
def test_further_rows_count_moves_through_hubs(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """At most as many moves for every agent as in HAA's plan, less one where there are some: the same with hubs."""
    problem = walking(seed, T=8, n=4, m=6)
    flow, plan, arrays = everywhere(problem)
    moves = (flow.tail >= 0) & (flow.task[flow.tail] != flow.task[flow.head])
    hit = np.flatnonzero(moves)
    rows = sp.csr_array((np.ones(len(hit)), (flow.agent[flow.head[hit]], hit)), shape=(problem.n, len(moves)))
    made = (np.diff(plan, axis=0) != 0).sum(axis=0)
    limits = (rows, made.astype(float))
    hubs, pairs = both(flow, plan, arrays, monkeypatch, limits=limits)
    assert arrays.value(hubs) == pytest.approx(arrays.value(pairs), abs=1e-6)
    assert ((np.diff(hubs, axis=0) != 0).sum(axis=0) <= made).all()
