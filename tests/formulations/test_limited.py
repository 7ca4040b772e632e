"""The dual of capacities, limits and teams, against the linear programme whose value it approaches."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import SAP, Limit, SwitchingCost, Team, bound
from sapopt.formulations.highs import maximise
from sapopt.formulations.limited.graph import path_graph
from sapopt.formulations.limited.programme import limited_programme


@pytest.mark.parametrize("seed", range(4))
def test_the_dual_reaches_the_linear_programme(seed: int) -> None:
    """The bound is never below the relaxation, and close to it: the ascent does not stop where it begins."""
    rng = np.random.default_rng(seed)
    limits = [
        Limit.handovers(2, each=True), Limit.cover([0], 1, penalty=0.5), Limit.work(at_least=2, penalty=0.3),
        Team(2, 2, 0.8),
    ]  # fmt: skip
    problem = SAP(
        rng.random((8, 4, 5)),
        SwitchingCost(0.2),
        capacity=[1, 1, 2, 2, 1],
        idle=bool(seed % 2),
        limits=limits,
    )
    relaxed = maximise(limited_programme(path_graph(problem.core)).programme, relaxed=True).value
    proven = bound(problem).value
    assert relaxed - 1e-7 <= proven <= relaxed + 0.01 * abs(relaxed)
