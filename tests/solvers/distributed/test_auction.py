"""The distributed auction: optimality, knowledge, termination, and the comparison with one object per agent."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from sapopt import SAP
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.matrices import GainMatrix
from sapopt.running.rollout import rollout
from sapopt.solvers import HAA, DistributedAuction
from sapopt.solvers.distributed import Faults

ROOT = Path(__file__).resolve().parents[3]


def load_plain() -> ModuleType:
    """The plain per-agent versions kept with the benchmarks."""
    path = ROOT / "experiments" / "benchmarks" / "plain_distributed.py"
    spec = importlib.util.spec_from_file_location("plain_distributed", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules["plain_distributed"] = module
    spec.loader.exec_module(module)
    return module


PLAIN = load_plain()


def some_graph(n: int, kind: str, seed: int) -> Any:
    """A connected graph of n nodes."""
    if n < 3 or kind == "path":
        return nx.path_graph(n)
    if kind == "complete":
        return nx.complete_graph(n)
    return nx.connected_watts_strogatz_graph(n, 2, 0.4, seed=seed)


def best_value(matrix: np.ndarray) -> float:
    """Value of alpha by scipy."""
    return float(matrix[linear_sum_assignment(matrix, maximize=True)].sum())


cases = st.fixed_dictionaries(
    {
        "n": st.integers(1, 8),
        "extra": st.integers(0, 5),
        "kind": st.sampled_from(["path", "complete", "random"]),
        "seed": st.integers(0, 10_000),
        "loss": st.sampled_from([0.0, 0.1, 0.3]),
        "delay": st.integers(0, 2),
        "scaling": st.sampled_from([None, 4.0]),
    }
)


@settings(max_examples=60, deadline=None)
@given(cases)
def test_optimal_for_integers(case: dict[str, Any]) -> None:
    """Integer benefits and epsilon < 1 / n: the best assignment, on any graph, with any loss."""
    n, m = case["n"], case["n"] + case["extra"]
    rng = np.random.default_rng(case["seed"])
    matrix = rng.integers(-4, 6, (n, m)).astype(float)
    graph = some_graph(n, case["kind"], case["seed"])
    faults = Faults(case["loss"], case["delay"])
    result = DistributedAuction(0.9 / n, graph, case["scaling"], faults=faults).assign(matrix, case["seed"])
    assert result.value == pytest.approx(best_value(matrix), abs=1e-9)
    assert len(set(result.tasks)) == n
    assert (result.prices == result.prices[0]).all()
    assert (result.bidders == result.bidders[0]).all()
    calm = DistributedAuction(0.9 / n, graph, case["scaling"]).assign(matrix)
    assert (calm.tasks == result.tasks).all()
    assert result.traffic.protocol_rounds == calm.traffic.rounds <= result.traffic.rounds


@settings(max_examples=40, deadline=None)
@given(cases, st.floats(1e-4, 3.0))
def test_within_n_epsilon(case: dict[str, Any], epsilon: float) -> None:
    """Any epsilon: within n epsilon of the best, never two agents on one task, and the prices prove it."""
    n, m = case["n"], case["n"] + case["extra"]
    matrix = np.random.default_rng(case["seed"]).random((n, m)) * (np.arange(m) % 3 > 0)
    result = DistributedAuction(epsilon, some_graph(n, case["kind"], case["seed"])).assign(matrix)
    assert result.value >= best_value(matrix) - n * epsilon - 1e-9
    assert len(set(result.tasks)) == n
    net = matrix - result.prices[0]
    assert (net[np.arange(n), result.tasks] >= net.max(axis=1) - epsilon - 1e-9).all()
    assert (result.prices[0][np.setdiff1d(np.arange(m), result.tasks)] == 0).all()


@settings(max_examples=25, deadline=None)
@given(cases)
def test_same_as_one_object_per_agent(case: dict[str, Any]) -> None:
    """Sending only what changed gives the tables, tasks and rounds of whole tables in every packet."""
    n, m = case["n"], case["n"] + case["extra"]
    rng = np.random.default_rng(case["seed"])
    matrix = rng.integers(0, 5, (n, m)).astype(float)
    graph = some_graph(n, case["kind"], case["seed"])
    tasks, agents, rounds = PLAIN.plain_auction(matrix, graph, 0.3)
    result = DistributedAuction(0.3, graph).assign(matrix)
    assert (tasks == result.tasks).all()
    assert rounds == result.traffic.rounds
    for agent in agents:
        assert (agent.price == result.prices[agent.number]).all()
        assert (agent.owner == result.bidders[agent.number]).all()


def test_one_diameter_of_silence_is_too_early() -> None:
    """The published stopping rule (a diameter of rounds without news) would stop an agent before the end.

    Agents 0 and 4 at the ends of a path want the same task. Agent 0 bids the higher price at once and hears nothing new
    until agent 4 has learnt that and answered: two diameters.
    """
    n = 5
    matrix = np.zeros((n, n + 1))
    matrix[0, 5], matrix[4, 5] = 10.0, 8.0
    for i in (1, 2, 3):
        matrix[i, i] = 50.0
    graph = nx.path_graph(n)
    result = DistributedAuction(0.01, graph).assign(matrix)
    # Before the first exchange all bid; agent 4 learns of 0's bid after 4 rounds, bids, and 0 hears of that after 8.
    assert result.traffic.rounds == 4 + 2 * 4
    assert result.bidders[0][result.tasks[4]] == 4


def test_messages_and_bytes_by_hand() -> None:
    """Two agents, two tasks they like differently: one packet each, then nothing but the wait."""
    result = DistributedAuction(0.1, nx.path_graph(2)).assign(np.array([[3.0, 0.0], [0.0, 2.0]]))
    assert result.traffic.rounds == 2
    assert result.traffic.messages == 4  # the second round passes on what was heard
    assert result.traffic.bytes == 4 * 32
    alone = DistributedAuction(0.1, nx.path_graph(1)).assign(np.array([[3.0, 4.0]]))
    assert (alone.traffic.rounds, alone.traffic.messages) == (0, 0)


def test_scaling_needs_fewer_rounds_in_a_price_war() -> None:
    """Three agents after two good tasks raise prices by epsilon a time unless epsilon starts coarse."""
    matrix = np.zeros((3, 3))
    matrix[:, :2] = 50.0
    graph = nx.path_graph(3)
    plain = DistributedAuction(0.01, graph, max_rounds=100_000).assign(matrix)
    scaled = DistributedAuction(0.01, graph, scaling=4.0).assign(matrix)
    assert plain.value == scaled.value == 100.0
    assert scaled.traffic.rounds < plain.traffic.rounds / 10


def test_forbidden_pairs() -> None:
    """Forbidden pairs are never assigned; where they leave nothing the error says why."""
    matrix = np.array([[5.0, -np.inf, 0.0], [4.0, 3.0, -np.inf], [-np.inf, 9.0, 1.0]])
    result = DistributedAuction(0.1, nx.path_graph(3)).assign(matrix)
    assert result.value == best_value(matrix)
    matrix[:, 1:] = -np.inf
    with pytest.raises(InfeasibleError, match="no full assignment"):
        DistributedAuction(0.1).assign(matrix)


def test_policy_is_haa() -> None:
    """As a policy with integer benefits and costs it plays steps as good as HAA's."""
    rng = np.random.default_rng(3)
    problem = SAP(rng.integers(0, 9, (4, 6, 8)).astype(float), 2.0, np.arange(6))
    mine = rollout(problem, DistributedAuction(0.1, nx.cycle_graph(6)))
    exact = rollout(problem, HAA())
    assert mine.trace[0]["value"] == exact.trace[0]["value"]


