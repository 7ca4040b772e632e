"""The band of the value against handovers holds the best value of every number of them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from experiments import pareto
from sapopt import SAP


@pytest.mark.parametrize("seed", range(3))
def test_the_band_holds_the_curve(seed: int) -> None:
    """Against all plans of a tiny problem, also between the numbers of handovers that were tried."""
    rng = np.random.default_rng(seed)
    base = SAP(rng.random((3, 2, 2)), 0.0)
    best = np.zeros(7)
    for flat in itertools.product(range(-1, 2), repeat=6):
        plan = np.array(flat).reshape(3, 2)
        if any(row[0] == row[1] >= 0 for row in plan):
            continue
        taken = int(((plan[1:] != plan[:-1]) & (plan[1:] >= 0)).sum())
        value = pareto.limited(base, None).evaluate(plan).value
        best[taken:] = np.maximum(best[taken:], value)
    points = [pareto.measured(base, most, 1.0, 0) for most in (0, 2, 4)]
    counts = np.arange(5, dtype=float)
    assert (pareto.lower(points, counts) <= best[:5] + 1e-9).all()
    assert (pareto.upper(points, counts) >= best[:5] - 1e-9).all()
    for point in points:
        assert point.value == pytest.approx(best[point.most])
        assert point.bound == pytest.approx(best[point.most])
