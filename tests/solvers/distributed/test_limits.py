"""Distributed policies where there are capacities, idleness, limits and teams."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import networkx as nx
import numpy as np
import pytest

from sapopt import SAP, Limit, SwitchingCost, Team, solve
from sapopt.data.matrices import value_of
from sapopt.data.windows import WindowSums
from sapopt.dynamics import Interference
from sapopt.running.outlook import Outlook
from sapopt.running.steps import Ledger
from sapopt.solvers import (
    CBBA,
    HAA,
    HAALD,
    CentralHAALD,
    DistributedAuction,
    DistributedDualLookahead,
    IteratedAssignment,
    RolloutPolicy,
)
from sapopt.solvers.distributed import Cut, Faults, Network, Simulator, play
from sapopt.solvers.distributed.common import Scene
from sapopt.solvers.distributed.haal_d import interval_problems
from sapopt.solvers.distributed.seats import auctioned
from tests.limited_problems import LOCAL, tiny

REFUSALS = ("limit", "assignment", "agent-local", "CBBA scores")


@pytest.mark.parametrize("seed", range(30))
def test_limits_are_kept(seed: int) -> None:
    """On every kind of dynamics and limit: plans within the limits, scored by the definitions, below the optimum."""
    case = tiny(np.random.default_rng(seed), (*LOCAL, "dictator")[seed % (len(LOCAL) + 1)], 200)
    if case is None:
        return
    best, _ = case.optimum()
    path = nx.path_graph(case.problem.n)
    for policy in (
        HAALD(2, 0.01, path),
        DistributedAuction(0.01, path),
        CBBA(1),
        CBBA(2, path),
        CentralHAALD(2),
    ):
        try:
            result = solve(case.problem, policy)
        except ValueError as error:
            assert any(word in str(error) for word in REFUSALS)  # noqa: PT017  # often there is no error
            continue
        value = case.value(result.plan.tolist())
        assert value is not None
        assert result.value == pytest.approx(value, abs=1e-8)
        assert value <= best + 1e-9


def crowd(seed: int, n: int = 5, m: int = 3, T: int = 4) -> SAP:
    """More agents than tasks, capacities by step, idleness, and limits that several agents share at a step."""
    rng = np.random.default_rng(seed)
    benefits = rng.integers(0, 9, (T, n, m)) * (rng.random((T, n, m)) < 0.7)
    limits: list[Any] = [Limit.once([0], 2), Limit.handovers(3), Limit.cover([1], 1, [1, 2])]
    capacity = rng.integers(1, 4, (T, m))
    return SAP(benefits.astype(float), SwitchingCost(1.0), idle=True, capacity=capacity, limits=limits)


@pytest.mark.parametrize("seed", range(10))
def test_intervals_are_as_good_as_in_one_place(seed: int) -> None:
    """Every interval's assignment is worth at least the best within capacities and limits, less n epsilon."""
    problem = crowd(seed).core
    outlook = Outlook(
        0, problem.T, problem.initial_state(), problem, WindowSums(problem.benefits), np.arange(problem.m),
        rules=Ledger(problem).rules(0),
    )  # fmt: skip
    network = Network.from_graph(nx.cycle_graph(problem.n), problem.n)
    every = np.ones((1, problem.m), dtype=bool)
    scene = Scene(network, Simulator(network), network.components, every, np.zeros(problem.n, dtype=bool))
    matrices = interval_problems(outlook, 3)
    solved = auctioned(outlook, matrices, scene, 0.1, 5000)
    assert set(solved) == set(matrices)
    for interval, matrix in matrices.items():
        best = value_of(matrix, outlook.alpha(matrix, *interval))
        assert best - 0.1 * problem.n - 1e-9 <= value_of(matrix, solved[interval]) <= best + 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_one_step_is_haa(seed: int) -> None:
    """On one step with whole numbers and a small epsilon, the agents do as well as HAA."""
    many = crowd(seed)
    one = SAP(
        many.benefits.slice(0, 1), many.dynamics, idle=True, capacity=np.maximum(many.capacity[:1], 2),
        limits=[Limit.once([0], 1), Team(1, 2, 5.0)],
    )  # fmt: skip
    expected = solve(one, HAA()).value
    assert solve(one, HAALD(1, 0.1)).value == expected
    assert solve(one, DistributedAuction(0.1)).value == expected


