"""SAP: plans are scored by the definition, bad input is refused with a reason."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from strategies import FORMS, Instance, as_form, full_assignment_exists, instances, plans_of

from sapopt import SAP, SwitchingCost
from sapopt.dynamics import Dynamics

CUBE = np.random.default_rng(0).random((4, 3, 5)).round(2)
PLAN = np.array([[0, 1, 2], [0, 1, 3], [4, 1, 3], [4, 2, 3]])


# --- The value of a plan ---


@given(instances(), st.data())
def test_evaluate_is_the_definition(instance: Instance, data: st.DataObject) -> None:
    """Value, benefits, charges and handovers are those of the definition, in every form of the benefits."""
    plan = data.draw(plans_of(instance.benefits.shape))
    benefit, charge, changes = instance.step_values(plan)
    for form in FORMS:
        score = instance.problem(form).evaluate(plan)
        assert score.value == instance.score(plan)
        np.testing.assert_array_equal(score.benefit, benefit)
        np.testing.assert_array_equal(score.handover, -np.array(charge))
        assert score.handovers == changes
        assert isinstance(score.value, float)
        assert isinstance(score.handovers, int)


@given(instances(forbid=True), st.data())
def test_forbidden_pairs_in_a_plan(instance: Instance, data: st.DataObject) -> None:
    """A plan is refused exactly if it uses a forbidden pair, and the first one is named."""
    plan = data.draw(plans_of(instance.benefits.shape))
    taken = np.take_along_axis(instance.benefits, plan[:, :, None], axis=2)[:, :, 0]
    for form in FORMS:
        problem = instance.problem(form)
        if np.isfinite(taken).all():
            assert problem.evaluate(plan).value == instance.score(plan)
        else:
            k, i = np.argwhere(taken == -np.inf)[0]
            with pytest.raises(ValueError, match=f"agent {i} may not take task {plan[k, i]} at step {k} "):
                problem.evaluate(plan)


@given(instances(), st.data())
def test_beta_hat_scores_plans_too(instance: Instance, data: st.DataObject) -> None:
    """The sum of beta_hat along a plan, stepping the state by hand, is the value."""
    problem = instance.problem()
    plan = data.draw(plans_of(instance.benefits.shape))
    state, total = problem.initial_state(), 0.0
    for k, row in enumerate(plan):
        total += problem.beta_hat(k, state)[np.arange(problem.n), row].sum()
        state = problem.transition(k, state, row)
    assert total == instance.score(plan)


@given(instances(), st.data())
def test_relabelling_agents(instance: Instance, data: st.DataObject) -> None:
    """Agents in another order, with the plan in that order, have the same value."""
    plan = data.draw(plans_of(instance.benefits.shape))
    order = np.array(data.draw(st.permutations(range(plan.shape[1]))))
    initial = None if instance.initial is None else tuple(np.array(instance.initial)[order])
    moved = dataclasses.replace(instance, benefits=instance.benefits[:, order], initial=initial)
    first, second = instance.problem().evaluate(plan), moved.problem().evaluate(plan[:, order])
    assert (first.value, first.handovers) == (second.value, second.handovers)


def test_exact_sum() -> None:
    """Large and small benefits are added without losing the small ones."""
    values = np.zeros((3, 1, 1))
    values[:, 0, 0] = 1e16, 1.0, -1e16
    assert SAP(values).evaluate([[0], [0], [0]]).value == 1.0


def test_values_too_large_to_add() -> None:
    """A cost whose sum over a plan overflows is an error, not an infinite value."""
    with pytest.raises(ValueError, match="overflow"):
        SAP(CUBE, 1e308).evaluate([[0, 1, 2], [2, 0, 1], [1, 2, 0], [3, 4, 1]])


def test_initial_assignment_counts() -> None:
    """Without an initial assignment the first step is free and no handover; with one it is neither."""
    plan = [[1]]
    free = SAP(np.ones((1, 1, 2)), 0.25).evaluate(plan)
    moved = SAP(np.ones((1, 1, 2)), 0.25, [0]).evaluate(plan)
    held = SAP(np.ones((1, 1, 2)), 0.25, [1]).evaluate(plan)
    assert [(s.value, s.handovers) for s in (free, moved, held)] == [(1.0, 0), (0.75, 1), (1.0, 0)]


def test_plan_forms() -> None:
    """Lists, any integer type and whole floats are plans; the caller's array stays the caller's."""
    problem = SAP(CUBE, 0.1)
    value = problem.evaluate(PLAN).value
    for plan in (
        PLAN.tolist(),
        PLAN.astype(np.uint8),
        PLAN.astype(np.int32),
        PLAN.astype(float),
        np.asfortranarray(PLAN),
    ):
        assert problem.evaluate(plan).value == value
    checked = problem.check_plan(PLAN)
    assert checked.dtype == np.int64
    assert not np.shares_memory(checked, PLAN)


def changed(k: int, i: int, task: Any, kind: Any = np.int64) -> np.ndarray:
    """PLAN with one entry changed."""
    plan = PLAN.astype(kind)
    plan[k, i] = task
    return plan


BAD_PLANS: dict[str, tuple[Any, str]] = {
    "duplicate": (changed(2, 1, 3), "task 3 is given to agents 1, 2 at step 2"),
    "too high": (changed(1, 2, 5), r"task 5 of agent 2 at step 1 is outside 0\.\.4"),
    "negative": (changed(3, 0, -1), r"task -1 of agent 0 at step 3 is outside 0\.\.4"),
    "one step short": (PLAN[:3], r"shape \(T, n\) = \(4, 3\), got \(3, 3\)"),
    "one agent more": (np.hstack([PLAN, PLAN[:, :1]]), r"\(4, 4\)"),
    "transposed": (PLAN.T, r"got \(3, 4\)"),
    "flat": (PLAN.ravel(), r"got \(12,\)"),
    "three axes": (PLAN[None], r"got \(1, 4, 3\)"),
    "one-hot": (np.eye(5)[PLAN], r"got \(4, 3, 5\)"),
    "empty": ([], "plan"),
    "number": (3, "plan"),
    "none": (None, "plan"),
    "fraction": (changed(0, 0, 0.5, float), "integers"),
    "NaN": (changed(0, 0, np.nan, float), "integers"),
    "infinite": (changed(0, 0, np.inf, float), "integers"),
    "huge float": (changed(0, 0, 1e300, float), "integers"),
    "wraps around": (changed(0, 0, 2**64 - 5, np.uint64), "integers|outside"),
    "beyond int64": (changed(0, 0, 2**80, object), "integers"),
    "truth values": (PLAN > 2, "integers"),
    "complex": (PLAN.astype(complex), "integers"),
    "text": (PLAN.astype(str), "integers"),
    "objects": (PLAN.astype(object), "integers"),
    "ragged": ([[0, 1, 2], [0, 1]], "plan must be a regular array"),
    "sparse": (sp.csr_array(PLAN), "plan"),
}


@pytest.mark.parametrize("name", BAD_PLANS)
def test_bad_plans(name: str) -> None:
    """A plan of a wrong shape, type or content is refused; the message says where."""
    plan, message = BAD_PLANS[name]
    with pytest.raises(ValueError, match=message):
        SAP(CUBE, 0.1).evaluate(plan)


# --- Building a problem ---

COST = np.ones((5, 5)) - np.eye(5)

BAD_PROBLEMS: dict[str, tuple[dict[str, Any], str]] = {
    "more agents than tasks": ({"benefits": np.ones((2, 3, 2))}, r"3 agents .* 2 tasks.*with_idle_tasks"),
    "more agents, sparse": ({"benefits": [sp.csr_array((3, 2))]}, "with_idle_tasks"),
    "negative cost": ({"dynamics": -0.5}, "not negative"),
    "NaN cost": ({"dynamics": float("nan")}, "finite"),
    "infinite cost": ({"dynamics": float("inf")}, "finite"),
    "cost as text": ({"dynamics": "0.5"}, "needs the methods"),
    "no dynamics": ({"dynamics": None}, "needs the methods"),
    "class": ({"dynamics": SwitchingCost}, r"SwitchingCost\(\.\.\.\)"),
    "matrix as dynamics": ({"dynamics": COST}, "needs the methods"),
    "cost of another size": ({"dynamics": SwitchingCost(COST[:4, :4])}, r"\(4, 4\), but the benefits have 5 tasks"),
    "duplicate": ({"initial_assignment": [0, 1, 1]}, "task 1 to two agents"),
    "too high": ({"initial_assignment": [0, 1, 5]}, r"outside 0\.\.4"),
    "negative": ({"initial_assignment": [0, 1, -1]}, r"outside 0\.\.4"),
    "too short": ({"initial_assignment": [0, 1]}, r"shape \(n,\) = \(3,\), got \(2,\)"),
    "column": ({"initial_assignment": [[0], [1], [2]]}, r"got \(3, 1\)"),
    "number": ({"initial_assignment": 1}, r"got \(\)"),
    "fractions": ({"initial_assignment": [0, 1, 1.5]}, "initial_assignment must hold integers"),
    "truth values": ({"initial_assignment": [True, False, True]}, "initial_assignment must hold integers"),
    "text": ({"initial_assignment": "012"}, "initial_assignment"),
    "ragged": ({"initial_assignment": [[0, 1], 2]}, "initial_assignment"),
    "huge": ({"initial_assignment": [0, 1, 2**64 - 1]}, "initial_assignment"),
    "labels": ({"agents": ["a", "b"]}, "agents: 2 labels for 3 agents"),
    "task labels": ({"tasks": ["a"]}, "tasks: 1 labels for 5 tasks"),
    "a word as labels": ({"agents": "abc"}, "agents must be a list"),
    "half a character": ({"agents": ["a", "\ud800", "c"]}, "agents: label 1, .* holds half a character"),
    "a number as labels": ({"tasks": 5}, "tasks must be a list"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_PROBLEMS)
def test_bad_problems(name: str) -> None:
    """Each bad argument is a ValueError that names it."""
    options, message = BAD_PROBLEMS[name]
    with pytest.raises(ValueError, match=message):
        SAP(**({"benefits": CUBE} | options))


@pytest.mark.parametrize("form", FORMS)
def test_steps_without_a_full_assignment(form: str) -> None:
    """Forbidden pairs that leave a step without an assignment are found at the door, and the step is named."""
    values = np.ones((3, 2, 3))
    values[1, :, 1:] = -np.inf
    with pytest.raises(
        ValueError, match=r"step 1: no full assignment exists: agents 0, 1 \(2 in all\).* only 1 task"
    ):
        SAP(as_form(values, form))
    assert SAP.with_idle_tasks(as_form(values, form)).m == 5


@given(instances(most=(2, 3, 4)), st.data())
def test_forbidden_pairs_are_checked_exactly(instance: Instance, data: st.DataObject) -> None:
    """A problem is refused exactly if some step has no full assignment."""
    values = instance.benefits.copy()
    values[
        np.array(data.draw(st.lists(st.booleans(), min_size=values.size, max_size=values.size))).reshape(
            values.shape
        )
    ] = -np.inf
    feasible = all(full_assignment_exists(step > -np.inf) for step in values)
    for form in ("dense", "sparse"):
        if feasible:
            SAP(as_form(values, form))
        else:
            with pytest.raises(ValueError, match="no full assignment exists"):
                SAP(as_form(values, form))


def test_costs_as_numbers() -> None:
    """Any real number is a switching cost: Python's and numpy's."""
    for cost in (1, 1.0, np.float32(1), np.int64(1)):
        assert SAP(CUBE, cost).evaluate(PLAN).value == SAP(CUBE, SwitchingCost(1.0)).evaluate(PLAN).value


def test_idle_tasks_for_more_agents_than_tasks() -> None:
    """n > m is made solvable by idle tasks, whose labels follow the others; everything else is passed on."""
    values = np.arange(12.0).reshape(2, 3, 2)
    for form in FORMS:
        problem = SAP.with_idle_tasks(
            as_form(values, form), SwitchingCost(0.5), [4, 0, 1], agents=["a", "b", "c"], tasks=["x", "y"]
        )
        assert (problem.T, problem.n, problem.m) == (2, 3, 5)
        assert problem.tasks == ("x", "y", "idle 0", "idle 1", "idle 2")
        assert problem.agents == ("a", "b", "c")
        np.testing.assert_array_equal(problem.initial_assignment, [4, 0, 1])
        assert problem.evaluate([[2, 0, 1], [3, 0, 1]]).value == 2 + 5 + 8 + 11 - 2 * 0.5
    with pytest.raises(ValueError, match="tasks"):
        SAP.with_idle_tasks(values, 0.5, tasks=["x"])
    with pytest.raises(ValueError, match="5 tasks"):
        SAP.with_idle_tasks(values, SwitchingCost(np.zeros((2, 2))))


def test_labels_are_words() -> None:
    """Labels are kept as a tuple of text."""
    problem = SAP(CUBE, agents=[1, 2, 3], tasks=iter("abcde"))  # type: ignore[list-item, arg-type]
    assert problem.agents == ("1", "2", "3")
    assert problem.tasks == tuple("abcde")
    assert SAP(CUBE).agents is None


def test_initial_assignment_is_copied() -> None:
    """A later change of the caller's array does not reach the problem."""
    initial = np.array([0, 1, 2])
    problem = SAP(CUBE, 0.1, initial)
    initial[:] = 4
    assert problem.initial_assignment is not None
    assert problem.initial_assignment.tolist() == [0, 1, 2]


