"""HAAL against an enumeration of Algorithm 2 and against published values."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from plain_haal import plain_step

from sapopt import SAP, Benefits, SwitchingCost, solve
from sapopt.data.windows import WindowSums
from sapopt.running.outlook import Outlook
from sapopt.running.rollout import rollout
from sapopt.solvers import HAA, HAAL
from sapopt.solvers.haal import HAALMemory
from sapopt.solvers.haal_tree import CompiledTree

DATA = Path(__file__).parents[1] / "data"
PEER = json.loads((DATA / "peer.json").read_text())


@pytest.fixture(scope="module")
def mid() -> SAP:
    """The thesis' mid-size instance."""
    with np.load(DATA / "mid.npz") as file:
        steps, n, m = (int(s) for s in file["shape"])
        rows = file["step"].astype(np.int64) * n + file["agent"]
        matrix = sp.csr_array((file["benefit"], (rows, file["task"])), shape=(steps * n, m))
    return SAP(
        Benefits.from_flat(matrix.indptr, matrix.indices, matrix.data, (steps, n, m)), SwitchingCost(0.5)
    )


class General(SwitchingCost):
    """The same model, but not of the type that has a compiled search."""


def general(problem: SAP) -> SAP:
    dynamics = General(problem.dynamics.cost, problem.dynamics.idle_is_free)
    return SAP(problem.benefits, dynamics, problem.initial_assignment)


def sparse_instance(seed: int, *, integer: bool, square: bool) -> SAP:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    m = n if square else n + int(rng.integers(1, 5))
    steps = int(rng.integers(3, 8))
    shape = (steps, n, m)
    values = rng.integers(1, 4, shape) if integer else rng.uniform(0.1, 2.0, shape)
    values = np.where(rng.random(shape) < rng.uniform(0.15, 0.7), values, 0).astype(float)
    while 2 * np.count_nonzero(values) > values.size:  # a problem holds those as an array
        values[rng.random(shape) < 0.2] = 0.0
    initial = rng.permutation(m)[:n] if rng.random() < 0.5 else None
    cost = float(rng.integers(0, 3)) if integer else float(rng.uniform(0, 1.5))
    dynamics = SwitchingCost(cost, idle_is_free=bool(rng.random() < 0.5))
    return SAP([sp.csr_array(v) for v in values], dynamics, initial)


def check_every_step(problem: SAP, lookahead: int, steps: int, ties: bool = False) -> None:
    plan = rollout(problem, HAAL(lookahead)).plan
    benefits = problem.benefits.dense()
    held = problem.initial_assignment
    for k in range(steps):
        expected = plain_step(
            benefits[k:], problem.dynamics.cost, 0, lookahead, held,
            idle_is_free=problem.dynamics.idle_is_free, ties=ties,
        )  # fmt: skip
        np.testing.assert_array_equal(plan[k], expected, err_msg=f"step {k}")
        held = plan[k]


@pytest.mark.parametrize(("lookahead", "steps"), [(1, 12), (2, 12), (3, 12), (4, 12), (6, 3)])
def test_equals_enumeration_on_mid(mid: SAP, lookahead: int, steps: int) -> None:
    part = SAP(mid.benefits.slice(0, steps + lookahead), mid.dynamics)
    check_every_step(part, lookahead, steps)


@pytest.mark.parametrize("square", [True, False])
@pytest.mark.parametrize("seed", range(25))
def test_equals_enumeration_on_small_problems(seed: int, square: bool) -> None:
    problem = sparse_instance(seed, integer=False, square=square)
    check_every_step(problem, 1 + seed % 5, problem.T)


@pytest.mark.parametrize("square", [True, False])
@pytest.mark.parametrize("seed", range(12))
def test_equals_enumeration_where_many_assignments_tie(seed: int, square: bool) -> None:
    problem = sparse_instance(100 + seed, integer=True, square=square)
    check_every_step(problem, 1 + seed % 4, problem.T, ties=True)


@pytest.mark.parametrize("integer", [True, False])
def test_compiled_and_general_search_agree(integer: bool) -> None:
    for seed in range(200, 260):
        problem = sparse_instance(seed, integer=integer, square=seed % 2 == 0)
        for solver in (HAAL(1 + seed % 6), HAAL(1 + seed % 4, "lookahead")):
            compiled = rollout(problem, solver).plan
            np.testing.assert_array_equal(compiled, rollout(general(problem), solver).plan)


@pytest.mark.parametrize("idle_is_free", [False, True])
def test_compiled_and_general_search_agree_with_negative_and_forbidden_pairs(idle_is_free: bool) -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        values = rng.choice(
            [0.0, 0.0, 1.0, 2.5, -0.5, -np.inf], size=(6, 4, 7), p=[0.3, 0.2, 0.2, 0.1, 0.1, 0.1]
        )
        problem = SAP(
            [sp.csr_array(v) for v in values], SwitchingCost(0.7, idle_is_free), rng.permutation(7)[:4]
        )
        compiled = rollout(problem, HAAL(4))
        np.testing.assert_array_equal(compiled.plan, rollout(general(problem), HAAL(4)).plan)


def test_general_search_takes_over_where_idling_is_not_free() -> None:
    # Two agents, two tasks, one pair forbidden: agent 1, idle, must not park on task 0, the only one left.
    values = np.array([[[0.0, 1.0], [-np.inf, 0.0]]] * 3)
    problem = SAP([sp.csr_array(v) for v in values], SwitchingCost(0.5))
    solver = HAAL(2)
    outlook = Outlook(0, 3, None, problem, WindowSums(problem.benefits), np.arange(2))
    tasks, memory = solver.act(outlook, HAALMemory())
    assert memory.uncompiled
    np.testing.assert_array_equal(tasks, [0, 1])


