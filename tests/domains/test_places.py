"""Places from tables and GeoJSON with their names, and constellations that keep their date."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
import pytest

from sapopt import Limit
from sapopt.domains.constellation import (
    GroundTasks,
    WalkerShell,
    constellation,
    element_constellation,
    random_tasks,
    starlink_elements,
    walker_constellation,
    walker_positions_km,
)
from sapopt.domains.instances import scenario

WANTED = {"opens": ["2026-03-01T12:00Z", ""], "closes": ["2026-03-01T13:02+01:00", None]}
NOON = datetime(2026, 3, 1, 12, tzinfo=UTC)
SITES = {"site": ["Kiruna", "Ålesund"], "lat": [67.9, 62.5], "lon": [20.2, 6.2], "weight": [2, 1]}
SHELL = WalkerShell(2, 3, 60.0, 1200.0)


def collection(**change: Any) -> dict[str, Any]:
    """The same places as GeoJSON."""
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [SITES["lon"][i], SITES["lat"][i], 300]},
            "properties": {"name": SITES["site"][i], "priority": SITES["weight"][i]},
        }
        for i in range(2)
    ]
    features[1] |= change
    return {"type": "FeatureCollection", "features": features}


def test_tables_and_geojson_agree(tmp_path: Path) -> None:
    """A frame, a CSV and GeoJSON give the same tasks, names among them, which the problem and its idle tasks bear."""
    pd.DataFrame(SITES).to_csv(tmp_path / "sites.csv", index=False)
    (tmp_path / "sites.geojson").write_text(json.dumps(collection()), encoding="utf-8")
    columns = {"latitude": "lat", "longitude": "lon", "priority": "weight", "name": "site"}
    made = [
        GroundTasks.from_table(pd.DataFrame(SITES), **columns),
        GroundTasks.from_table(tmp_path / "sites.csv", **columns),
        GroundTasks.from_geojson(tmp_path / "sites.geojson"),
        GroundTasks.from_geojson(collection()),
    ]
    for tasks in made:
        assert tasks.names == ("Kiruna", "Ålesund")
        assert tasks.latitude_deg.tolist() == SITES["lat"]
        assert tasks.longitude_deg.tolist() == SITES["lon"]
        assert tasks.priority.tolist() == SITES["weight"]
    problem = walker_constellation(SHELL, made[0].with_idle_tasks(4), 3).problem()
    assert problem.tasks == ("Kiruna", "Ålesund", "idle 0", "idle 1", "idle 2", "idle 3")
    bare = GroundTasks.from_table(SITES, latitude="lat", longitude="lon")
    assert bare.names == ()
    assert bare.priority.tolist() == [1.0, 1.0]


def test_features_without_names_have_their_id_or_number() -> None:
    """A feature bears its name, else its id, else its number."""
    told = collection(properties=None, id="N7")
    told["features"].append({"type": "Feature", "geometry": {"type": "Point", "coordinates": [0, 0]}})
    tasks = GroundTasks.from_geojson(told)
    assert tasks.names == ("Kiruna", "N7", "2")
    assert tasks.priority.tolist() == [2.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"type": "Polygon"}, "a FeatureCollection of points is needed, this is Polygon"),
        ({"type": "FeatureCollection", "features": []}, "at least one task"),
        (collection(geometry=None), r"feature 1 \(counted from 0\) has no geometry"),
        (
            collection(geometry={"type": "Polygon", "coordinates": []}),
            "feature 1 .* is a Polygon; only points",
        ),
        (collection(geometry={"type": "Point", "coordinates": ["x", 1]}), "no longitude and latitude"),
        (collection(geometry={"type": "Point", "coordinates": [1, 100]}), "latitude and longitude exchanged"),
        (collection(properties={"priority": "high"}), "priority is 'high', no number"),
    ],
)
def test_bad_geojson(told: Any, words: str) -> None:
    """What is no point, or no number, is told with the feature."""
    with pytest.raises(ValueError, match=words):
        GroundTasks.from_geojson(told)


def test_bad_places(tmp_path: Path) -> None:
    """A file that is no JSON, a missing column, a missing value, and a wrong number of names are told."""
    (tmp_path / "x.geojson").write_text("{")
    with pytest.raises(ValueError, match=r"x\.geojson: not JSON"):
        GroundTasks.from_geojson(tmp_path / "x.geojson")
    with pytest.raises(ValueError, match="there is no column 'latitude_deg'"):
        GroundTasks.from_table(SITES)
    with pytest.raises(ValueError, match=r"lat: row 1 \(counted from 0\) has no finite value"):
        GroundTasks.from_table({**SITES, "lat": [1.0, None]}, latitude="lat", longitude="lon")
    with pytest.raises(ValueError, match="names must be one for each of 2 tasks"):
        GroundTasks([0.0, 1.0], [0.0, 1.0], [1.0, 1.0], ("a",))  # type: ignore[arg-type]


def test_a_constellation_keeps_its_date() -> None:
    """The date goes on to the problem, in its zone, through the hour that the clocks show twice; without one, none."""
    zone = ZoneInfo("Europe/Oslo")
    start = datetime(2026, 10, 25, 0, 30, tzinfo=UTC).astimezone(zone)
    built = walker_constellation(SHELL, random_tasks(6, 0), 4, 1800.0, start=start)
    problem = built.only_seeing().with_idle_tasks().problem()
    assert problem.times is not None
    assert [time.isoformat()[11:] for time in problem.times] == [  # type: ignore[union-attr]
        "02:30:00+02:00", "02:00:00+01:00", "02:30:00+01:00", "03:00:00+01:00",
    ]  # fmt: skip
    naive = walker_constellation(SHELL, random_tasks(6, 0), 2, start=datetime(2026, 1, 1))
    assert naive.times == (datetime(2026, 1, 1, tzinfo=UTC), datetime(2026, 1, 1, 0, 1, tzinfo=UTC))
    assert walker_constellation(SHELL, random_tasks(6, 0), 2).problem().times is None
    with pytest.raises(ValueError, match="start must be a datetime"):
        walker_constellation(SHELL, random_tasks(6, 0), 2, start="2026-01-01")  # type: ignore[arg-type]


def test_real_satellites_start_at_their_epoch() -> None:
    """Element sets bring their own date, and another start is kept instead."""
    elements = starlink_elements().take(range(3))
    built = element_constellation(elements, random_tasks(3, 0), 2)
    assert built.start == elements.latest_epoch
    later = elements.latest_epoch + timedelta(hours=1)
    moved = element_constellation(elements, random_tasks(3, 0), 2, start=later)
    assert moved.times == (later, later + timedelta(seconds=60))
    assert not np.array_equal(moved.positions_km, built.positions_km)


def test_new_constellations_turn_with_the_earth() -> None:
    """Without a word the Earth turns; the instances of the thesis keep theirs still."""
    built = walker_constellation(SHELL, random_tasks(6, 0), 3)
    turning = walker_constellation(SHELL, random_tasks(6, 0), 3, earth="rotating")
    still = walker_constellation(SHELL, random_tasks(6, 0), 3, earth="still")
    assert np.array_equal(built.positions_km, turning.positions_km)
    assert not np.array_equal(built.positions_km, still.positions_km)
    toy = scenario("constellation-toy", steps=3)
    own = walker_constellation(WalkerShell(4, 6, 58.0, 1200.0), random_tasks(30, 0), 3, 120.0, earth="still")
    assert np.array_equal(toy.positions_km, own.positions_km)


def test_what_is_never_seen_is_told(caplog: pytest.LogCaptureFixture) -> None:
    """A place that no satellite can see is named in a warning and in the second line; idle tasks are not."""
    places = GroundTasks(
        np.array([0.0, 89.0]), np.array([0.0, 0.0]), np.array([1.0, 1.0]), ("equator", "pole")
    )
    shell = WalkerShell(3, 8, 10.0, 550.0)
    lost = walker_constellation(shell, places.with_idle_tasks(3), 93, start=datetime(2026, 1, 1))
    assert "no satellite ever sees 1 of 2 tasks, such as 'pole' (89.0, 0.0 degrees)" in caplog.text
    first, second = str(lost).splitlines()
    assert first == "24 satellites, 2 tasks, 93 steps of 60 s from 2026-01-01T00:00:00+00:00"
    assert second.endswith("never seen: 1, such as 'pole' (89.0, 0.0 degrees)")
    assert repr(lost) == "Constellation(T=93, n=24, m=5, step_s=60)"
    caplog.clear()
    scattered = walker_constellation(shell, random_tasks(30, 0, max_latitude_deg=90.0).with_idle_tasks(3), 93)
    assert "never seen" in str(scattered)
    assert caplog.text == ""
    every = walker_constellation(shell, GroundTasks(np.zeros(1), np.zeros(1), np.ones(1)), 93)
    assert caplog.text == ""
    assert str(every).endswith("every task is seen at some step")


def always_seen(tasks: GroundTasks, start: datetime | None = NOON, steps: int = 5) -> Any:
    """Two satellites that hang above Scandinavia, by steps of a minute."""
    above = 8000.0 * np.array([[0.40, 0.12, 0.91], [0.45, 0.06, 0.89]])
    return constellation(np.tile(above, (steps, 1, 1)), tasks, 60.0, start=start)


def test_windows(tmp_path: Path) -> None:
    """A task is worth something from the step that begins at its opening to the last that begins before its end."""
    columns = {"latitude": "lat", "longitude": "lon", "priority": "weight", "name": "site"}
    pd.DataFrame(SITES | WANTED).to_csv(tmp_path / "sites.csv", index=False)
    open_always = always_seen(GroundTasks.from_table(SITES, **columns))
    assert (open_always.benefits.dense() > 0).all()
    for table in (SITES | WANTED, tmp_path / "sites.csv"):
        tasks = GroundTasks.from_table(table, **columns, opens="opens", closes="closes").with_idle_tasks(1)
        assert tasks.windows[0] == (NOON, NOON + timedelta(minutes=2))
        assert tasks.windows[1:] == ((None, None), (None, None))
        wanted = np.zeros((5, 2, 3))
        wanted[..., :2] = open_always.benefits.dense()
        wanted[2:, :, 0] = 0.0
        np.testing.assert_array_equal(always_seen(tasks).benefits.dense(), wanted)
        early = always_seen(tasks, NOON - timedelta(seconds=90))
        assert (early.benefits.dense()[:, 0, 0] > 0).tolist() == [False, False, True, True, False]
        with pytest.raises(ValueError, match="start: the tasks have time windows"):
            always_seen(tasks, None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"closes": ["2026-03-01T11:00Z", ""]}, r"closes: row 0 \(counted from 0\) ends before it begins"),
        ({"closes": ["soon", ""]}, r"closes: row 0 \(counted from 0\): .*soon"),
        ({"closes": [3, 4]}, "3 is no date and time"),
    ],
)
def test_bad_windows(change: dict[str, Any], message: str) -> None:
    """A window that ends before it begins, or is no time, is refused with its row."""
    with pytest.raises(ValueError, match=message):
        GroundTasks.from_table(
            SITES | WANTED | change, latitude="lat", longitude="lon", opens="opens", closes="closes"
        )
    with pytest.raises(ValueError, match="windows must be one pair of times for each of 2 tasks"):
        GroundTasks([1.0, 2.0], [1.0, 2.0], [1.0, 1.0], (), ((NOON, None),))  # type: ignore[arg-type]


def test_idle_capacity_and_limits() -> None:
    """They reach the problem; with `only_seen` nothing is held that is not seen."""
    base = always_seen(
        GroundTasks.from_table(SITES | WANTED, latitude="lat", longitude="lon", closes="closes")
    )
    problem = base.problem(0.1, idle=True, only_seen=True, capacity=2, limits=[Limit.once([0], 1)])
    assert problem.idle
    assert len(problem.limits) == 1
    assert np.isneginf(problem.benefits.dense()[2:, :, 0]).all()
    assert np.isfinite(problem.benefits.dense()[:2]).all()
    with pytest.raises(ValueError, match="pass idle=True"):
        base.problem(0.1, only_seen=True)


def test_the_date_turns_the_earth() -> None:
    """With a date and no angle, the Earth stands at the first step as Greenwich sidereal time has it, still or not."""
    tasks = GroundTasks.from_table(SITES, latitude="lat", longitude="lon")
    angle = 280.46061837 + 360.98564736629 * (
        (NOON - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1)
    )
    for earth in ("rotating", "still"):
        dated = walker_constellation(SHELL, tasks, 2, start=NOON, start_s=300.0, earth=earth)
        plain = walker_positions_km(SHELL, 1, 60.0, start_s=300.0, earth="still", sidereal_angle_deg=angle)
        np.testing.assert_allclose(dated.positions_km[0], plain[0], atol=0.1)
        told = walker_constellation(SHELL, tasks, 2, start=NOON, earth=earth, sidereal_angle_deg=0.0)
        undated = walker_constellation(SHELL, tasks, 2, earth=earth)
        np.testing.assert_array_equal(told.positions_km, undated.positions_km)
