"""The scale of the benefits decides nothing: what is proven at 1 is proven at 1e-300 and at 1e300."""

from __future__ import annotations

import numpy as np
import pytest
from every_solver import EVERY, by_name, problem_for

from sapopt import SAP, bound, solve
from sapopt.solvers import DualDecomposition, Exact
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
