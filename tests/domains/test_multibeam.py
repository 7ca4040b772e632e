"""Satellites with beams: sizes, the way back, and what the solvers reach."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sapopt import SAP, bound, solve
from sapopt.domains.instances import find_instance, instance, scenario
from sapopt.domains.multibeam import multi_beam
from sapopt.solvers import HAAL, DualLookahead, Exact, NoHandover


def test_shape_of_the_instance() -> None:
    """The list of instances tells the true sizes."""
    assert instance("multi-beam", steps=2).benefits.shape[1:] == find_instance("multi-beam").shape[1:]


def test_the_real_satellite_decides() -> None:
    """Another beam of the same satellite takes over for free, another satellite's pays."""
    made = scenario("multi-beam", steps=2, tasks=40, beams=2).synthetic(0.5)
    plan = np.tile(np.arange(made.problem.n), (2, 1))
    assert made.problem.evaluate(plan).handover.tolist() == [0.0, 0.0]
    swapped = plan.copy()
    swapped[1, [0, 1]] = plan[0, [1, 0]]
    assert made.problem.evaluate(swapped).handover[1] == 0.0
    swapped[1] = plan[0]
    swapped[1, [1, 2]] = plan[0, [2, 1]]
    assert made.problem.evaluate(swapped).handover[1] == -1.0


def test_solvers_and_bound() -> None:
    """On a small one: no-handover < HAAL <= bound, and a plan made for identical beams is a plan of these beams."""
    made = multi_beam(1, steps=8, tasks=300, planes=3, per_plane=4, beams=4).synthetic(0.5)
    blind = solve(made.problem, NoHandover())
    haal = solve(made.problem, HAAL(3))
    alike, constant = made.alike(blind.plan)
    planned = made.problem.evaluate(made.tidied(solve(alike, DualLookahead(3)).plan))
    top = bound(alike, time_limit=1).value + constant
    assert blind.value < haal.value <= top
    assert blind.value < planned.value <= top
    assert made.problem.evaluate(made.tidied(haal.plan)).value >= haal.value


def test_brute_force() -> None:
    """On a tiny one the plans of the policies are below the optimum."""
    made = multi_beam(0, steps=2, tasks=4, planes=1, per_plane=2, beams=2, altitude_km=4000.0).synthetic(0.2)
    tiny = SAP(made.problem.benefits.dense()[:, :, :6], made.problem.dynamics)
    best = solve(tiny, Exact(method="dp")).value
    assert solve(tiny, HAAL(2)).value <= best + 1e-9


def test_files(tmp_path: Path) -> None:
    """The problem can be saved and loaded."""
    problem = instance("multi-beam", steps=2, tasks=30, beams=2)
    problem.save(tmp_path / "p.npz")
    assert SAP.load(tmp_path / "p.npz").fingerprint == problem.fingerprint


def test_bad_cost() -> None:
    """A matrix of costs is refused."""
    with pytest.raises(ValueError, match="cost: beams take one number"):
        scenario("multi-beam", steps=1, tasks=40, beams=1).problem(cost=np.zeros((40, 40)))
