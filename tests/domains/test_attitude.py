"""Attitude: the problem is the constellation's, the slews are those of the geometry."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import bound, solve
from sapopt.domains.attitude import Attitude
from sapopt.domains.constellation import WalkerShell, random_tasks, walker_constellation
from sapopt.domains.instances import instance, scenario
from sapopt.dynamics.paths.oracles import LocalOracle
from sapopt.solvers import HAA, HAAL, DualLookahead


def small(steps: int = 6) -> Attitude:
    return Attitude(
        walker_constellation(WalkerShell(4, 6, 58.0, 1200.0), random_tasks(30, 3), steps, step_s=120.0)
    )


def test_idle_tasks_and_benefits() -> None:
    attitude = small()
    problem = attitude.problem()
    assert (problem.n, problem.m) == (24, 54)
    np.testing.assert_array_equal(
        problem.benefits.dense()[:, :, :30], attitude.constellation.benefits.dense()
    )
    assert not problem.benefits.dense()[:, :, 30:].any()


def test_slews_of_a_plan() -> None:
    """What the plan pays is its slews; an angle is worked out here from three points."""
    attitude = small()
    plan = solve(attitude.problem(), HAA()).plan
    slews = attitude.slews_deg(plan)
    expensive = attitude.problem(cost=2.0).evaluate(plan)
    np.testing.assert_allclose(expensive.handover, -2.0 * np.radians(slews).sum(axis=1))
    seen = attitude.constellation.benefits.dense() > 0
    moves = [
        (k, i)
        for k in range(1, len(plan))
        for i in range(plan.shape[1])
        if max(plan[k, i], plan[k - 1, i]) < 30
        and seen[k, i, plan[k, i]]
        and seen[k - 1, i, plan[k - 1, i]]
        and plan[k, i] != plan[k - 1, i]
    ]
    assert moves
    for k, i in moves[:5]:
        here = attitude.constellation.positions_km[k, i]
        a, b = (attitude.targets_km[j] - here for j in (plan[k - 1, i], plan[k, i]))
        cosine = a @ b / np.sqrt((a @ a) * (b @ b))
        assert slews[k, i] == pytest.approx(np.degrees(np.arccos(cosine)))


def test_gap_and_plain_recursion() -> None:
    """The dual lookahead is within 0.1 % of the bound, and the plain recursion confirms the prices."""
    problem = small().problem()
    proven = bound(problem)
    values = [solve(problem, solver).value for solver in (HAA(), HAAL(3), DualLookahead(6))]
    assert max(values) <= proven.value
    assert values[2] >= 0.999 * proven.value
    assert proven.prices is not None
    plain = LocalOracle(
        problem.benefits, problem.model.local_model(problem.benefits, problem.initial_state())
    )
    value = plain.best_paths(proven.prices)[0].sum() + proven.prices.sum()
    assert value == pytest.approx(proven.value)


def test_instance() -> None:
    problem = instance("attitude", seed=1, steps=2, tasks=20, planes=2, per_plane=4)
    assert (problem.T, problem.n, problem.m) == (2, 8, 28)
    assert repr(problem.dynamics) == "SlewCost(cost=0.5 per radian)"
    assert instance("attitude", steps=2, cost=1.5, tasks=20, planes=2, per_plane=4).dynamics.cost == 1.5


def test_draw() -> None:
    from matplotlib.figure import Figure

    attitude = scenario("attitude", steps=4, tasks=40, planes=4, per_plane=6, altitude_km=1200.0)
    plan = solve(attitude.problem(), HAA()).plan
    ax = attitude.draw(plan, Figure().subplots())
    assert "slews" in ax.get_title(loc="left")
    assert len(ax.lines[0].get_xdata()) == (attitude.slews_deg(plan) > 0).sum()
