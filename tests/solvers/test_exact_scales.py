"""Exact methods at scales where absolute tolerances mean nothing."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from sapopt import SAP, SwitchingCost, solve
from sapopt.problem.result import Status
from sapopt.solvers.base import gap_unit
from sapopt.solvers.exact import Exact, branch_and_price, warm


@pytest.mark.parametrize("method", ["network", "milp", "qap"])
@pytest.mark.parametrize("scale", [1e-300, 1e-12, 1e-9, 1e12, 1e150])
def test_the_optimum_is_that_of_all_plans(method: str, scale: float) -> None:
    """What is called optimal is, also where every benefit is far below the tolerances of the solver, or far above."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        problem = SAP(scale * rng.random((3, 2, 3)), SwitchingCost(0.5 * scale))
        best = solve(problem, Exact("dp")).value
        result = solve(problem, Exact(method))
        assert result.value <= best * (1 + 1e-12)
        if result.status is Status.OPTIMAL:
            assert result.value == pytest.approx(best, rel=1e-9, abs=0.0)
        assert result.bound is not None
        assert result.bound >= best * (1 - 1e-12)


def test_what_counts_as_no_gap() -> None:
    """Ordinary benefits keep the tolerance of before; small ones bring their own."""
    assert gap_unit(SAP(np.full((1, 1, 1), 5.0))) == 1.0
    assert gap_unit(SAP(np.full((1, 1, 1), -1e-12))) == 1e-12
    assert gap_unit(SAP([[[0.0, -np.inf]]])) == 1.0


@pytest.mark.parametrize("scale", [1e-300, 1e-170, 1e-12, 1.0, 1e12, 1e150, 1e300])
@pytest.mark.parametrize("matrix", [False, True])
def test_branch_and_price_proves_at_any_scale(
    scale: float, matrix: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the prices end early, as on a busy machine, the search behind them still proves the optimum."""
    for module in (branch_and_price, warm):
        monkeypatch.setattr(module, "ascend", partial(ascend_shortly, ascend=module.ascend))
    for seed in range(4):
        rng = np.random.default_rng(seed)
        cost = scale * (1.0 - np.eye(5)) * rng.uniform(0.4, 0.6, (5, 5)) if matrix else 0.5 * scale
        problem = SAP(scale * rng.random((4, 4, 5)), SwitchingCost(cost))
        result = solve(problem, Exact("network"))
        assert result.status is Status.OPTIMAL
        best = solve(problem, Exact("dp")).value / scale
        assert result.value / scale == pytest.approx(best, rel=1e-9)
        assert result.bound is not None
        assert result.bound / scale == pytest.approx(best, rel=1e-6)


def ascend_shortly(*args: object, ascend: Callable[..., object], **options: object) -> object:
    """Prices after two steps."""
    return ascend(*args, **options | {"max_iterations": 2})
