"""Capacities, idleness, limits and teams: what a plan is worth, what is refused, and what files keep."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from sapopt import SAP, Limit, SwitchingCost, Team, assign
from tests.limited_problems import LOCAL, placed, tiny

ONES = np.ones((3, 2, 3))


@pytest.mark.parametrize("seed", range(60))
def test_values_are_those_of_the_definitions(seed: int) -> None:
    """Random plans of random problems are worth what a reading of the definitions says, or are refused as it does."""
    rng = np.random.default_rng(seed)
    case = tiny(rng, (*LOCAL, "dictator")[seed % (len(LOCAL) + 1)], 300)
    if case is None:
        return
    plans = list(case.plans())
    for place in rng.integers(0, len(plans), 12):
        value = case.value(plans[place])
        if value is None:
            with pytest.raises(ValueError, match=r"limit|forbidden"):
                case.problem.evaluate(placed(plans[place]))
        else:
            assert case.problem.evaluate(placed(plans[place])).value == pytest.approx(value, abs=1e-9)


def test_capacity_counts_agents() -> None:
    """A task takes as many agents as its capacity says, at every step, and none where it is 0."""
    problem = SAP(np.ones((2, 3, 2)), 0.0, capacity=[[2, 1], [3, 0]])
    assert problem.evaluate([[0, 0, 1], [0, 0, 0]]).value == 6.0
    with pytest.raises(ValueError, match=r"task 0 is given to agents 0, 1, 2 at step 0; its capacity is 2"):
        problem.evaluate([[0, 0, 0], [0, 0, 0]])
    with pytest.raises(ValueError, match=r"task 1 is given to agents 2 at step 1; its capacity is 0"):
        problem.evaluate([[0, 0, 1], [0, 0, 1]])


def test_idleness_is_free_and_taking_up_a_task_is_not() -> None:
    """-1 is worth nothing and costs nothing; the way back to the same task is a handover."""
    problem = SAP(np.ones((4, 1, 1)), 0.25, idle=True)
    score = problem.evaluate([[0], [-1], [0], [-1]])
    assert score.value == 2.0 - 0.25
    assert score.handovers == 1
    with pytest.raises(ValueError, match="idle=True"):
        SAP(np.ones((4, 1, 1)), 0.25).evaluate([[0], [-1], [0], [0]])


def test_what_is_plain_stays_plain() -> None:
    """Capacities of one and no limits are the problem as it always was, with its very fingerprint."""
    plain = SAP(ONES, 0.5)
    same = SAP(ONES, 0.5, capacity=np.ones((3, 3), dtype=int), idle=False, limits=[])
    assert same.is_plain
    assert same.core is same
    assert same.fingerprint == plain.fingerprint
    assert SAP(ONES, 0.5, idle=True).fingerprint != plain.fingerprint


def test_use_and_slack_are_told() -> None:
    """Every sum of a limit is told with its bounds; a violated hard limit names limit, steps and agents."""
    problem = SAP(
        ONES, 0.0, limits=[Limit.once("b", 2, penalty=0.5), Limit.work(at_most=3)], tasks=list("abc")
    )
    score = problem.evaluate([[1, 0], [1, 0], [1, 0]])
    assert [(use.name, use.use, use.slack, use.cost) for use in score.limits] == [
        ("once[b]", 3.0, -1.0, 0.5), ("work[0]", 3.0, 0.0, 0.0), ("work[1]", 3.0, 0.0, 0.0),
    ]  # fmt: skip
    assert score.value == 6.0 - 0.5
    hard = SAP(ONES, 0.0, limits=[Limit.once(1, name="look")])
    with pytest.raises(
        ValueError, match=r"limit 'look\[1\]': its sum is 2, above at_most=1 \(agent 0 at step 0, agent 0"
    ):
        hard.evaluate([[1, 0], [1, 0], [2, 0]])


def test_a_team_earns_once_a_step() -> None:
    """The reward is earned where enough agents hold the task together, and once, however many they are."""
    problem = SAP(np.zeros((2, 3, 2)), 0.0, capacity=3, limits=[Team(0, 2, 5.0)])
    assert problem.evaluate([[0, 0, 0], [0, 1, 1]]).value == 5.0
    assert problem.evaluate([[0, 0, 0], [0, 1, 1]]).teams == 5.0


def test_a_visit_lasts_several_steps() -> None:
    """Serving a task for several steps on end is one visit; a break, or a step out of sight, begins another."""
    benefits = np.array([1.0, 1, 0, 1, 1])[:, None, None]
    problem = SAP(benefits, 0.0, idle=True, limits=[Limit.visits(at_most=2)])
    assert problem.evaluate([[0], [0], [0], [0], [0]]).limits[0].use == 2.0
    in_sight = SAP(np.ones((5, 1, 1)), 0.0, idle=True, limits=[Limit.visits(at_most=2)])
    with pytest.raises(ValueError, match="its sum is 3"):
        in_sight.evaluate([[0], [-1], [0], [-1], [0]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"capacity": -1}, "capacity must not be negative"),
        ({"capacity": [1, 2]}, r"capacity must be a number, or have shape \(m,\) = \(3,\)"),
        ({"capacity": 1.5}, "capacity must hold integers"),
        ({"capacity": 0}, "the tasks have room for 0 of 2 agents"),
        ({"idle": "yes"}, "idle must be True or False"),
        ({"limits": [Limit.once(7)]}, "number 0 .once.: tasks: 7 is outside 0..2"),
        ({"limits": [Limit.once("x")]}, "none with the label 'x'"),
        ({"limits": [Limit(np.ones((2, 2)), 1)]}, "does not broadcast"),
        ({"limits": [Limit([[[np.nan]]], 1)]}, "weight must be finite"),
        ({"limits": [Limit([sp.csr_array((2, 3))], 1)]}, "3 sparse matrices"),
        ({"limits": [Limit.cover([0], 3)]}, "at_least=3 is out of reach"),
        ({"limits": [Limit.cover([0], 1, steps=9)]}, "steps: 9 is outside"),
        ({"limits": ["once"]}, "must hold Limit and Team only"),
        ({"limits": [Team(0, 2, 1.0)]}, "at most 1 may hold task 0"),
        ({"initial_assignment": [1, 1]}, "gives task 1 to two agents"),
        ({"initial_assignment": [1, 1], "capacity": [1, 1, 3]}, "gives task 1 to two agents"),
        ({"initial_assignment": [-1, 1]}, "outside 0..2"),
    ],
)  # fmt: skip
def test_bad_input_gets_one_clear_line(arguments: dict[str, Any], message: str) -> None:
    """What does not fit is refused when the problem is built, with the argument's name."""
    with pytest.raises(ValueError, match=message):
        SAP(ONES, 0.0, **arguments)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Limit(1.0), "at least one of the two"),
        (lambda: Limit(1.0, 1, 2), "at_least=2 is above at_most=1"),
        (lambda: Limit(1.0, float("nan")), "at_most must be a finite number"),
        (lambda: Limit(1.0, 1, penalty=0), "penalty must be positive"),
        (lambda: Limit.handovers(1, each=2), "each must be True or False"),
        (lambda: Limit.cover(0, 1, served=2), "served must be True or False"),
        (lambda: Team(0, 0, 1.0), "needs must be a whole number"),
        (lambda: Team(0, 1, -1.0), "reward must not be negative"),
    ],
)  # fmt: skip
def test_bad_limits_get_one_clear_line(make: Any, message: str) -> None:
    """A limit that contradicts itself is refused when it is made."""
    with pytest.raises(ValueError, match=message):
        make()


