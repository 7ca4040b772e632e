"""Prices and multipliers of limits on take-ups, found together, against the linear programme that they approach."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sapopt import SAP, Limit, SwitchingCost
from sapopt.formulations.highs import maximise
from sapopt.formulations.limited.building import path_graph
from sapopt.formulations.limited.folded_dual import FoldedPaths
from sapopt.formulations.limited.joint_descent import descend
from sapopt.formulations.limited.programme import limited_programme
from sapopt.kernels import clock
from tests.folded_problems import plain


def drawn(seed: int) -> SAP:
    """Agents that would gladly take up more tasks than they may."""
    rng = np.random.default_rng(seed)
    benefits = rng.random((12, 5, 8)) * (rng.random((12, 5, 8)) < 0.4)
    who = None if seed % 2 else [0, 2, 3]
    return SAP(benefits, SwitchingCost(0.1), limits=[Limit.handovers(3, who, each=True)])


@pytest.mark.parametrize("seed", range(4))
def test_it_reaches_the_linear_programme(seed: int) -> None:
    """The bound is never below the relaxation, and close to it; only agents with a limit pay more for a move."""
    problem = drawn(seed)
    relaxed = maximise(limited_programme(path_graph(problem.core, tight=False)).programme, relaxed=True).value
    here = plain(problem)
    dual = descend(here, FoldedPaths(here), math.inf)
    assert relaxed - 1e-7 <= dual.bound <= relaxed + 0.005 * abs(relaxed)
    assert (dual.dearer[here.row < 0] == 0).all()
    assert (dual.dearer > 0).any()


def test_it_ends_when_it_is_told_to() -> None:
    """At a time that is over, and by a word, there is a bound all the same."""
    here = plain(drawn(0))
    paths = FoldedPaths(here)
    seen: list[float] = []

    def enough(steps: int, bound: float) -> bool:
        seen.append(bound)
        return steps >= 15

    over = descend(here, paths, clock.now() - 1.0)
    told = descend(here, paths, math.inf, enough)
    whole = descend(here, paths, math.inf)
    assert whole.bound < told.bound < over.bound < math.inf
    assert seen == sorted(seen, reverse=True)
    assert told.bound == seen[-1]