def test_a_budget_shared_within_a_step() -> None:
    """Three agents want the two take-ups that are left: the dearest pairs get them, as in one place."""
    problem = SAP(
        [[[1.0, 0, 0], [0, 2.0, 0], [0, 0, 3.0]]], 0.0, [-1, -1, -1], idle=True, limits=[Limit.handovers(2)]
    )
    for policy in (HAALD(1), HAALD(2, graph=nx.path_graph(3)), CBBA(1), DistributedAuction()):
        assert solve(problem, policy).plan.tolist() == [[-1, 1, 2]]


def test_what_is_used_up_is_closed() -> None:
    """A task that was looked at is left alone, and the place goes to the next."""
    problem = SAP(np.array([[[3.0, 2.0]]] * 3), 0.0, idle=True, limits=[Limit.once()])
    for policy in (HAALD(1), CBBA(1), CBBA(2)):
        assert solve(problem, policy).plan.ravel().tolist() == [0, 1, -1]


def test_an_auction_that_does_not_end() -> None:
    """If the rounds do not suffice, the agents settle the step as HAA would; nobody breaks a capacity."""
    problem = crowd(3)
    result = solve(problem, HAALD(1, 1e-4, nx.path_graph(5), max_rounds=2))
    assert result.value == solve(problem, HAA()).value


def test_what_it_costs_to_know_the_limits() -> None:
    """Agents tell each other what they hold: more bytes, and a diameter of rounds a step."""
    problem = crowd(1)
    plain = SAP(problem.benefits, problem.dynamics, idle=True, capacity=problem.capacity)
    policy = HAALD(1, 0.1, nx.path_graph(5))
    _, more = play(problem.core, policy)
    _, less = play(plain.core, policy)
    assert more[0].bytes > less[0].bytes
    assert more[0].rounds >= less[0].rounds + 4


@pytest.mark.parametrize(
    ("policy", "word"),
    [
        (HAALD(1, allow_disconnected=True), "allow_disconnected"),
        (CBBA(1, faults=Faults(dead={0: 1})), "faults"),
        (DistributedAuction(faults=Faults(cuts=(Cut((0,), 0, 1),))), "faults"),
        (DistributedAuction(scaling=4.0), "scaling"),
        (DistributedDualLookahead(2), "does not take problems with"),
        (CBBA(1), "CBBA scores the handovers of a SwitchingCost"),
    ],
)
def test_what_cannot_be_is_refused_before_the_run(policy: Any, word: str) -> None:
    """A part that is cut off cannot know what others use of a limit; each says so in one line."""
    problem = crowd(0)
    if word.startswith("CBBA"):
        problem = SAP(problem.benefits, Interference([[0, 1]], 0.5), idle=True, capacity=2)
    with pytest.raises(ValueError, match=word) as told:
        solve(problem, policy)
    assert "\n" not in str(told.value)


def test_lost_packets_change_nothing() -> None:
    """Loss and delay cost rounds, not the plan."""
    problem = crowd(2)
    calm = HAALD(2, 0.1, nx.cycle_graph(5))
    assert (solve(problem, calm).plan == solve(problem, replace(calm, faults=Faults(0.2, 2))).plan).all()


@pytest.mark.parametrize("seed", range(6))
def test_rollouts_within_limits(seed: int) -> None:
    """A rollout keeps the limits on its way; without penalties it is worth at least its base."""
    problem = crowd(seed)
    base = solve(problem, HAA())
    tried = solve(problem, RolloutPolicy(HAA(), [CentralHAALD(2), HAALD(2)]))
    assert tried.value >= base.value - 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_iterated_assignment_within_limits(seed: int) -> None:
    """Tasks that interfere, with idleness and limits: scored by the definition, and no limit is broken."""
    many = crowd(seed)
    rule = Interference([[0, 1], [1, 2]], 2.0, 1.0)
    problem = SAP(many.benefits, rule, idle=True, limits=[Limit.once([0], 2), Limit.handovers(3)])
    result = solve(problem, IteratedAssignment())
    assert all(use.slack >= 0 for use in result.evaluation.limits)
    assert result.value >= solve(problem, HAA()).value - 1e-9 or problem.T > 1