def test_mid_values(mid: SAP) -> None:
    for lookahead in range(1, 7):
        result = solve(mid, HAAL(lookahead))
        peer = PEER["haal_parking_on_lowest_free_task"][str(lookahead)]
        assert result.value == pytest.approx(peer["value"], abs=1e-6)
        assert result.handovers == peer["handovers"]
        published = PEER["published_haal"][str(lookahead)]
        assert result.value == pytest.approx(published["value"], rel=0.01)


def test_memory_changes_nothing_but_the_work(mid: SAP) -> None:
    solver = HAAL(4)
    windows = WindowSums(mid.benefits)
    state = None
    memory = HAALMemory()
    fresh_problems = 0
    for k in range(8):
        outlook = Outlook(k, mid.T, state, mid, windows, np.arange(mid.m))
        tasks, memory = solver.act(outlook, memory)
        fresh, scratch = solver.act(outlook, HAALMemory())
        np.testing.assert_array_equal(tasks, fresh)
        fresh_problems += scratch.assignment_problems
        state = tasks
    assert memory.assignment_problems < fresh_problems <= 8 * 15


def test_the_same_step_may_be_asked_again_from_other_states() -> None:
    problem = sparse_instance(5, integer=False, square=False)
    windows = WindowSums(problem.benefits)
    memory = HAALMemory()
    rng = np.random.default_rng(1)
    for k in [1, 1, 1, 0, 2, 2, 0, 1]:
        outlook = Outlook(
            k, problem.T, rng.permutation(problem.m)[: problem.n], problem, windows, np.arange(problem.m)
        )
        tasks, memory = HAAL(3).act(outlook, memory)
        np.testing.assert_array_equal(tasks, HAAL(3).act(outlook, HAALMemory())[0])


def test_forecast_that_changes_every_step() -> None:
    problem = sparse_instance(17, integer=False, square=False)

    def forecast(k: int, steps: int) -> list[sp.csr_array]:
        rng = np.random.default_rng(k)
        return [problem.benefits.step(t) * (0.5 + rng.random()) for t in range(k, min(k + 3, k + steps))]

    compiled = rollout(problem, HAAL(4), forecast=forecast).plan
    np.testing.assert_array_equal(compiled, rollout(general(problem), HAAL(4), forecast=forecast).plan)


def test_long_lookahead() -> None:
    rng = np.random.default_rng(3)
    values = np.where(rng.random((13, 5, 8)) < 0.3, rng.random((13, 5, 8)), 0.0)
    problem = SAP([sp.csr_array(v) for v in values], SwitchingCost(0.3))
    for lookahead in (10, 13):
        np.testing.assert_array_equal(
            rollout(problem, HAAL(lookahead)).plan, rollout(general(problem), HAAL(lookahead)).plan
        )


def test_too_large_a_tree_is_left_to_the_general_search(mid: SAP) -> None:
    outlook = Outlook(0, mid.T, None, mid, WindowSums(mid.benefits), np.arange(mid.m))
    assert CompiledTree.of(outlook, 14) is not None
    assert CompiledTree.of(outlook, 15) is None


def test_haa_is_haal_with_lookahead_one(mid: SAP) -> None:
    part = SAP(mid.benefits.slice(0, 10), mid.dynamics)
    np.testing.assert_array_equal(rollout(part, HAA()).plan, rollout(part, HAAL(1)).plan)


@pytest.mark.parametrize("lookahead", [0, -1, 1.5, "3"])
def test_lookahead_must_be_a_positive_integer(lookahead: object) -> None:
    with pytest.raises(ValueError, match="lookahead"):
        HAAL(lookahead)  # type: ignore[arg-type]


def test_unknown_parking() -> None:
    with pytest.raises(ValueError, match="parking"):
        HAAL(2, "nowhere")  # type: ignore[arg-type]


def test_a_dead_end_is_avoided() -> None:
    """A sequence that leads where no assignment is allowed loses against one that goes on."""

    class DeadEnd:
        """After task 0 nothing is allowed."""

        handover_limit = 0.0

        def initial_state(self, problem: SAP) -> int:
            return -1

        def handover(self, k: int, state: int) -> np.ndarray:
            eta = np.zeros((1, 2))
            if state == 0:
                eta[0] = -np.inf
            return eta

        def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
            return int(assignment[0])

        def key(self, state: int) -> int:
            return state

    problem = SAP(np.array([[[1.0, 0.5]], [[0.0, 5.0]]]), DeadEnd())
    for keep_plan in (False, True):
        result = solve(problem, HAAL(2, keep_plan=keep_plan))
        assert result.plan.tolist() == [[1], [1]]
        assert result.value == 5.5


def test_keep_plan_is_not_below_haa_at_full_lookahead() -> None:
    """HAAL+ with L = T is at least HAA, also on the known instances where HAAL is not (docs/theorem.md)."""
    known = json.loads((DATA / "theorem_counterexamples.json").read_text())["instances"]
    below = 0
    for entry in known:
        if "benefits" not in entry or entry["lookahead"] != len(entry["benefits"]):
            continue
        problem = SAP(entry["benefits"], SwitchingCost(entry["cost"]), entry["initial_assignment"])
        haa = solve(problem, HAA()).value
        assert solve(problem, HAAL(entry["lookahead"], keep_plan=True)).value >= haa
        below += solve(problem, HAAL(entry["lookahead"])).value < haa
    assert below > 0
