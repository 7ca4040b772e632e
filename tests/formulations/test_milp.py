"""The MILP is an ordinary cvxpy problem whose points are plans."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from local_dynamics import Dictator, Tiring

from sapopt import SAP, SwitchingCost, solve
from sapopt.formulations import milp, relaxation
from sapopt.formulations.dual import ascend
from sapopt.solvers.exact import Exact


def test_taken_away_and_solved() -> None:
    """A user solves the compiled problem with a solver of their own and recovers the plan."""
    problem = SAP(np.random.default_rng(0).random((4, 3, 4)), SwitchingCost(0.3), [2, 0, 1])
    compiled = milp.formulate(problem)
    assert isinstance(compiled.problem, cp.Problem)
    with pytest.raises(ValueError, match="no solution"):
        milp.recover(compiled)
    compiled.problem.solve(solver=cp.SCIPY)
    plan = milp.recover(compiled)
    assert problem.evaluate(plan).value == pytest.approx(compiled.problem.value, abs=1e-6)
    assert compiled.problem.value == pytest.approx(solve(problem, Exact("dp")).value, abs=1e-6)


def test_objective_of_a_given_plan() -> None:
    """With the assignments fixed to a plan, the objective is the value of the plan, for every kind of dynamics."""
    rng = np.random.default_rng(1)
    cost = rng.random((3, 3)) * (1 - np.eye(3))
    for dynamics in (
        SwitchingCost(0.4),
        SwitchingCost(0.4, idle_is_free=True),
        SwitchingCost(cost),
        Tiring(0.5),
    ):
        benefits = rng.random((3, 2, 3)) * (rng.random((3, 2, 3)) < 0.7)
        problem = SAP(benefits, dynamics)
        for _ in range(3):
            plan = np.array([rng.permutation(3)[:2] for _ in range(3)])
            compiled = milp.formulate(problem, relaxed=True)
            fixed = [x == np.eye(3)[row] for x, row in zip(compiled.x, plan, strict=True)]
            pinned = cp.Problem(compiled.problem.objective, [*compiled.problem.constraints, *fixed])
            pinned.solve(solver=cp.HIGHS)
            assert pinned.value == pytest.approx(problem.evaluate(plan).value, abs=1e-6)


def test_linear_bound_is_the_lagrangian_bound() -> None:
    """Clarabel's linear relaxation meets the dual ascent from above and below."""
    problem = SAP(np.random.default_rng(4).random((5, 4, 5)), SwitchingCost(0.5))
    oracle = problem.model.path_oracle(problem.benefits, None)
    assert relaxation.linear_bound(problem).value == pytest.approx(
        ascend(oracle, max_iterations=1500).bound, rel=2e-4
    )


def test_global_dynamics_is_refused() -> None:
    """A global state cannot be written as a MILP of this kind."""
    with pytest.raises(ValueError, match="Dictator"):
        milp.formulate(SAP(np.ones((2, 2, 3)), Dictator()))
