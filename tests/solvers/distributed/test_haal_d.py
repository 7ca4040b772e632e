"""HAAL-D: its intervals against the centralised twin, both knowledge models, and bad input."""

from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, SwitchingCost, solve
from sapopt.data.assignment import best_assignment
from sapopt.data.benefits import Benefits
from sapopt.data.matrices import value_of
from sapopt.data.windows import WindowSums
from sapopt.dynamics import SyntheticSwitching
from sapopt.running.outlook import Outlook
from sapopt.running.rollout import rollout
from sapopt.solvers import CBBA, HAA, HAALD, CentralHAALD, DistributedAuction, DistributedDualLookahead
from sapopt.solvers.distributed import Faults, Network, Simulator, play
from sapopt.solvers.distributed.common import Scene
from sapopt.solvers.distributed.haal_d import interval_problems

problems = st.fixed_dictionaries(
    {
        "n": st.integers(1, 6),
        "extra": st.integers(0, 4),
        "steps": st.integers(1, 4),
        "seed": st.integers(0, 10_000),
        "sparse": st.booleans(),
        "initial": st.booleans(),
        "idle_is_free": st.booleans(),
        "lookahead": st.integers(1, 4),
    }
)


def build(case: dict[str, Any]) -> SAP:
    """An integer problem."""
    n, m = case["n"], case["n"] + case["extra"]
    rng = np.random.default_rng(case["seed"])
    values = rng.integers(0, 6, (case["steps"], n, m)) * (rng.random((case["steps"], n, m)) < 0.5)
    benefits = values.astype(float)
    form = Benefits.from_flat(*_flat(benefits), benefits.shape) if case["sparse"] else benefits
    start = rng.permutation(m)[:n] if case["initial"] else None
    return SAP(form, SwitchingCost(2.0, idle_is_free=case["idle_is_free"]), start)


def _flat(benefits: np.ndarray) -> tuple[Any, Any, Any]:
    flat = Benefits(benefits).flat()
    return flat.indptr, flat.indices, flat.data


def ring(n: int) -> Any:
    """A cycle, or as much of one as n nodes make."""
    return nx.cycle_graph(n) if n > 2 else nx.path_graph(n)


def first_outlook(problem: SAP) -> Outlook:
    """What a policy sees at step 0."""
    windows = WindowSums(problem.benefits)
    return Outlook(0, problem.T, problem.initial_state(), problem, windows, np.arange(problem.m))


@settings(max_examples=60, deadline=None)
@given(problems, st.sampled_from([1e-3, 0.3, 2.0]))
def test_intervals_against_the_twin(case: dict[str, Any], epsilon: float) -> None:
    """Every interval is within n epsilon of the twin's, and equal if epsilon < 1 / n."""
    problem = build(case)
    outlook = first_outlook(problem)
    network = Network.from_graph(ring(problem.n), problem.n)
    scene = Scene(
        network, Simulator(network), network.components, np.ones((1, problem.m), dtype=bool),
        np.zeros(problem.n, dtype=bool),
    )  # fmt: skip
    solved, agreed = HAALD(case["lookahead"], epsilon).solve_intervals(outlook, scene)
    exact = interval_problems(outlook, case["lookahead"])
    assert agreed.all()
    length = min(case["lookahead"], problem.T)
    assert set(solved) == set(exact)
    assert len(exact) == length * (length + 1) // 2
    for interval, matrix in exact.items():
        best = best_assignment(matrix, outlook.parking).value
        value = value_of(matrix, solved[interval])
        assert best - problem.n * epsilon - 1e-9 <= value <= best + 1e-9
        if problem.n * epsilon < 1:
            assert value == pytest.approx(best)


@settings(max_examples=30, deadline=None)
@given(problems)
def test_same_plan_in_both_knowledge_models(case: dict[str, Any]) -> None:
    """Who knows what changes the traffic, not the plan."""
    problem = build(case)
    own, its_traffic = play(problem, HAALD(case["lookahead"], 0.1, ring(problem.n)))
    everything, less = play(problem, HAALD(case["lookahead"], 0.1, ring(problem.n), knowledge="all"))
    assert (own.plan == everything.plan).all()
    diameter = problem.n // 2
    assert all(a.rounds == b.rounds + diameter for a, b in zip(its_traffic, less, strict=True))
    problem.evaluate(own.plan)


