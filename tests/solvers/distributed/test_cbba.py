"""CBBA: the rules, the comparison with one object per agent, and conflict-free plans."""

import importlib.util
import sys
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, SwitchingCost
from sapopt.running.rollout import rollout
from sapopt.solvers import CBBA
from sapopt.solvers.distributed import Faults, play
from sapopt.solvers.distributed.cbba import settle
from sapopt.solvers.distributed.cbba_kernels import decide

ROOT = Path(__file__).resolve().parents[3]


def load_plain() -> ModuleType:
    """The plain per-agent versions kept with the benchmarks."""
    path = ROOT / "experiments" / "benchmarks" / "plain_distributed.py"
    spec = importlib.util.spec_from_file_location("plain_distributed", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["plain_distributed"] = module
    spec.loader.exec_module(module)
    return module


PLAIN = load_plain()


def test_the_whole_table_of_rules() -> None:
    """Every case of Table I: who thinks who won, whose news of whom is newer, whose bid is higher."""
    actions = ("leave", "update", "reset")
    i, k = 0, 1
    cases = 0
    for zi, zk in product(range(-1, 4), repeat=2):
        for yi, yk in product((1.0, 2.0), repeat=2):
            for si, sk in product(product((1, 2), repeat=4), repeat=2):
                stamps = np.array(si, np.int32), np.array(sk, np.int32)
                got = actions[decide(i, k, yi, zi, yk, zk, *stamps)]
                assert got == PLAIN.table(i, k, yi, zi, yk, zk, *stamps), (zi, zk, yi, yk, si, sk)
                cases += 1
    assert cases == 25_600


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 7), st.integers(0, 4), st.integers(1, 4), st.integers(0, 10_000), st.booleans())
def test_same_as_one_object_per_agent(n: int, extra: int, steps: int, seed: int, held: bool) -> None:
    """The kernels give the rounds, winners and first tasks of one object per agent."""
    rng = np.random.default_rng(seed)
    m = n + extra
    benefits = rng.random((steps, n, m)) * (rng.random((steps, n, m)) < 0.6)
    graph = nx.connected_watts_strogatz_graph(n, 2, 0.3, seed=seed) if n > 2 else nx.path_graph(n)
    initial = rng.permutation(m)[:n] if held else None
    problem = SAP(benefits, 0.25, initial)
    agents, rounds = PLAIN.plain_cbba(benefits, 0.25, initial, graph)
    ran, traffic = play(SAP(benefits, 0.25, initial), CBBA(steps, graph))
    diameter = nx.diameter(graph) if n > 1 else 0
    assert traffic[0].rounds == rounds + diameter
    tables = agents[0].z
    assert all((agent.z == tables).all() for agent in agents)
    for agent in agents:
        first = [j for t, j, _ in agent.bundle if t == 0]
        if first:
            assert ran.plan[0, agent.number] == first[0]
    problem.evaluate(ran.plan)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 10), st.integers(0, 5), st.integers(1, 4), st.integers(0, 10_000), st.booleans())
def test_consensus_ends_without_conflict(n: int, extra: int, lookahead: int, seed: int, ties: bool) -> None:
    """The consensus ends long before the limit, ties or not, and every plan is feasible."""
    rng = np.random.default_rng(seed)
    m = n + extra
    benefits = rng.integers(0, 3, (3, n, m)).astype(float) if ties else rng.random((3, n, m))
    problem = SAP(benefits, 0.5)
    graph = nx.path_graph(n)
    ran, traffic = play(problem, CBBA(lookahead, graph))
    problem.evaluate(ran.plan)
    assert max(one.rounds for one in traffic) < 2000


def test_stopped_early_is_still_free_of_conflicts() -> None:
    """With a single round of consensus many agents claim the same task; one of them gets it."""
    rng = np.random.default_rng(0)
    problem = SAP(np.tile(rng.random(14), (3, 12, 1)), 0.1)
    problem.evaluate(rollout(problem, CBBA(2, nx.path_graph(12), max_rounds=1)).plan)


def test_settle_by_hand() -> None:
    """Highest bid, then lower number; losers keep what they hold if it is free, else the lowest free task."""
    claimed, bids = np.array([2, 2, 0, -1]), np.array([1.0, 1.0, 5.0, 0.0])
    tasks = settle(claimed, bids, np.array([1, 3, 4, 0]), np.zeros(4, dtype=int), np.ones((1, 5), dtype=bool))
    assert tasks.tolist() == [2, 3, 0, 1]


def test_loss_changes_nothing_but_traffic() -> None:
    """Lost and late packets are repeated below the protocol."""
    problem = SAP(np.random.default_rng(4).random((3, 6, 8)), 0.3)
    graph = nx.cycle_graph(6)
    calm, quiet = play(problem, CBBA(2, graph))
    rough, traffic = play(problem, CBBA(2, graph, faults=Faults(0.3, 2)))
    assert (calm.plan == rough.plan).all()
    assert sum(one.rounds for one in traffic) > sum(one.rounds for one in quiet)


def test_scores_count_induced_handovers() -> None:
    """Staying two steps on a good task beats a better one that costs two handovers."""
    benefits = np.zeros((3, 1, 3))
    benefits[:, 0, 0] = 1.0
    benefits[1, 0, 1] = 1.5
    problem = SAP(benefits, 0.6, [0])
    assert rollout(problem, CBBA(3)).plan[:, 0].tolist() == [0, 0, 0]
    cheap = SAP(benefits, 0.2, [0])
    assert rollout(cheap, CBBA(3)).plan[:, 0].tolist() == [0, 1, 0]


def test_matrix_costs() -> None:
    """Costs of moves may differ by task."""
    cost = np.array([[0.0, 9.0, 0.1], [9.0, 0.0, 9.0], [0.1, 9.0, 0.0]])
    benefits = np.zeros((1, 1, 3))
    benefits[0, 0] = [0.0, 2.0, 1.0]
    assert rollout(SAP(benefits, SwitchingCost(cost), [0]), CBBA(1)).plan[0, 0] == 2


def test_refuses_what_it_cannot_score() -> None:
    """Other dynamics and forbidden pairs are refused with a way out."""
    values = np.zeros((1, 2, 2))
    values[0, 0, 0] = -np.inf
    with pytest.raises(ValueError, match="forbidden; use HAALD"):
        rollout(SAP(values), CBBA(1))

    class Odd:
        def initial_state(self, problem: SAP) -> Any:
            return None

        def handover(self, k: int, state: Any) -> Any:
            return np.zeros((2, 2))

        def transition(self, k: int, state: Any, assignment: Any) -> Any:
            return None

    with pytest.raises(ValueError, match="use HAALD"):
        rollout(SAP(np.zeros((1, 2, 2)), Odd()), CBBA(1))