def test_files_keep_everything(tmp_path: Path) -> None:
    """Capacities, idleness and every field of every kind of limit come back from a file."""
    rng = np.random.default_rng(1)
    weight = [sp.random_array((2, 3), density=0.5, rng=rng, format="csr") for _ in range(3)]
    limits = [
        Limit(rng.random((1, 2, 3)), 4, 0, name="mine", penalty=2.0), Limit(weight, 5), Limit.once(["b"], 2),
        Limit.visits([0, 2], 2), Limit.cover(range(3), 1, [1]), Limit.work([0], 3, 1), Limit.handovers(3, [1], True),
        Limit.cover(["a", "c"], 1, [0, 2], served=True), Team("c", 2, 0.5, [0, 2]),
    ]  # fmt: skip
    problem = SAP(
        rng.random((3, 2, 3)), 0.5, [-1, 2], capacity=[1, 2, 2], idle=True, limits=limits, tasks=list("abc")
    )
    problem.save(tmp_path / "p.npz")
    back = SAP.load(tmp_path / "p.npz")
    assert back.fingerprint == problem.fingerprint
    for field in dataclasses.fields(type(problem.rows)):
        old, new = getattr(problem.rows, field.name), getattr(back.rows, field.name)
        for a, b in zip(np.atleast_1d(old), np.atleast_1d(new), strict=True):
            assert np.array_equal(a, b), field.name
    without = SAP(
        problem.benefits, 0.5, [-1, 2], capacity=[1, 2, 2], idle=True, limits=limits[1:], tasks=list("abc")
    )
    assert without.fingerprint != problem.fingerprint


def test_a_matrix_of_costs_knows_idleness() -> None:
    """With idle=True a matrix of costs has a row and a column more; otherwise the message says so."""
    cost = np.array([[0.0, 2.0, 0.0], [3.0, 0.0, 0.0], [1.0, 4.0, 0.0]])
    problem = SAP(np.zeros((3, 1, 2)), SwitchingCost(cost), idle=True)
    assert problem.evaluate([[0], [-1], [1]]).value == -4.0
    with pytest.raises(ValueError, match="holding nothing is a further task"):
        SAP(np.zeros((3, 1, 2)), SwitchingCost(cost[:2, :2]), idle=True)
    with pytest.raises(ValueError, match="last column"):
        SAP(np.zeros((3, 1, 2)), SwitchingCost(cost.T), idle=True)


def test_assign_by_capacity() -> None:
    """`assign` takes capacities, and -1 for agents that are better off with nothing."""
    matrix = np.array([[3.0, 1.0], [3.0, -1.0], [2.0, -1.0]])
    assert assign(matrix, capacity=[3, 1]).tolist() == [0, 0, 0]
    assert assign(matrix[1:], capacity=[1, 1], idle=True).tolist() == [0, -1]
    with pytest.raises(ValueError, match="3 agents cannot each have one of 2 tasks"):
        assign(matrix, capacity=[1, 1])
