"""Plans on maps: CZML that czml3 reads back, GeoJSON by the letter of RFC 7946, and what both say of the plan."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from czml3 import Document
from hypothesis import given
from hypothesis import strategies as st

from sapopt import SAP, Result, solve
from sapopt.domains.constellation import GroundTasks, WalkerShell, walker_constellation
from sapopt.domains.instances import scenario
from sapopt.domains.roster import random_roster
from sapopt.exchange import Places, write_czml, write_geojson
from sapopt.exchange.geojson import cut
from sapopt.solvers import HAAL

START = datetime(2026, 3, 1, 11, tzinfo=UTC)


def built() -> tuple[Any, Result]:
    """A plan for six satellites over three named places, one of them worth nothing."""
    places = GroundTasks(
        np.array([60.0, 0.0, -50.0, 0.0]), np.array([10.0, -190.0, 179.0, 0.0]), np.array([1.0, 2.0, 1.5, 0.0]),
        ("Oslo", "<b>mid</b>", "南", "nowhere"),
    )  # fmt: skip
    made = walker_constellation(
        WalkerShell(2, 3, 70.0, 1500.0), places, 60, 120.0, earth="rotating", start=START
    )
    made = made.with_idle_tasks()
    return made, solve(made.problem(0.1), HAAL(3))


MADE, RESULT = built()


def served() -> set[tuple[int, int, int]]:
    """Satellite, place and step of everything that is served, read off the plan."""
    problem = RESULT.problem
    assert problem is not None
    held = problem.held_benefits(RESULT.plan)
    return {(int(i), int(RESULT.plan[k, i]), int(k)) for k, i in zip(*np.nonzero(held > 0), strict=True)}


def steps(interval: str) -> range:
    """The steps of an interval of CZML."""
    start, stop = (datetime.fromisoformat(end.replace("Z", "+00:00")) for end in interval.split("/"))
    first, last = ((time - START) / timedelta(seconds=120) for time in (start, stop))
    assert first == int(first)
    assert last == int(last)
    return range(int(first), int(last))


def test_czml_says_what_the_plan_says(tmp_path: Path) -> None:
    """Read back by czml3: the same document; positions in metres, names, and the served pairs step by step."""
    write_czml(RESULT, tmp_path / "p.czml", MADE)
    packets = json.loads((tmp_path / "p.czml").read_text("utf-8"))
    assert json.loads(Document.model_validate(packets).dumps()) == packets
    by_id = {packet["id"]: packet for packet in packets}
    assert len(by_id) == len(packets)
    assert by_id["document"]["clock"]["interval"] == "2026-03-01T11:00:00Z/2026-03-01T13:00:00Z"
    found = set()
    for name, packet in by_id.items():
        kind, *numbers = name.split("/")
        if kind == "assignment":
            i, j = map(int, numbers)
            whole, *shown = packet["polyline"]["show"]
            assert whole["boolean"] is False
            assert whole["interval"] == by_id["document"]["clock"]["interval"]
            for span in shown:
                assert span["boolean"] is True
                found |= {(i, j, k) for k in steps(span["interval"])}
            assert packet["polyline"]["positions"]["references"] == [
                f"satellite/{i}#position",
                f"task/{j}#position",
            ]
        if kind == "satellite":
            samples = np.array(packet["position"]["cartesian"]).reshape(-1, 4)
            assert samples[:, 0].tolist() == (120.0 * np.arange(60)).tolist()
            assert np.abs(samples[:, 1:] - 1000 * MADE.positions_km[:, int(numbers[0])]).max() < 0.1
    assert found == served()
    assert {p["name"] for p in packets if p["id"].startswith("task/")} == {"Oslo", "<b>mid</b>", "南"}
    told = "".join(p.get("description", "") for p in packets)
    assert "&lt;b&gt;mid" in told
    assert "<b>" not in told


def position(value: Any) -> None:
    """RFC 7946, 3.1.1: longitude, latitude, WGS 84."""
    assert isinstance(value, list)
    assert 2 <= len(value) <= 3
    assert all(isinstance(x, float | int) and math.isfinite(x) for x in value)
    assert -180 <= value[0] <= 180
    assert -90 <= value[1] <= 90


def line(value: Any) -> None:
    """RFC 7946, 3.1.4, of two or more positions, and 3.1.9: no part of it crosses the antimeridian."""
    assert isinstance(value, list)
    assert len(value) >= 2
    for point in value:
        position(point)
    for a, b in pairwise(value):
        assert abs(a[0] - b[0]) <= 180


def check_geojson(told: Any) -> None:
    """A feature collection by RFC 7946, of the geometries in use."""
    assert told["type"] == "FeatureCollection"
    assert isinstance(told["features"], list)
    assert "crs" not in told
    for feature in told["features"]:
        assert set(feature) == {"type", "geometry", "properties"}
        assert feature["type"] == "Feature"
        assert isinstance(feature["properties"], dict)
        geometry = feature["geometry"]
        assert set(geometry) == {"type", "coordinates"}
        if geometry["type"] == "Point":
            position(geometry["coordinates"])
        else:
            assert geometry["type"] == "MultiLineString"
            for part in geometry["coordinates"]:
                line(part)


def test_geojson_by_the_letter(tmp_path: Path) -> None:
    """Valid, with names, and the served pairs step by step from the places and from the satellites."""
    write_geojson(RESULT, tmp_path / "p.geojson", MADE)
    told = json.loads((tmp_path / "p.geojson").read_text("utf-8"))
    check_geojson(told)
    names, places = list(MADE.satellite_names), list(MADE.tasks.names)
    for kind in ("task", "satellite"):
        found = set()
        for feature in told["features"]:
            own = feature["properties"]
            if own["kind"] == kind:
                for stay in own["stays"]:
                    pair = (stay["satellite"], own["name"]) if kind == "task" else (own["name"], stay["task"])
                    span = steps(f"{stay['start']}/{stay['stop']}")
                    found |= {(names.index(pair[0]), places.index(pair[1]), k) for k in span}
        assert found == served()
    again = GroundTasks.from_geojson({**told, "features": told["features"][:3]})
    assert again.names == ("Oslo", "<b>mid</b>", "南")
    assert again.longitude_deg.tolist() == [10.0, 170.0, 179.0]


@given(st.lists(st.tuples(st.floats(-180, 180), st.floats(-89, 89)), min_size=2, max_size=8))
def test_tracks_are_cut_at_the_antimeridian(points: list[tuple[float, float]]) -> None:
    """All points stay, in order; no line crosses; what was added lies on the antimeridian, on both sides."""
    lines = cut(np.array(points))
    for part in lines:
        line(part)
    for a, b in pairwise(lines):
        assert abs(a[-1][0]) == abs(b[0][0]) == 180
        assert a[-1][1] == b[0][1]
    inner = [tuple(point) for part in lines for point in part]
    rest = iter(inner)
    assert all((round(x, 5), round(y, 5)) in rest for x, y in points)


def test_beams_and_single_steps(tmp_path: Path) -> None:
    """Beams ride on their satellites, and one step is enough for a map; the date is then that of J2000."""
    beams = scenario("multi-beam", tasks=60, steps=1, beams=2)
    result = solve(beams.problem(), HAAL(1))
    write_czml(result, tmp_path / "p.czml", beams)
    packets = json.loads((tmp_path / "p.czml").read_text("utf-8"))
    assert sum(packet["id"].startswith("satellite/") for packet in packets) == 36
    assert packets[0]["clock"]["currentTime"] == "2000-01-01T12:00:00Z"
    assert any(packet["id"].startswith("assignment/") for packet in packets)
    write_geojson(result, tmp_path / "p.geojson", beams)
    check_geojson(json.loads((tmp_path / "p.geojson").read_text("utf-8")))


def test_other_scenarios_are_refused(tmp_path: Path) -> None:
    """A scenario without satellites, and one of another size, are told."""
    problem = SAP(np.ones((2, 2, 2)))
    result = Result.from_plan(problem, [[0, 1], [0, 1]])
    for write in (write_czml, write_geojson):
        with pytest.raises(ValueError, match="a map needs places, and a"):
            write(result, tmp_path / "p", scenario("dictator"))
        with pytest.raises(ValueError, match="pass the scenario that the problem was made from"):
            write(result, tmp_path / "p", MADE)
    assert list(tmp_path.iterdir()) == []


ANTENNAS = GroundTasks([35.4, -35.4], [-116.9, 149.0], [1.0, 1.0], ("Goldstone", "Canberra"))
SITES = GroundTasks([60.0, 0.0, 10.0], [10.0, 20.0, 190.0], [1.0, 1.0, 0.0])


@pytest.mark.parametrize("dated", [True, False])
def test_agents_that_stay_where_they_are(dated: bool, tmp_path: Path) -> None:
    """Fixed points with their names, joined to the places that they serve, at the times of the steps."""
    benefits = np.zeros((3, 2, 3))
    benefits[:2, 0, 1] = benefits[2, 1, 0] = 1.0
    times = [START, START + timedelta(hours=1), START + timedelta(hours=3)] if dated else None
    problem = SAP(benefits, 0.1, tasks=["a", "b", "c"], times=times)
    result = Result.from_plan(problem, [[1, 0], [1, 0], [1, 0]])
    here = Places(ANTENNAS, SITES, start=None if dated else START, step_s=3600.0)
    write_czml(result, tmp_path / "p.czml", here)
    packets = json.loads((tmp_path / "p.czml").read_text("utf-8"))
    assert json.loads(Document.model_validate(packets).dumps()) == packets
    by_id = {packet["id"]: packet for packet in packets}
    assert by_id["satellite/1"]["position"] == {"cartographicDegrees": [149.0, -35.4, 0.0]}
    assert "path" not in by_id["satellite/1"]
    assert by_id["satellite/1"]["label"]["text"] == "Canberra"
    assert [by_id[f"task/{j}"]["name"] for j in range(2)] == ["a", "b"]
    end = {True: "14:00", False: "13:00"}[dated]
    shown = by_id["assignment/0/1"]["polyline"]["show"][1:]
    assert [span["interval"] for span in shown] == [f"2026-03-01T11:00:00Z/2026-03-01T{end}:00Z"]
    write_geojson(result, tmp_path / "p.geojson", here)
    features = json.loads((tmp_path / "p.geojson").read_text("utf-8"))["features"]
    kinds = {f["properties"]["name"]: f["properties"]["kind"] for f in features}
    assert kinds == {"a": "task", "b": "task", "Goldstone": "agent", "Canberra": "agent"}
    for feature in features:
        assert feature["geometry"]["type"] == "Point"
        position(feature["geometry"]["coordinates"])
    with pytest.raises(ValueError, match="it has places for 3 agents, the problem 2"):
        write_czml(result, tmp_path / "q.czml", Places(SITES, SITES))
    with pytest.raises(ValueError, match=r"a Roster has none.*Places.*Without places"):
        write_czml(result, tmp_path / "q.czml", random_roster(nurses=3, wards=2, days=4, seed=0))
    with pytest.raises(ValueError, match="agents must be places, such as GroundTasks, got list"):
        Places([1.0], SITES)  # type: ignore[arg-type]