@settings(max_examples=30, deadline=None)
@given(problems, st.floats(0.0, 0.3), st.integers(0, 3))
def test_loss_and_delay_cost_rounds_only(case: dict[str, Any], loss: float, delay: int) -> None:
    """Lost and late packets never change the plan; more rounds pass and more packets are sent."""
    problem = build(case)
    calm, quiet = play(problem, HAALD(case["lookahead"], 0.1, ring(problem.n)))
    rough, traffic = play(problem, HAALD(case["lookahead"], 0.1, ring(problem.n), faults=Faults(loss, delay)))
    assert (calm.plan == rough.plan).all()
    for a, b in zip(quiet, traffic, strict=True):
        assert a.rounds == b.protocol_rounds <= b.rounds
        assert a.messages <= b.messages
        assert a.bytes <= b.bytes


def test_seeded() -> None:
    """The same seed gives the same traffic, another seed another."""
    from sapopt.running.control import Run

    problem = SAP(np.random.default_rng(0).random((3, 8, 10)), 0.3)
    policy = HAALD(2, 0.01, ring(8), faults=Faults(0.3, 1))
    once, again = play(problem, policy, Run(5))[1], play(problem, policy, Run(5))[1]
    assert once == again
    assert once != play(problem, policy, Run(6))[1]


def test_lookahead_one_is_the_auction_policy() -> None:
    """With L = 1 there is one interval and nothing to choose."""
    problem = SAP(np.random.default_rng(1).random((5, 6, 9)), 0.2)
    graph = ring(6)
    assert (
        rollout(problem, HAALD(1, 0.01, graph)).plan == rollout(problem, DistributedAuction(0.01, graph)).plan
    ).all()
    twin = problem.evaluate(rollout(problem, CentralHAALD(1)).plan).value
    assert twin == problem.evaluate(rollout(problem, HAA()).plan).value


@pytest.mark.parametrize("labels", [{}, {"task_of": [0, 0, 1, 1]}, {"agent_of": [0, 0]}])
@pytest.mark.parametrize("sparse", [False, True])
def test_on_benefits_that_a_move_forfeits(labels: dict[str, list[int]], sparse: bool) -> None:
    """Every interval's auction is as good as the exact alpha where handovers take the benefit; a lookahead pays."""

    class Checked(HAALD):
        def solve_intervals(self, outlook: Outlook, scene: Scene) -> tuple[Any, np.ndarray]:
            solved, agreed = super().solve_intervals(outlook, scene)
            for interval, matrix in interval_problems(outlook, self.lookahead).items():
                found = value_of(matrix, solved[interval])
                assert found == pytest.approx(best_assignment(matrix, outlook.parking).value, abs=1e-5)
            return solved, agreed

    values = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        benefits = 3 * rng.random((5, 2, 4)) * (rng.random((5, 2, 4)) < 0.7)
        form = Benefits.from_flat(*_flat(benefits), benefits.shape) if sparse else benefits
        problem = SAP(form, SyntheticSwitching(forfeit=1.0, **labels), np.arange(2))
        values.append(
            [problem.evaluate(rollout(problem, Checked(L, 1e-6)).plan).value for L in (1, 3)],
        )
    short, far = np.sum(values, axis=0)
    assert far > 1.1 * short


def test_forbidden_pairs() -> None:
    """Intervals without a full assignment are left out; the plan keeps off forbidden pairs."""
    rng = np.random.default_rng(2)
    values = rng.random((4, 3, 4))
    values[0, :, 0] = values[1, :, 1] = values[2, :, 2] = -np.inf
    problem = SAP(values, 0.1)
    for policy in (HAALD(3, 1e-4, nx.path_graph(3)), CentralHAALD(3)):
        assert np.isfinite(problem.evaluate(rollout(problem, policy).plan).value)


def test_a_graph_for_every_step() -> None:
    """The graph may change from step to step, and must be there for every step."""
    problem = SAP(np.random.default_rng(3).random((3, 5, 6)), 0.2)
    graphs = [nx.path_graph(5), nx.complete_graph(5), nx.cycle_graph(5)]
    _, traffic = play(problem, HAALD(2, 0.01, graphs))
    assert traffic[1].rounds < traffic[0].rounds
    with pytest.raises(ValueError, match="2 graphs for 3 steps"):
        rollout(problem, HAALD(2, 0.01, graphs[:2]))


