"""The time-expanded network: paths are plans, its relaxation the Lagrangian bound, regrets what they claim."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from local_dynamics import Dictator, Tiring

from sapopt import SAP, SwitchingCost
from sapopt.dynamics.paths.oracles import path_oracle
from sapopt.formulations import network
from sapopt.formulations.dual import ascend
from sapopt.formulations.highs import Ending, SolverError, maximise
from sapopt.formulations.network import NetworkOracle

RNG = np.random.default_rng


def problems() -> list[SAP]:
    """Every cost rule, with and without an initial assignment, and a user's local dynamics."""
    out = []
    for seed, (matrix, free, initial) in enumerate(
        itertools.product((False, True), (False, True), (None, (1, 0)))
    ):
        rng = RNG(seed)
        benefits = rng.random((4, 2, 4)) * (rng.random((4, 2, 4)) < 0.7)
        cost: Any = rng.random((4, 4)) * (1 - np.eye(4)) if matrix else 0.4
        out.append(SAP(benefits, SwitchingCost(cost, idle_is_free=free), initial))
    out.append(SAP(RNG(9).random((4, 2, 4)) * (RNG(8).random((4, 2, 4)) < 0.6), Tiring(0.3)))
    return out


@pytest.mark.parametrize("problem", problems(), ids=repr)
def test_a_plan_is_a_point(problem: SAP) -> None:
    """Every plan is a feasible point of the programme, worth what `evaluate` says, and comes back unchanged."""
    net = network.formulate(problem)
    programme = net.programme()
    rng = RNG(0)
    for _ in range(10):
        plan = np.array([rng.permutation(problem.m)[: problem.n] for _ in range(problem.T)])
        x = net.follow(plan)
        rows = programme.rows @ x
        assert (rows >= programme.low - 1e-12).all()
        assert (rows <= programme.high + 1e-12).all()
        assert programme.value(x) == pytest.approx(problem.evaluate(plan).value, abs=1e-12)
        assert np.array_equal(network.recover(net, x), plan)


@pytest.mark.parametrize("problem", problems(), ids=repr)
def test_oracle_is_the_dynamics(problem: SAP) -> None:
    """The network's longest paths are those of the compiled oracle, under any prices."""
    net = network.formulate(problem)
    mine = NetworkOracle(net)
    prices = RNG(1).random((problem.T, problem.m)) * 0.6
    values, plan = mine.best_paths(prices)
    through = net.through(prices)
    np.testing.assert_allclose(values, through[0], atol=1e-12)
    # some arc of every agent lies on a best path, and none on a better one
    for i in range(problem.n):
        assert through[1][net.agent == i].max() == pytest.approx(values[i], abs=1e-12)
    if problem.model.is_agent_local:
        oracle = path_oracle(problem.model, problem.benefits, problem.initial_state())
        np.testing.assert_allclose(values, oracle.best_paths(prices)[0], atol=1e-12)
    for i in range(problem.n):
        assert mine.best_path(i, prices)[0] == pytest.approx(values[i])
        assert np.array_equal(mine.best_path(i, prices)[1], plan[:, i])


def test_relaxation_is_the_lagrangian_bound() -> None:
    """The linear relaxation and the dual of the capacities meet, and the row duals are complementary."""
    problem = SAP(RNG(0).random((6, 5, 6)), SwitchingCost(0.5))
    programme = network.formulate(problem).programme()
    answer = maximise(programme, relaxed=True)
    oracle = problem.model.path_oracle(problem.benefits, None)
    assert answer.ending is Ending.OPTIMAL
    assert answer.value == pytest.approx(ascend(oracle, max_iterations=1500).bound, rel=1e-4)
    assert answer.duals is not None
    assert answer.x is not None
    reduced = programme.gain - programme.rows.T @ answer.duals
    assert (np.minimum(np.abs(reduced), np.abs(answer.x) + np.maximum(reduced, 0)) < 1e-6).all()
    slack = programme.high - programme.rows @ answer.x
    assert (np.abs(answer.duals * slack) < 1e-6).all()


def test_regret_is_what_an_arc_costs() -> None:
    """Forcing an arc lowers the Lagrangian value of its agent by its regret."""
    problem = SAP(RNG(2).random((3, 2, 3)), SwitchingCost(0.3))
    net = network.formulate(problem)
    prices = RNG(3).random((3, 3)) * 0.3
    best, through = net.through(prices)
    paths = list(itertools.product(range(3), repeat=3))
    for i in range(2):
        one = SAP(problem.benefits.dense()[:, [i]], SwitchingCost(0.3))
        worth = [
            one.evaluate(np.array(p)[:, None]).value - sum(prices[k, j] for k, j in enumerate(p))
            for p in paths
        ]
        assert best[i] == pytest.approx(max(worth))
        for k, j in itertools.product(range(3), range(3)):
            arcs = (net.agent == i) & (net.slot == k * 3 + j)
            held = max(w for w, p in zip(worth, paths, strict=True) if p[k] == j)
            assert through[arcs].max() == pytest.approx(held)


def test_global_dynamics_is_refused() -> None:
    """A state that is not local has no network, and the error says what is missing."""
    problem = SAP(RNG(0).random((2, 2, 3)), Dictator())
    assert "local_model" in str(network.refusal(problem))
    with pytest.raises(ValueError, match="Dictator"):
        network.formulate(problem)


def test_endings_of_the_solver() -> None:
    """Optimal, no better point than the cut-off, infeasible, out of time, stopped, failed: all told apart."""
    problem = SAP(RNG(0).random((8, 8, 10)), SwitchingCost(0.5))
    net = network.formulate(problem)
    programme = net.programme()
    assert maximise(programme, seconds=0.0).ending is Ending.TIME_LIMIT
    late = maximise(programme, seconds=0.02)
    assert late.ending is Ending.TIME_LIMIT
    assert late.bound >= late.value
    above = maximise(programme, cutoff=1000.0)
    assert (above.ending, above.x, above.bound) == (Ending.OPTIMAL, None, 1000.0)
    stopped = maximise(programme, watch=lambda value, bound: True)
    assert stopped.ending in (Ending.INTERRUPTED, Ending.OPTIMAL)
    closed = net.programme(net.slot % problem.m != 0)
    assert maximise(closed).ending is Ending.OPTIMAL  # 9 tasks are enough
    assert maximise(net.programme(net.slot % problem.m > 2)).ending is Ending.INFEASIBLE
    assert issubclass(SolverError, RuntimeError)
