"""Disturbed beams: who is a neighbour, and what knowing of them is worth."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import bound, solve
from sapopt.domains import constellation as c
from sapopt.domains.instances import find_instance, instance, scenario
from sapopt.domains.interference import DisturbedBeams
from sapopt.solvers import HAA, IteratedAssignment


def test_neighbours() -> None:
    """All pairs within reach, with a loss that falls linearly with the distance."""
    tasks = c.GroundTasks(np.array([0.0, 0.0, 0.0, 80.0]), np.array([0.0, 1.0, 179.0, 0.0]), np.ones(4))
    scene = c.walker_constellation(c.WalkerShell(2, 2, 58.0, 550.0), tasks, 1)
    pairs, loss = DisturbedBeams(scene, 222.64, 0.8).neighbours()
    assert pairs.tolist() == [[0, 1]]  # a degree is 111.3 km
    assert loss == pytest.approx([0.4], rel=1e-3)
    with pytest.raises(ValueError, match="reach_km must be a positive number"):
        DisturbedBeams(scene, 0.0)


def test_instance() -> None:
    """The list of instances tells the true sizes; knowing of the neighbours is worth something; the bound holds."""
    assert instance("interference", steps=1).benefits.shape[1:] == find_instance("interference").shape[1:]
    problem = scenario("interference", steps=6).problem(0.5)
    blind, aware = solve(problem, HAA()), solve(problem, IteratedAssignment())
    assert blind.value < aware.value <= bound(problem).value
