"""The dictator's problem: the numbers of section 6.1, by exact dynamic programming and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import Status, solve
from sapopt.domains.dictator import LEADS_TO, VALUES
from sapopt.domains.instances import instance
from sapopt.solvers import HAA, HAAL, AssignmentPolicy, Exact
from sapopt.solvers.exact.dp import assignments
from sapopt.solvers.policy import myopic


def test_optimum_over_ten_steps() -> None:
    """Dynamic programming finds 63 and proves it: (1, 2, 3) nine times, and (2, 3, 1), the bait, at the last step."""
    result = solve(instance("dictator"), Exact(method="dp"))
    assert result.status is Status.OPTIMAL
    assert result.value == pytest.approx(63.0)
    assert result.bound == pytest.approx(63.0)
    assert result.plan.tolist() == [[0, 1, 2]] * 9 + [[1, 2, 0]]


def test_the_best_constant_plan_is_that_of_the_thesis() -> None:
    """Holding (1, 2, 3) earns 60, and no other constant assignment more; greed's (2, 3, 1) earns 37.8."""
    problem = instance("dictator")
    values = {tuple(row.tolist()): problem.evaluate(np.tile(row, (10, 1))).value for row in assignments(3, 3)}
    assert values[0, 1, 2] == pytest.approx(60.0)
    assert values[1, 2, 0] == pytest.approx(37.8)
    assert max(values, key=lambda row: values[row]) == (0, 1, 2)


def test_greed_takes_the_bait() -> None:
    """alpha(beta_hat), HAA and HAAL with any window settle at (2, 3, 1): 37.8."""
    problem = instance("dictator")
    for solver in (AssignmentPolicy(myopic), HAA(), HAAL(3), HAAL(10)):
        result = solve(problem, solver)
        assert result.value == pytest.approx(37.8)
        assert result.plan.tolist() == [[1, 2, 0]] * 10


def test_comas_policy_with_shared_tasks() -> None:
    """(1, 3, 1), on which the thesis' COMA settles, earns 55 where the two holders of task 1 share it."""
    pytest.importorskip("torch")
    from sapopt.learning import Environment

    env = Environment(instance("dictator"), conflicts_shared=True)
    total = sum(env.step(np.array([0, 2, 0])).sum() for _ in range(10))
    assert total == pytest.approx(55.0)


def test_table_of_the_docstring() -> None:
    """Best value of a step in every state, by the dictator's task; that task is the next state."""
    best = np.full((3, 3), -np.inf)
    for row in assignments(3, 3):
        worth = VALUES[:, np.arange(3), row].sum(axis=1)
        best[:, row[0]] = np.maximum(best[:, row[0]], worth)
    np.testing.assert_allclose(best, [[6, 9, 5], [0.1, 3.2, 0.1], [0.1, 0.1, 3.2]])
    assert (np.arange(3) == LEADS_TO).all()


def test_steps_and_costs() -> None:
    """Any number of steps; a cost is refused."""
    assert instance("dictator", steps=4).T == 4
    with pytest.raises(ValueError, match="steps must be a whole number"):
        instance("dictator", steps=0)
    with pytest.raises(ValueError, match="charges no handovers"):
        instance("dictator", cost=0.5)
