"""Partitions, dead agents and round limits: never two agents on one task, and the documented rule."""

from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP
from sapopt.solvers import CBBA, HAALD, DistributedAuction, DistributedDualLookahead
from sapopt.solvers.distributed import Cut, Faults, Network, Simulator, play
from sapopt.solvers.distributed.simulator import HEADER_BYTES

POLICIES = ["haald", "cbba", "auction", "dual"]


def policy_of(kind: str, epsilon: float, **options: Any) -> Any:
    """One policy of each kind."""
    if kind == "haald":
        return HAALD(3, epsilon, **options)
    if kind == "cbba":
        return CBBA(2, **options)
    if kind == "auction":
        return DistributedAuction(epsilon, **options)
    return DistributedDualLookahead(3, epsilon, iterations=6, **options)


cases = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(POLICIES),
        "n": st.integers(1, 7),
        "extra": st.integers(0, 4),
        "links": st.floats(0.0, 0.6),
        "seed": st.integers(0, 10_000),
        "loss": st.floats(0.0, 0.3),
        "delay": st.integers(0, 2),
        "epsilon": st.sampled_from([1e-9, 1e-2, 0.5, 10.0]),
        "max_rounds": st.sampled_from([1, 3, 200]),
        "initial": st.booleans(),
    }
)


@settings(max_examples=120, deadline=None)
@given(cases)
def test_never_two_agents_on_one_task(case: dict[str, Any]) -> None:
    """Any seed, any graphs (mostly disconnected), loss up to 30 %, any epsilon, any round limit, deaths and cuts."""
    n, m, steps = case["n"], case["n"] + case["extra"], 4
    rng = np.random.default_rng(case["seed"])
    graphs = [nx.gnp_random_graph(n, case["links"], seed=int(rng.integers(1e6))) for _ in range(steps)]
    benefits = rng.random((steps, n, m)) * (rng.random((steps, n, m)) < 0.5)
    initial = rng.permutation(m)[:n] if case["initial"] else None
    problem = SAP(benefits, 0.2, initial)
    faults = Faults(case["loss"], case["delay"], {0: 2}, (Cut((n - 1, 0), 1, 2),))
    policy = policy_of(
        case["kind"], case["epsilon"], graph=graphs, allow_disconnected=True, faults=faults,
        max_rounds=case["max_rounds"],
    )  # fmt: skip
    rollout, traffic = play(problem, policy)
    problem.evaluate(rollout.plan)  # raises if a task is given twice
    assert rollout.plan[3, 0] == rollout.plan[1, 0]  # dead from step 2: it keeps its task
    assert len(traffic) == steps


@pytest.mark.parametrize("kind", POLICIES)
def test_parts_use_only_the_tasks_they_keep(kind: str) -> None:
    """While cut off, a part assigns tasks its agents hold or keep; after healing all tasks are open again."""
    n, m, steps = 4, 6, 3
    benefits = np.zeros((steps, n, m))
    benefits[0] = 1.0 * (np.arange(n)[:, None] == np.arange(m))
    benefits[1:, 0, 3] = benefits[1:, 0, 5] = (
        5.0  # agent 0 wants what agent 3 holds and the free task of agent 1
    )
    problem = SAP(benefits, 0.1, np.arange(n))
    faults = Faults(cuts=(Cut((0, 2), 1, 1),))
    rollout, traffic = play(problem, policy_of(kind, 0.01, graph=nx.complete_graph(n), faults=faults))
    assert [one.components for one in traffic] == [1, 2, 1]
    # Task 4 is kept by agent 0, task 5 by agent 1 (free tasks in turn): 5 is out of reach for agent 0 at step 1.
    assert rollout.plan[1, 0] not in (3, 5)
    assert rollout.plan[2, 0] in (3, 5)


@pytest.mark.parametrize("kind", ["haald", "auction"])
def test_no_agreement_keeps_the_tasks(kind: str) -> None:
    """A part that does not come to rest within the round limit keeps what it holds."""
    problem = SAP(np.random.default_rng(0).random((2, 5, 6)), 0.1, np.array([5, 4, 3, 2, 1]))
    rollout, traffic = play(problem, policy_of(kind, 0.01, graph=nx.path_graph(5), max_rounds=4))
    assert (rollout.plan == problem.initial_assignment).all()
    assert all(one.held == 5 for one in traffic)


def test_one_part_may_agree_while_another_does_not() -> None:
    """Parts are on their own: a pair agrees in time, a long path does not."""
    graph = nx.disjoint_union(nx.path_graph(2), nx.path_graph(6))
    problem = SAP(np.random.default_rng(1).random((1, 8, 9)), 0.0, np.arange(8))
    rollout, traffic = play(problem, HAALD(1, 0.5, graph, allow_disconnected=True, max_rounds=6))
    assert (rollout.plan[0, 2:] == np.arange(2, 8)).all()
    assert traffic[0].held == 6


def test_rounds_under_loss() -> None:
    """More loss and more delay take more rounds; without either the clock counts the protocol's rounds."""
    network = Network.from_graph(nx.connected_watts_strogatz_graph(40, 4, 0.2, seed=0), 40)
    rounds = []
    for loss, delay in ((0.0, 0), (0.1, 0), (0.3, 0), (0.3, 4)):
        simulator = Simulator(network, Faults(loss, delay), np.random.default_rng(0))
        simulator.flood(np.full(40, 8))
        simulator.deliver(np.full((20, 40), HEADER_BYTES))
        rounds.append(simulator.traffic().rounds)
    assert rounds == sorted(set(rounds))
    assert rounds[0] == 20 + network.diameters[0]


def test_flood_by_hand() -> None:
    """On a path of three the middle passes on both ends' items."""
    simulator = Simulator(Network.from_graph(nx.path_graph(3), 3))
    simulator.flood(np.array([10, 20, 40]))
    traffic = simulator.traffic()
    assert traffic.rounds == 2
    # round 1: all send their own; round 2: each passes on what it heard (the ends would pass on the middle's)
    assert traffic.messages == 2 * (1 + 2 + 1)
    assert traffic.bytes == (10 + 2 * 20 + 40 + 4 * 16) + (20 + 2 * (10 + 40) + 20 + 4 * 16)


def test_network_distances() -> None:
    """Distances, components and diameters agree with networkx."""
    graph = nx.gnp_random_graph(90, 0.02, seed=3)
    network = Network.from_graph(graph, 90)
    lengths = dict(nx.all_pairs_shortest_path_length(graph))
    for i in range(90):
        for j in range(90):
            assert network.distances[i, j] == lengths[i].get(j, -1)
    parts = list(nx.connected_components(graph))
    assert len(network.diameters) == len(parts)
    for part in parts:
        label = network.components[next(iter(part))]
        assert network.diameters[label] == nx.diameter(graph.subgraph(part))
    assert (network.links[network.reverse] == network.sources).all()
    assert (network.sources[network.reverse] == network.links).all()


def test_bad_faults() -> None:
    """Faults out of range are refused."""
    with pytest.raises(ValueError, match="loss must be a probability below 1"):
        Faults(1.0)
    with pytest.raises(ValueError, match="delay must be a whole number"):
        Faults(0.1, -1)
    with pytest.raises(ValueError, match="rng is needed"):
        Simulator(Network.complete(2), Faults(0.1))
