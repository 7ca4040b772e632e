"""Ride-hailing: the synthetic city, and cities read from small trip tables made here."""

from __future__ import annotations

import csv
import dataclasses
import datetime
import gzip
import logging
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sapopt import bound, solve
from sapopt.domains.instances import instance
from sapopt.domains.ride_hailing import City, Trips, city_from_trips, random_city, read_trips
from sapopt.domains.ride_hailing.trips import MissingReaderError
from sapopt.solvers import HAA, HAAL, DualLookahead, Exact

NOON = datetime.datetime(2016, 1, 15, 12, 0, 0)
HEADER = [
    "VendorID", "tpep_pickup_datetime", "tpep_dropoff_datetime", "pickup_longitude", "pickup_latitude",
    "dropoff_longitude", "dropoff_latitude", "fare_amount",
]  # fmt: skip


def table(count: int = 30, seed: int = 0) -> list[list[Any]]:
    """Trips in the middle of New York, one a minute or so, at 15 km/h."""
    rng = np.random.default_rng(seed)
    rows: list[list[Any]] = []
    for r in range(count):
        east, north = rng.uniform(0, 6, (2, 2))  # km
        longitude, latitude = -74.0 + east / 84.3, 40.7 + north / 111.2
        begin = NOON + datetime.timedelta(seconds=60 * r)
        ride = (abs(east[0] - east[1]) + abs(north[0] - north[1])) / 15.0
        rows.append(
            [1, begin, begin + datetime.timedelta(hours=ride), longitude[0], latitude[0], longitude[1], latitude[1],
             2.5 + 10 * ride]
        )  # fmt: skip
    return rows


def write_csv(path: Path, rows: list[list[Any]], header: list[str] = HEADER) -> Path:
    opener: Any = gzip.open if path.suffix == ".gz" else open
    with opener(path, "wt", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
    return path


def write_parquet(path: Path, rows: list[list[Any]], header: list[str] = HEADER) -> Path:
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(
        pa.table({name: list(c) for name, c in zip(header, zip(*rows, strict=True), strict=True)}), path
    )
    return path


def same(a: Trips, b: Trips) -> bool:
    names = ("pick_up_s", "drop_off_s", "pick_up_deg", "drop_off_deg", "fare")
    return all(np.allclose(getattr(a, name), getattr(b, name)) for name in names) and a.dropped == b.dropped


def test_csv_gzip_and_parquet_are_read_alike(tmp_path: Path) -> None:
    rows = table()
    plain = read_trips(write_csv(tmp_path / "t.csv", rows[::-1]))
    assert len(plain) == 30
    assert plain.dropped == 0
    assert (np.diff(plain.pick_up_s) >= 0).all()
    assert plain.pick_up_s[0] == 12 * 3600
    assert plain.pick_up_deg[0] == pytest.approx(rows[0][3:5])
    assert plain.drop_off_deg[0] == pytest.approx(rows[0][5:7])
    assert plain.fare[0] == pytest.approx(rows[0][7])
    assert same(plain, read_trips(write_csv(tmp_path / "t.csv.gz", rows)))
    assert same(plain, read_trips(write_parquet(tmp_path / "t.parquet", rows)))
    assert len(read_trips(tmp_path / "t.csv", limit=7)) == 7


def test_other_names_and_zones(tmp_path: Path) -> None:
    rows = table(5)
    own = ["id", "on", "off", "Start_Lon", "Start_Lat", "End_Lon", "End_Lat", "paid"]
    path = write_csv(tmp_path / "own.csv", rows, own)
    with pytest.raises(ValueError, match=r"no column for pick_up_time .*columns="):
        read_trips(path)
    names = {"pick_up_time": "on", "drop_off_time": "off", "fare": "paid"}
    assert len(read_trips(path, columns=names)) == 5
    with pytest.raises(ValueError, match="'pick_up' is none of"):
        read_trips(path, columns={"pick_up": "on"})
    zoned = [[*row[:3], 100 + r % 2, 200, row[7]] for r, row in enumerate(rows)]
    path = write_csv(tmp_path / "z.csv", zoned, [*HEADER[:3], "PULocationID", "DOLocationID", "fare_amount"])
    with pytest.raises(ValueError, match="zones, not coordinates"):
        read_trips(path)
    centres = {100: (-74.0, 40.7), 101: (-73.9, 40.8), 200: (-73.95, 40.75)}
    trips = read_trips(path, zones=centres)
    assert trips.pick_up_deg[1] == pytest.approx([-73.9, 40.8])
    assert read_trips(path, zones={k: centres[k] for k in (100, 200)}).dropped == 2  # zone 101 is unknown


def test_impossible_rows_are_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rows = table(10)
    rows[1][3:5] = [0.0, 0.0]  # how the tables say "unknown"
    rows[2][7] = -3.0
    rows[3][1], rows[3][2] = rows[3][2], rows[3][1]
    rows[4][4] = ""
    rows[5][1] = "yesterday"
    with caplog.at_level(logging.WARNING):
        trips = read_trips(write_csv(tmp_path / "t.csv", rows))
    assert (len(trips), trips.dropped) == (5, 5)
    assert "5 of 10 rows left out" in caplog.text
    with pytest.raises(ValueError, match="none of its 1 rows"):
        read_trips(write_csv(tmp_path / "bad.csv", rows[1:2]))


def test_unreadable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(ValueError, match="is empty"):
        read_trips(tmp_path / "empty.csv")
    for name in ("none.csv", "none.parquet"):
        if name.endswith("csv") or "pyarrow" in sys.modules:
            with pytest.raises(FileNotFoundError):
                read_trips(tmp_path / name)
    with pytest.raises(ValueError, match="limit"):
        read_trips(tmp_path / "empty.csv", limit=0)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(MissingReaderError, match=r"sapopt\[tables\]"):
        read_trips(tmp_path / "t.parquet")


def test_damaged_parquet(tmp_path: Path) -> None:
    path = write_parquet(tmp_path / "t.parquet", table(5))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"damaged|Parquet"):
        read_trips(path)


