"""Tracking: the hexagons, the objects, eq. 4.3 by hand, the forecast, and the share that is tracked."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from sapopt import SAP, bound, solve
from sapopt.domains.constellation import WalkerShell
from sapopt.domains.instances import find_instance, instance, scenario
from sapopt.domains.tracking import Tracking, moving_objects, tracking, tracking_thesis, us_regions
from sapopt.solvers import HAAL, DualLookahead, NoHandover

SHELL = WalkerShell(8, 10, inclination_deg=58.0, altitude_km=550.0)
SIZES = {"steps": 10, "shell": SHELL, "resolution": 2, "arrivals_per_step": 0.4}
SMALL = tracking(3, **SIZES)
LETTER = tracking_thesis(3, **SIZES)


def test_regions() -> None:
    """633 hexagons of resolution 3; a centre lies in its own region, the ocean in none."""
    regions = us_regions()
    assert len(regions) == 633
    np.testing.assert_array_equal(
        regions.containing(regions.latitude_deg, regions.longitude_deg), np.arange(633)
    )
    assert regions.containing([0.0, 45.0], [-30.0, 5.0]).tolist() == [-1, -1]
    assert len(us_regions(2)) == 90
    with pytest.raises(ValueError, match="resolution"):
        us_regions(0)


def test_without_h3(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the extra the error says what to install."""
    monkeypatch.setitem(sys.modules, "h3", None)
    with pytest.raises(ImportError, match=r"sapopt\[space\]"):
        us_regions()


def test_objects() -> None:
    """They stay where the hexagons are, move at their speed, and come back under the same seed."""
    regions = us_regions(2)
    one, two, other = (moving_objects(regions, 30, seed, arrivals_per_step=2.0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.region, two.region)
    assert one.region.shape != other.region.shape or (one.region != other.region).any()
    there = one.region >= 0
    assert (np.isfinite(one.latitude_deg) == there).all()
    both = there[1:] & there[:-1]
    north = np.diff(one.latitude_deg, axis=0) * 111.19
    east = np.diff(one.longitude_deg, axis=0) * 111.19 * np.cos(np.radians(one.latitude_deg[:-1]))
    way = np.hypot(north, east)
    np.testing.assert_allclose(way[both], np.broadcast_to(one.speed_km_per_step, way.shape)[both], rtol=2e-2)
    assert one.counts(90).sum() == there.sum()
    for k in range(29):  # what is gone does not come back
        assert not (there[: k + 1].any(axis=0) & ~there[k] & there[k + 1]).any()


def test_forecast_knows_the_present_only() -> None:
    """Step k itself is true; newcomers of later steps are not in it."""
    problem, forecast = SMALL.problem(), SMALL.forecast(3)
    for k in (0, 4, 9):
        seen = forecast(k, 10 - k)
        assert seen.shape == (min(3, 10 - k), problem.n, problem.m)
        assert (abs(seen.step(0) - problem.benefits.step(k))).max() < 1e-12
    predicted = SMALL.objects.predicted(0, 10, SMALL.regions)
    assert (predicted.sum(axis=1) <= predicted[0].sum()).all()
    for solver in (HAAL(2), HAAL(3)):
        assert solve(problem, solver, forecast=forecast).value <= bound(problem, time_limit=2).value


def worth(scene: Tracking, regions: np.ndarray) -> float:
    """Value of an original plan by eq. 4.3, in plain loops."""
    total = 0.0
    counts = scene.objects.counts(len(scene.regions))
    for k in range(1, len(regions)):
        near, before = (scene.satellites.benefits.step(q).toarray() for q in (k, k - 1))
        for j in range(len(scene.regions)):
            earned = [
                scene.scale * near[i, j] * (counts[k, j] + scene.watch)
                for i in np.flatnonzero(regions[k] == j)
                if regions[k - 1, i] == j and (before[i, j] > 0 or not scene.needs_sight)
            ]
            total += sum(b * scene.decay**r for r, b in enumerate(sorted(earned, reverse=True)))
    return total


@pytest.mark.parametrize("scene", [SMALL, LETTER], ids=["sight", "letter"])
def test_value_is_that_of_the_equation(scene: Tracking) -> None:
    """Only what was held before earns, the second observer a fifth; nothing earns at the first step."""
    made = scene.synthetic()
    for solver in (NoHandover(), HAAL(3), DualLookahead(3)):
        result = solve(made.problem, solver, forecast=scene.forecast())
        regions = made.original(result.plan)
        assert made.evaluate(regions).value == pytest.approx(worth(scene, regions))
        assert made.evaluate(regions).value >= result.value - 1e-9


def test_lookahead_tracks_more() -> None:
    """HAAL tracks more than assignments that are blind to acquisition, and less than all that is in view."""
    problem, forecast = SMALL.problem(), SMALL.forecast()
    blind, haal = (solve(problem, solver, forecast=forecast) for solver in (NoHandover(), HAAL(3)))
    assert blind.value < haal.value
    assert 0 < SMALL.tracked(blind.plan) < SMALL.tracked(haal.plan) <= SMALL.coverable() <= 1


def test_the_numbers_of_the_thesis() -> None:
    """beta^e = 1 and beta^t = 10 at proximity 1; what was held unseen earns; targets go by the compass."""
    counts = LETTER.objects.counts(len(LETTER.regions))
    near = LETTER.satellites.benefits.step(4).tocoo()
    worth_now = LETTER.synthetic().base.benefits.step(4).tocsr()
    for i, j, proximity in zip(near.row, near.col, near.data, strict=True):
        assert worth_now[i, j] == pytest.approx(proximity * (1.0 + 10.0 * counts[4, j]))
    headings = LETTER.objects.heading_deg
    assert set(headings[np.isfinite(headings)]) <= {0.0, 90.0, 180.0, 270.0}


def test_two_readings_of_tracked() -> None:
    """Whoever held the region before: at least as much as by the same satellite, at most what is in view."""
    plan = solve(LETTER.problem(), HAAL(2), forecast=LETTER.forecast()).plan
    assert 0 < LETTER.tracked(plan) <= LETTER.tracked(plan, by="any") <= 1
    with pytest.raises(ValueError, match="by must be"):
        LETTER.tracked(plan, by="all")  # type: ignore[arg-type]


def test_instance(tmp_path: Path) -> None:
    """The list of instances tells the true sizes; the problem goes through a file."""
    problem = instance("tracking", steps=2)
    assert problem.m == 2 * 633 + problem.n
    flat = scenario("tracking").satellites
    assert (flat.T, flat.n, 2 * flat.m + flat.n) == find_instance("tracking").shape
    problem.save(tmp_path / "p.npz")
    assert SAP.load(tmp_path / "p.npz").fingerprint == problem.fingerprint
    with pytest.raises(ValueError, match="cost: tracking charges"):
        instance("tracking", steps=2, cost=0.5)