# --- User-defined dynamics ---


class Tired:
    """An agent that works three steps in a row is forbidden to go on; the state is private to this class."""

    def initial_state(self, problem: SAP) -> tuple[int, ...]:
        return (0,) * problem.n

    def handover(self, k: int, state: Any) -> np.ndarray:
        eta = np.zeros((len(state), 5))
        eta[np.array(state) >= 3, :2] = -np.inf
        return eta

    def transition(self, k: int, state: Any, assignment: np.ndarray) -> tuple[int, ...]:
        return tuple(s + 1 if j < 2 else 0 for s, j in zip(state, assignment, strict=True))


@dataclass(frozen=True)
class Mood:
    """Chapter 6.1 in small: one state for all, moved by agent 0, decides what everybody's tasks are worth."""

    size: tuple[int, int]

    def initial_state(self, problem: SAP) -> int:
        return 0

    def handover(self, k: int, state: int) -> np.ndarray:
        return np.roll(np.arange(np.prod(self.size)) % 3, state).reshape(self.size) * 0.5

    def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
        return int(assignment[0]) % 3


class Fixed:
    """A handover matrix that does not depend on anything, for bad ones."""

    def __init__(self, eta: Any) -> None:
        self.eta = eta

    def initial_state(self, problem: SAP) -> None:
        return None

    def handover(self, k: int, state: None) -> Any:
        return self.eta

    def transition(self, k: int, state: None, assignment: np.ndarray) -> None:
        return None