def test_city_from_a_table(tmp_path: Path) -> None:
    """Steps, places and travel times are those of the table; the whole chain runs to a plan below the bound."""
    trips = read_trips(write_csv(tmp_path / "t.csv", table()))
    city = city_from_trips(trips, drivers=4, steps=12, step_s=120.0, cell_km=1.0)
    assert (
        city.arrival == np.arange(24) // 2
    ).all()  # one a minute, two a step; the last ones come after the end
    assert set(city.home) <= set(city.pick_up)
    # 15 km/h are 0.5 km a step; a ride takes the grid way between cells, at most a cell more or less at either end.
    way = np.abs(city.places_km[city.pick_up] - city.places_km[city.drop_off]).sum(axis=1)
    steps = city.travel[city.pick_up, city.drop_off]
    assert (np.abs(steps - way / 0.5) <= 1.0).all()
    problem = city.problem(0.1)
    assert (problem.T, problem.n, problem.m) == (12, 4, 28)
    proven = bound(problem, time_limit=3.0).value
    result = solve(problem, DualLookahead(6))
    assert 0 < result.value <= proven
    rides = city.rides(result.plan, 0.1)
    assert rides
    check_rides(city, rides)
    later = city_from_trips(trips, 2, start_s=12 * 3600 + 600, steps=3, speed_km_h=30.0)
    assert len(later.arrival) == 6
    for changes, message in (
        ({"start_s": 0.0}, "no trip begins"),
        ({"drivers": 0}, "drivers"),
        ({"cell_km": 0.0}, "cell_km"),
        ({"speed_km_h": -1.0}, "speed_km_h"),
    ):
        with pytest.raises(ValueError, match=message):
            city_from_trips(trips, **({"drivers": 3} | changes))  # type: ignore[arg-type]


def check_rides(city: City, rides: list[tuple[int, int, int, int]]) -> None:
    """No request twice, nobody waits too long, no driver in two rides at once."""
    requests = [r for _, r, _, _ in rides]
    assert len(set(requests)) == len(requests)
    for _, r, at, end in rides:
        assert city.arrival[r] <= at <= city.arrival[r] + city.patience
        assert end - at == city.travel[city.pick_up[r], city.drop_off[r]]
    for i in {i for i, *_ in rides}:
        mine = [ride for ride in rides if ride[0] == i]
        place, free = city.home[i], 0
        for _, r, at, end in mine:
            assert at >= free + city.travel[place, city.pick_up[r]]
            place, free = city.drop_off[r], end


def test_random_city() -> None:
    """The same seed makes the same city; rides of a plan are possible, and pay what the plan is worth."""
    city = random_city(6, 40, 15, seed=2, width=5, patience=2)
    again = random_city(6, 40, 15, seed=2, width=5, patience=2)
    assert city.problem().fingerprint == again.problem().fingerprint
    assert (
        city.problem().fingerprint
        != random_city(6, 40, 15, seed=3, width=5, patience=2).problem().fingerprint
    )
    problem = city.problem(0.5)
    proven = bound(problem, time_limit=3.0).value
    for solver in (HAA(), HAAL(3), DualLookahead(5)):
        result = solve(problem, solver)
        assert result.value <= proven
        rides = city.rides(result.plan, 0.5)
        check_rides(city, rides)
        total, place = 0.0, dict(enumerate(city.home))
        for i, r, _, _ in rides:
            driven = city.travel[place[i], city.pick_up[r]] + city.travel[city.pick_up[r], city.drop_off[r]]
            total += city.fare[r] - 0.5 * driven
            place[i] = city.drop_off[r]
        assert total == pytest.approx(result.value)


def test_tiny_city_against_enumeration() -> None:
    for seed in range(4):
        problem = random_city(2, 5, 5, seed=seed, width=3, patience=1).problem(0.3)
        best = solve(problem, Exact(method="dp")).value
        assert solve(problem, DualLookahead(5)).value <= best + 1e-9
        assert solve(problem, HAAL(2)).value <= best + 1e-9
        assert bound(problem, time_limit=2.0).value >= best - 1e-9


def test_requests_that_do_not_pay_are_not_offered() -> None:
    city = random_city(3, 20, 10, seed=0, width=4)
    assert (city.problem(100.0).benefits.flat().data.size) == 0
    assert len(np.unique(city.problem(0.0).benefits.flat().indices)) == 20


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fare": np.full(10, np.nan)}, "fare of request 0"),
        ({"arrival": np.arange(10)}, "arrival must lie in 0..5"),
        ({"drop_off": np.arange(3)}, "drop_off has 3 entries"),
        ({"places_km": np.zeros((2, 2))}, "places_km has shape"),
    ],
)
def test_bad_city(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(random_city(3, 10, 6, width=4), **changes)


@pytest.mark.parametrize("name", ["drivers", "requests", "steps", "width"])
def test_bad_sizes(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        random_city(**{name: 0})


def test_instance_and_draw() -> None:
    from matplotlib.figure import Figure

    problem = instance("ride-hailing", drivers=3, requests=10, steps=6, width=4)
    assert (problem.T, problem.n, problem.m) == (6, 3, 13)
    city = random_city(3, 10, 6, width=4)
    plan = solve(city.problem(), HAA()).plan
    ax = city.draw(plan, ax=Figure().subplots())
    served = len(city.rides(plan))
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert f"picked up: {served}" in labels
    assert f"not served: {10 - served}" in labels