def test_gain_matrix_is_taken() -> None:
    """The sparse form of the library gives the same assignment as the array."""
    matrix = np.random.default_rng(0).random((4, 7))
    auction = DistributedAuction(0.01, nx.path_graph(4))
    assert (auction.assign(matrix).tasks == auction.assign(GainMatrix.from_matrix(matrix)).tasks).all()


@pytest.mark.parametrize("epsilon", [0.0, -1.0, np.nan, np.inf])
def test_bad_epsilon(epsilon: float) -> None:
    """Epsilon must be positive."""
    with pytest.raises(ValueError, match="epsilon must be a positive number"):
        DistributedAuction(epsilon)


def test_bad_arguments() -> None:
    """Errors name the argument and the mend."""
    with pytest.raises(ValueError, match="scaling must be a factor above 1"):
        DistributedAuction(scaling=1.0)
    with pytest.raises(ValueError, match="scaling needs a network that stays connected"):
        DistributedAuction(scaling=2.0, allow_disconnected=True)
    with pytest.raises(ValueError, match="max_rounds must be a whole number"):
        DistributedAuction(max_rounds=0)
    with pytest.raises(ValueError, match=r"faults must be a Faults"):
        DistributedAuction(faults=0.3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="not connected"):
        DistributedAuction(graph=nx.empty_graph(2)).assign(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="3 agents cannot each have one of 2 tasks"):
        DistributedAuction().assign(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="NaN"):
        DistributedAuction().assign(np.full((2, 2), np.nan))
    with pytest.raises(ValueError, match="must have shape"):
        DistributedAuction().assign(np.zeros(3))
    with pytest.raises(ValueError, match="max_rounds = 1 rounds are too few"):
        DistributedAuction(graph=nx.path_graph(3), max_rounds=1).assign(np.ones((3, 3)))