def test_user_dynamics_are_scored() -> None:
    """A class with the three methods is a dynamics: values follow its state."""
    problem = SAP(CUBE, Mood((3, 5)))
    value, mood = 0.0, 0
    for k, row in enumerate(PLAN):
        value += sum(
            CUBE[k, i, j] + np.roll(np.arange(15) % 3, mood)[5 * i + j] * 0.5 for i, j in enumerate(row)
        )
        mood = row[0] % 3
    score = problem.evaluate(PLAN)
    assert score.value == pytest.approx(value, abs=1e-12)
    assert score.handovers == 3
    assert isinstance(Mood((3, 5)), Dynamics)


def test_user_dynamics_forbid() -> None:
    """A pair that is forbidden by the state makes the plan infeasible, and is named."""
    problem = SAP(CUBE, Tired())
    assert problem.evaluate([[0, 1, 2]] * 3 + [[2, 3, 4]]).handover.sum() == 0.0
    with pytest.raises(ValueError, match="agent 0 may not take task 0 at step 3"):
        problem.evaluate([[0, 1, 2]] * 4)


@pytest.mark.parametrize(
    ("eta", "message"),
    [
        (np.zeros((3, 4)), r"shape \(3, 4\) at step 0, expected \(3, 5\)"),
        (0.0, r"shape \(\) at step 0"),
        (np.full((3, 5), np.nan), "NaN"),
        (np.full((3, 5), np.inf), r"\+inf"),
        (np.full((3, 5), 1j), "real numbers"),
        (None, "dynamics.handover"),
        ([[1.0], [1.0, 2.0]], "dynamics.handover"),
    ],
)
def test_bad_handover_matrices(eta: Any, message: str) -> None:
    """A handover matrix of a wrong shape or with values that mean nothing is refused."""
    with pytest.raises(ValueError, match=message):
        SAP(CUBE, Fixed(eta)).evaluate(PLAN)


@pytest.mark.parametrize("missing", ["initial_state", "handover", "transition"])
def test_incomplete_dynamics(missing: str) -> None:
    """A class without one of the three methods is no dynamics."""
    methods = {
        name: getattr(Fixed, name) for name in ("initial_state", "handover", "transition") if name != missing
    }
    with pytest.raises(ValueError, match="Half needs the methods initial_state, handover and transition"):
        SAP(CUBE, type("Half", (), methods)())


def test_user_dynamics_are_not_written(tmp_path: Path) -> None:
    """Files hold data, never code: a problem with user-defined dynamics is not saved, not even a subclass of ours."""
    custom = type("SwitchingCost", (SwitchingCost,), {})(0.5)
    for model in (Mood((3, 5)), Fixed(0.0), custom):
        problem = SAP(CUBE, model)
        with pytest.raises(ValueError, match="user-defined"):
            problem.save(tmp_path / "p.npz")
        with pytest.raises(ValueError, match="user-defined"):
            problem.fingerprint  # noqa: B018
    assert list(tmp_path.iterdir()) == []
