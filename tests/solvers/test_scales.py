"""The scale of the benefits decides nothing: what is proven at 1 is proven at 1e-300 and at 1e300."""

from __future__ import annotations

import numpy as np
import pytest
from every_solver import EVERY, by_name, problem_for

from sapopt import SAP, Limit, SwitchingCost, bound, solve
from sapopt.solvers import HAA, DualDecomposition, Exact, Greedy, MyopicGreedy
from sapopt.solvers.names import NamedSolver

BENEFITS = np.random.default_rng(0).random((4, 3, 4)).round(2)
SCALES = [1e-300, 1e-170, 1e-12, 1e12, 1e150, 1e300]


@pytest.mark.parametrize("scale", SCALES)
def test_bounds_and_optima_scale(scale: float) -> None:
    """Bound, dual decomposition and every exact method give the optimum of the problem at scale 1, times the scale."""
    best = solve(SAP(BENEFITS, 0.25), Exact(method="dp")).value
    problem = SAP(BENEFITS * scale, 0.25 * scale)
    assert bound(problem).value / scale == pytest.approx(best, rel=1e-4)
    for solver in (
        DualDecomposition(300, 2, 5),
        *(Exact(method=m) for m in ("dp", "network", "milp", "qap")),
    ):
        result = solve(problem, solver)
        assert result.value / scale == pytest.approx(best, rel=1e-9)
        assert result.bound is not None
        assert result.bound >= result.value * (1 - 1e-12)


@pytest.mark.parametrize("named", EVERY, ids=by_name)
@pytest.mark.parametrize("scale", [1e-300, 1e300])
def test_every_solver_takes_any_scale(named: NamedSolver, scale: float) -> None:
    """No method meets a number that it cannot hold, with a time limit as without."""
    result = solve(problem_for(named, BENEFITS * scale, 0.25 * scale), named.solver, time_limit=60)
    assert 0.5 < result.value / scale < 12.0


@pytest.mark.parametrize("scale", [2.0**-900, 2.0**-40, 2.0**60])
@pytest.mark.parametrize("solver", [HAA(), Greedy(), MyopicGreedy()], ids=lambda solver: solver.name)
def test_steps_within_limits_scale(solver: HAA | Greedy | MyopicGreedy, scale: float) -> None:
    """Hard limits and penalties weigh the same at any scale: a power of two changes no assignment."""
    for seed in range(6):
        benefits = np.random.default_rng(seed).random((4, 3, 5))
        for dear in (False, True):

            def scaled(factor: float, benefits: np.ndarray = benefits, dear: bool = dear) -> SAP:
                some = Limit.cover([0, 1], 1, penalty=0.3 * factor) if dear else Limit.work([0, 1], at_most=2)
                limits = [some, Limit.once([0, 1, 2])]
                return SAP(benefits * factor, SwitchingCost(0.2 * factor), idle=True, limits=limits)

            assert np.array_equal(solve(scaled(scale), solver).plan, solve(scaled(1.0), solver).plan)
