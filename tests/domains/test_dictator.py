"""The dictator's problem: 60 is the optimum, greed stays at 30."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import Status, solve
from sapopt.domains.dictator import VALUES
from sapopt.domains.instances import instance
from sapopt.solvers import HAA, AssignmentPolicy, Exact
from sapopt.solvers.exact.dp import assignments
from sapopt.solvers.policy import myopic


def test_optimum() -> None:
    """Dynamic programming finds 60 and proves it; the plan sacrifices two steps, and takes the bait at the end only."""
    result = solve(instance("dictator"), Exact(method="dp"))
    assert (result.value, result.bound, result.status) == (60.0, 60.0, Status.OPTIMAL)
    dictator = result.plan[:, 0]
    assert dictator[0] == 1
    assert dictator[1] in (1, 2)  # both lead to the rich state
    assert dictator[2:].tolist() == [*[2] * 7, 0]


def test_greed_settles_at_the_selfish_value() -> None:
    """Alpha(beta_hat) keeps the dictator on its own task: 3 in every step."""
    problem = instance("dictator")
    for solver in (AssignmentPolicy(myopic), HAA()):
        result = solve(problem, solver)
        assert result.value == 30.0
        assert (result.plan[:, 0] == 0).all()


def test_table_of_the_docstring() -> None:
    """Best value of a step in every state, by the dictator's task."""
    best = np.full((3, 3), -np.inf)
    for row in assignments(3, 3):
        worth = VALUES[:, np.arange(3), row].sum(axis=1)
        best[:, row[0]] = np.maximum(best[:, row[0]], worth)
    assert best.tolist() == [[3, 2, 1], [3, 1, 1], [8, 5, 7]]


def test_steps_and_costs() -> None:
    """Any number of steps; a cost is refused."""
    assert instance("dictator", steps=4).T == 4
    with pytest.raises(ValueError, match="steps must be a whole number"):
        instance("dictator", steps=0)
    with pytest.raises(ValueError, match="charges no handovers"):
        instance("dictator", cost=0.5)