def test_bad_input() -> None:
    """Every error names the argument and the mend."""
    problem = SAP(np.random.default_rng(3).random((2, 4, 6)), 0.2)

    def message(policy: HAALD) -> str:
        with pytest.raises(ValueError) as error:
            rollout(problem, policy)
        return str(error.value)

    split = nx.Graph([(0, 1), (2, 3)])
    assert "graph at step 0 is not connected (2 parts); pass allow_disconnected=True" in message(
        HAALD(2, graph=split)
    )
    assert "graph at step 1 is not connected" in message(HAALD(2, graph=[nx.path_graph(4), split]))
    assert "graph has 5 nodes, but the problem has 4 agents" in message(HAALD(2, graph=nx.path_graph(5)))
    assert "graph at step 1 has 3" in message(HAALD(2, graph=[nx.path_graph(4), nx.path_graph(3)]))
    assert "nodes 0..3" in message(HAALD(2, graph=nx.relabel_nodes(nx.path_graph(4), {0: "a"})))
    assert "networkx graph" in message(HAALD(2, graph="ring"))
    assert "no agent 9" in message(HAALD(2, faults=Faults(dead={9: 0})))
    with pytest.raises(ValueError, match="lookahead must be"):
        HAALD(0)
    with pytest.raises(ValueError, match="epsilon must be"):
        HAALD(2, epsilon=0)
    with pytest.raises(ValueError, match="knowledge must be"):
        HAALD(2, knowledge="some")  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [1, 3, 7])
def test_complete_by_default(count: int) -> None:
    """Without a graph everyone hears everyone."""
    problem = SAP(np.random.default_rng(count).random((2, count, 8)), 0.2)
    _, traffic = play(problem, HAALD(2))
    assert traffic[0].components == 1


class Weary:
    """A user's dynamics: an agent that works two steps running gains less; the state counts the steps."""

    def initial_state(self, problem: SAP) -> Any:
        return np.zeros(problem.n)

    def handover(self, k: int, state: Any) -> Any:
        eta = np.zeros((len(state), 6))
        eta[:, :4] = -np.minimum(state, 3.0)[:, None]
        return eta

    def transition(self, k: int, state: Any, assignment: Any) -> Any:
        return np.where(assignment < 4, state + 1, 0.0)


def test_users_dynamics() -> None:
    """Any dynamics will do; with L = 1 and integers every step is as good as alpha(beta_hat)."""
    values = np.random.default_rng(5).integers(0, 6, (5, 4, 6)).astype(float)
    problem = SAP(values, Weary())
    one = problem.evaluate(rollout(problem, HAALD(1, 0.2, ring(4))).plan)
    first = problem.evaluate(rollout(problem, HAA()).plan)
    assert one.benefit[0] + one.handover[0] == first.benefit[0] + first.handover[0]
    for lookahead in (2, 3):
        problem.evaluate(rollout(problem, HAALD(lookahead, 0.2, ring(4))).plan)


def test_a_short_forecast() -> None:
    """Only the forecast is looked at, however short."""
    values = np.random.default_rng(6).random((5, 3, 4))
    problem = SAP(values, 0.2)
    seen = rollout(problem, HAALD(3, 1e-3, ring(3)), forecast=lambda k, steps: values[k : k + 1])
    assert (seen.plan == rollout(problem, HAALD(1, 1e-3, ring(3))).plan).all()


def test_idle_agents_of_an_array_do_not_crowd() -> None:
    """Idle agents of a dense problem with handovers take few rounds to find places of their own."""
    values = np.zeros((2, 20, 30))
    values[1, 10:, :10] = 5.0  # ten agents must go, and ten have their places taken
    problem = SAP(values, 1.0, np.arange(20))
    _, traffic = play(problem, HAALD(1, 0.01, nx.complete_graph(20)))
    assert traffic[1].rounds < 40


def test_solve_keeps_the_traffic() -> None:
    """`solve` tells in the trace what `play` returns beside the plan, with equal keys at every step."""
    problem = SAP(np.random.default_rng(0).random((4, 5, 6)), SwitchingCost(0.3))
    for policy in (HAALD(2), CBBA(2), DistributedAuction(), DistributedDualLookahead(2)):
        result = solve(problem, policy)
        traffic = play(problem, policy)[1]
        assert [step["rounds"] for step in result.trace] == [one.rounds for one in traffic]
        assert [step["bytes"] for step in result.trace] == [one.bytes for one in traffic]
        assert len({tuple(step) for step in result.trace}) == 1


@pytest.mark.parametrize("idle", [False, True])
def test_few_rounds_on_a_split_network(idle: bool) -> None:
    """Agents that are cut off from each other and run out of rounds still end with one task each."""
    graph = nx.Graph([(0, 1), (2, 3)])
    graph.add_nodes_from(range(5))
    for seed in range(20):
        problem = SAP(np.random.default_rng(seed).random((3, 5, 6)), SwitchingCost(0.3, idle_is_free=idle))
        method = HAALD(2, graph=graph, allow_disconnected=True, max_rounds=5)
        result = solve(problem, method)
        assert result.value == problem.evaluate(result.plan).value
        assert all(len(set(row)) == 5 for row in result.plan.tolist())
