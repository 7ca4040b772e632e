"""The typical size of numbers, at every scale that floats hold."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import SAP, SwitchingCost, bound
from sapopt.data.types import root_mean_square


@pytest.mark.parametrize("scale", [1e-300, 1e-170, 1.0, 1e170, 1e300])
def test_root_mean_square(scale: float) -> None:
    """It scales with the values, where their squares are no numbers any more."""
    assert root_mean_square(scale * np.array([3.0, -4.0, -np.inf, np.nan])) == pytest.approx(
        scale * np.sqrt(12.5)
    )


def test_nothing_to_measure() -> None:
    """No finite values, or zeros only: 1, since it is divided by."""
    for values in ([], [0.0, 0.0], [-np.inf]):
        assert root_mean_square(np.array(values)) == 1.0


@pytest.mark.parametrize("scale", [1e-300, 1e-170, 1e150])
def test_a_bound_with_a_time_limit(scale: float) -> None:
    """It was a ZeroDivisionError: the clock plans by the temperature in parts of the size."""
    problem = SAP(scale * np.random.default_rng(0).random((3, 1, 4)), SwitchingCost(0.0))
    best = sum(step.max() for step in problem.benefits.dense())
    assert bound(problem, time_limit=5.0).value >= best
