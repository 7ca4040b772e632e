"""AssignmentPolicy and NoHandover against their definitions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from strategies import FORMS, Instance, instances

from sapopt import SAP, GainMatrix, InfeasibleError, Outlook, SwitchingCost, assign, solve
from sapopt.running.outlook import Policy
from sapopt.solvers import HAA, AssignmentPolicy, Greedy, NoHandover, myopic

PROBLEM = SAP(np.random.default_rng(0).random((6, 3, 5)), SwitchingCost(0.3), [4, 0, 2])


def constant(matrix: Any) -> AssignmentPolicy:
    """The policy of a generator that always answers the same."""
    return AssignmentPolicy(lambda outlook: matrix)


# --- AssignmentPolicy ---


@given(instances(forbid=True))
def test_alpha_of_beta_hat_is_haa(instance: Instance) -> None:
    """alpha(myopic) is the handover-aware algorithm."""
    for form in FORMS:
        problem = instance.problem(form)
        np.testing.assert_array_equal(
            solve(problem, AssignmentPolicy(myopic)).plan, solve(problem, HAA()).plan
        )


def test_generators_see_the_outlook() -> None:
    """A generator of its own: benefits minus a price on the previous task, by hand."""

    def restless(outlook: Outlook) -> np.ndarray:
        matrix = outlook.benefits(1).dense()[0].copy()
        matrix[np.arange(3), outlook.state] -= 10.0
        return matrix

    previous = PROBLEM.initial_assignment
    for k, row in enumerate(solve(PROBLEM, AssignmentPolicy(restless)).plan):
        matrix = PROBLEM.benefits.dense()[k].copy()
        matrix[np.arange(3), previous] -= 10.0
        np.testing.assert_array_equal(row, assign(matrix))
        assert (row != previous).all()
        previous = row


def test_generators_answer_in_any_form() -> None:
    """Arrays, lists, every sparse format and gain matrices are the same answer."""
    matrix = np.array([[0.0, 0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 3.0, 0.0, 1.5], [0.0] * 5])
    expected = np.tile(assign(matrix), (6, 1))
    assert expected[0].tolist() == [2, 4, 0]
    answers = [matrix, matrix.tolist(), matrix.astype(np.float32), GainMatrix.from_matrix(matrix)]
    answers += [
        getattr(sp, f"{form}_array")(matrix) for form in ("bsr", "coo", "csc", "csr", "dia", "dok", "lil")
    ]
    for answer in answers:
        np.testing.assert_array_equal(solve(PROBLEM, constant(answer)).plan, expected)
    negative = solve(PROBLEM, constant(sp.csr_array(matrix - 1))).plan
    assert (matrix[np.arange(3), negative[0]]).sum() == 3.5


NAN, INF = float("nan"), float("inf")
BAD: dict[str, tuple[Any, str]] = {
    "too few tasks": (np.ones((3, 4)), r"shape \(3, 4\) at step 0; expected \(3, 5\)"),
    "too many tasks, sparse": (sp.csr_array(np.ones((3, 9))), r"shape \(3, 9\) at step 0; expected \(3, 5\)"),
    "too few agents, sparse": (sp.csr_array(np.ones((2, 5))), r"shape \(2, 5\) at step 0"),
    "too many tasks, gains": (GainMatrix.from_matrix(np.ones((3, 9))), r"shape \(3, 9\) at step 0"),
    "vector": (np.ones(5), "step 0"),
    "NaN": (np.full((3, 5), NAN), "generator at step 0: matrix contains NaN"),
    "+inf": (np.full((3, 5), INF), r"\+inf"),
    "sparse +inf": (sp.csr_array(np.full((3, 5), INF)), r"\+inf"),
    "sparse NaN": (sp.csr_array(np.full((3, 5), NAN)), "NaN"),
    "complex": (np.full((3, 5), 1j), "real numbers"),
    "none": (None, "step 0"),
    "text": ("abc", "step 0"),
    "ragged": ([[1.0], [1.0, 2.0]], "step 0"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_answers_of_a_generator(name: str) -> None:
    """A generator's answer is checked, with the step, before any kernel reads it."""
    answer, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        solve(PROBLEM, constant(answer))


def test_generators_that_forbid_everything() -> None:
    """A matrix without a full assignment names the step."""
    with pytest.raises(InfeasibleError, match="step 0: no full assignment exists"):
        solve(PROBLEM, constant(np.full((3, 5), -INF)))


def test_what_is_no_generator() -> None:
    """A matrix is no generator."""
    with pytest.raises(ValueError, match="generator must be callable"):
        AssignmentPolicy(np.ones((3, 5)))  # type: ignore[arg-type]


def test_names() -> None:
    """Names for tables, from the generator's own."""
    assert [policy.name for policy in (AssignmentPolicy(myopic), NoHandover(), Greedy())] == [
        "AssignmentPolicy(myopic)", "NoHandover", "Greedy",
    ]  # fmt: skip
    assert AssignmentPolicy(_Callable()).name == "AssignmentPolicy(_Callable)"
    assert all(isinstance(policy, Policy) for policy in (AssignmentPolicy(myopic), NoHandover(), Greedy()))


class _Callable:
    def __call__(self, outlook: Outlook) -> Any:
        return outlook.beta_hat()


# --- NoHandover ---


@given(instances(forbid=True))
def test_no_handover_is_alpha_of_the_benefits(instance: Instance) -> None:
    """Every step is assigned as if it were alone, whatever the costs and the initial assignment."""
    for form in ("dense", "sparse"):
        problem = instance.problem(form)
        plan = solve(problem, NoHandover()).plan
        for k, row in enumerate(plan):
            np.testing.assert_array_equal(row, assign(problem.benefits.step(k)))
