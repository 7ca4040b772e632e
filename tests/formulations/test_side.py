"""The open cvxpy model: every rule of the problem is in it, side constraints bind, and bounds claim what they prove."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from limited_problems import LOCAL, feasible

from sapopt import SAP, InfeasibleError, Limit, SwitchingCost, Team, bound
from sapopt.dynamics import Interference
from sapopt.formulations.highs import SolverError
from sapopt.formulations.side import open_model
from sapopt.problem.result import Status


@pytest.mark.parametrize("kind", LOCAL)
def test_the_optimum_is_that_of_the_problem(kind: str) -> None:
    """Tiny problems with capacities, idleness, limits and teams, of every kind of dynamics, against all plans."""
    for made, best in feasible(11, kind, 5):
        answer = open_model(made.problem).solve()
        assert answer.result.value == pytest.approx(best, abs=1e-6)
        assert answer.result.status is Status.OPTIMAL
        assert answer.bound is not None
        assert answer.result.bound == answer.bound
        assert best <= answer.bound <= best + 1e-4 * max(1.0, abs(best))


def taken(plan: Any, initial: Any) -> list[int]:
    """Handovers of every step, counted from a plan."""
    rows = [list(row) for row in plan]
    before = [list(initial) if initial is not None else rows[0], *rows[:-1]]
    return [
        sum(a != b and b >= 0 for a, b in zip(*pair, strict=True)) for pair in zip(before, rows, strict=True)
    ]


@pytest.mark.parametrize("cost", [0.0, 0.3])
@pytest.mark.parametrize("initial", [None, [0, -1]])
def test_side_constraints_in_one_line(cost: float, initial: Any) -> None:
    """Handovers at most and at least, and a pair that is wanted, against the best of all plans that keep them."""
    rng = np.random.default_rng(3)
    problem = SAP(rng.random((3, 2, 3)), SwitchingCost(cost), initial, idle=True, limits=[Limit.once([0], 2)])
    model = open_model(problem)
    wishes: list[tuple[Any, Any]] = [
        (cp.sum(model.handover[1]) <= 0, lambda p: taken(p, initial)[1] <= 0),
        (sum(cp.sum(h) for h in model.handover) >= 4, lambda p: sum(taken(p, initial)) >= 4),
        ([model.x[2][0, 1] == 1, model.x[0][1, 2] == 0], lambda p: p[2][0] == 1 and p[0][1] != 2),
    ]
    from itertools import product

    rows = [row for row in product(range(-1, 3), repeat=2) if row[0] < 0 or row[0] != row[1]]
    for side, keeps in wishes:
        best = -np.inf
        for plan in product(rows, repeat=3):
            if keeps(plan):
                try:
                    best = max(best, problem.evaluate(plan).value)
                except ValueError:
                    continue
        answer = model.solve(side)
        assert answer.result.value == pytest.approx(best, abs=1e-6)
        assert keeps(answer.result.plan.tolist())
        # what is proven about the restricted model says nothing about the problem
        assert answer.result.bound is None
        assert answer.result.gap is None
        assert answer.result.status is Status.FEASIBLE
        assert answer.bound is not None
        assert answer.bound >= best
        assert answer.gap == pytest.approx(0.0, abs=1e-4)
        assert answer.bound <= bound(problem).value + 1e-5


def test_the_restricted_bound_is_no_bound_of_the_problem() -> None:
    """A plan of the problem may be worth more than the bound of a restricted model, so the result has none."""
    problem = SAP(np.arange(12.0).reshape(2, 2, 3), SwitchingCost(0.1))
    model = open_model(problem)
    free, bound_free = model.solve().result.value, model.solve([]).result.bound
    answer = model.solve([cp.sum(model.x[0][:, 2]) == 0])
    assert answer.bound is not None
    assert answer.bound < free <= (bound_free or 0.0)


def test_another_solver_and_the_programme() -> None:
    """The model is an ordinary programme: another solver gives the same value, and tells no bound."""
    problem = SAP(np.random.default_rng(0).random((3, 2, 3)), SwitchingCost(0.2), limits=[Team(0, 1, 0.25)])
    model = open_model(problem)
    with pytest.raises(ValueError, match="has no solution"):
        model.plan()
    ours = model.solve().result.value
    other = model.solve(solver="SCIPY")
    assert other.result.value == pytest.approx(ours, abs=1e-6)
    assert other.bound is None
    assert other.gap is None
    taken_away = model.programme(model.x[0][0, 0] == 1)
    assert {v.name() for v in taken_away.variables()} >= {"x_0", "x_1", "x_2", "handover_1", "handover_2"}


@pytest.mark.parametrize("scale", [1e-9, 1e12])
def test_scales(scale: float) -> None:
    """Benefits of any size are solved as well."""
    cube = np.random.default_rng(2).random((4, 3, 4))
    one = open_model(SAP(cube, 0.3)).solve().result.value
    answer = open_model(SAP(cube * scale, 0.3 * scale)).solve()
    assert answer.result.value == pytest.approx(one * scale, rel=1e-6)
    assert answer.gap is not None
    assert answer.gap < 1e-5


def test_what_cannot_be() -> None:
    """Contradictions, arguments of a wrong kind, and dynamics without paths are told."""
    model = open_model(SAP(np.ones((2, 2, 2))))
    with pytest.raises(InfeasibleError, match="no plan keeps all the side constraints"):
        model.solve([cp.sum(model.x[0]) <= 1])
    with pytest.raises(ValueError, match="entry 1 is 3, not a constraint of cvxpy"):
        model.solve([model.x[0] >= 0, 3])
    with pytest.raises(ValueError, match="time_limit must be a positive number"):
        model.solve(time_limit=0)
    with pytest.raises(ValueError, match="pass SCIPY the option"):
        model.solve(time_limit=1, solver="SCIPY")
    with pytest.raises(SolverError):
        model.solve([cp.sum_squares(model.x[0]) <= 1])
    with pytest.raises(ValueError, match="does not say that its state splits"):
        open_model(SAP(np.ones((1, 2, 2)), Interference([[0, 1]], 0.5)))


def test_handovers_are_whole() -> None:
    """Handover variables are 0 or 1 and say what the plan does, also where a handover costs nothing."""
    problem = SAP(np.random.default_rng(5).random((5, 3, 4)), SwitchingCost(0.0), idle=True)
    model = open_model(problem)
    plan = model.solve().result.plan
    for k, (before, now) in enumerate(pairwise(plan), start=1):
        wanted = np.zeros((3, 4))
        for i in range(3):
            if now[i] >= 0 and now[i] != before[i]:
                wanted[i, now[i]] = 1.0
        assert np.allclose(model.handover[k].value, wanted, atol=1e-6)
