"""Trip tables as they are published: names, times, zones, stray rows, and damage."""

from __future__ import annotations

import gzip
import logging
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt.domains.ride_hailing import Trips, city_from_trips, read_trips, read_zones
from sapopt.domains.ride_hailing.values import number_of, time_of, zone_of

HEADER = ",".join(
    ["pickup_datetime", "dropoff_datetime", "pickup_longitude", "pickup_latitude", "dropoff_longitude",
     "dropoff_latitude", "fare_amount"]
)  # fmt: skip
PLACES = "-73.99,40.73,-73.97,40.76,9.5"


def table(tmp_path: Path, *rows: str, header: str = HEADER, name: str = "t.csv") -> Path:
    """A table of these lines."""
    path = tmp_path / name
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def timed(begin: str, end: str) -> str:
    """A row with these times."""
    return f"{begin},{end},{PLACES}"


def test_times_are_subtracted_as_instants(tmp_path: Path) -> None:
    """01:50 at -05:00 to 03:10 at -04:00 are 20 minutes, 01:50 at -04:00 to 01:10 at -05:00 likewise."""
    trips = read_trips(
        table(
            tmp_path,
            timed("2024-03-10T01:50:00-05:00", "2024-03-10T03:10:00-04:00"),
            timed("2024-11-03T01:50:00-04:00", "2024-11-03T01:10:00-05:00"),
            timed("2024-11-03T06:00:00Z", "2024-11-03T02:00:00-0500"),
        )
    )
    assert trips.dropped == 0
    np.testing.assert_array_equal(trips.drop_off_s - trips.pick_up_s, [1200, 1200, 3600])
    assert trips.midnight == datetime(2024, 3, 10, tzinfo=UTC)
    assert trips.pick_up_s[0] == (6 * 60 + 50) * 60


def test_the_rarer_kind_of_time_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Times without an offset cannot be compared with times that have one."""
    plain, offset = "2024-03-10 01:50:00", "2024-03-10 03:10:00+00:00"
    rows = [timed(plain, plain), timed(offset, offset), timed(offset, offset), timed(plain, offset)]
    with caplog.at_level(logging.WARNING):
        trips = read_trips(table(tmp_path, *rows))
    assert (len(trips), trips.dropped) == (2, 2)
    assert "2 of 3 times tell an offset" in caplog.text


def test_parquet_with_a_zone_and_nanoseconds(tmp_path: Path) -> None:
    """Zone-aware columns of Parquet are instants too, over the change of the clocks; nanoseconds are read."""
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    zone = ZoneInfo("America/New_York")
    begin = datetime(2024, 11, 3, 1, 50, tzinfo=zone)  # summer time
    end = datetime(2024, 11, 3, 1, 10, fold=1, tzinfo=zone)
    kind = pa.timestamp("ns", tz="America/New_York")
    columns: dict[str, Any] = {
        "pickup_datetime": pa.array([begin.astimezone(UTC)], kind),
        "dropoff_datetime": pa.array([end.astimezone(UTC)], kind),
        "PULocationID": pa.array([132.0]),
        "DOLocationID": pa.array([7], pa.int32()),
        "fare_amount": pa.array(["9.5"]).dictionary_encode(),
    }
    parquet.write_table(pa.table(columns), tmp_path / "t.parquet")
    trips = read_trips(tmp_path / "t.parquet", zones={132: (-73.8, 40.6), 7: (-73.9, 40.7)})
    assert trips.drop_off_s - trips.pick_up_s == [1200]
    assert trips.fare == [9.5]


@settings(max_examples=200)
@given(
    time=st.datetimes(datetime(1980, 1, 1), datetime(2090, 1, 1)).map(lambda t: t.replace(microsecond=0)),
    minutes=st.integers(-12 * 60, 14 * 60),
)
def test_forms_of_times(time: datetime, minutes: int) -> None:
    """ISO, the American form and Unix seconds mean the same moment; a zone makes it an instant."""
    assert time_of(time.isoformat(" ")) == time
    assert time_of(f"{time:%m/%d/%Y %I:%M:%S %p}") == time
    assert time_of(f"{time:%m/%d/%Y %H:%M:%S}") == time
    seconds = int((time - datetime(1970, 1, 1)).total_seconds())
    if seconds >= 10**9:
        assert time_of(str(seconds)) == time_of(seconds) == time_of(float(seconds)) == time
    aware = time.replace(tzinfo=timezone(timedelta(minutes=minutes)))
    assert time_of(aware.isoformat()) == time_of(aware) == aware.astimezone(UTC)


def test_fields_that_mean_nothing() -> None:
    """Words, short dates and impossible times are no times; nan, inf and underscores no numbers; 132.9 no zone."""
    for text in (
        "",
        "yesterday",
        "20240101",
        "2024",
        "13/01/2024 10:00:00 AM",
        "01/01/2024 13:00:00 PM",
        "12:00",
        None,
    ):
        with pytest.raises(ValueError, match=r".+"):
            time_of(text)
    assert number_of("$1,234.50") == 1234.5
    assert number_of(" -.5 ") == -0.5
    for text in ("nan", "inf", "1_000", "١", "1,5", "", float("nan")):
        with pytest.raises(ValueError, match=r"number|finite"):
            number_of(text)
    assert zone_of("132.0") == zone_of(132.0) == zone_of(132) == 132
    for value in ("132.9", 132.9, float("nan"), "x"):
        with pytest.raises(ValueError, match=r"number|finite"):
            zone_of(value)


def test_zones_with_decimals(tmp_path: Path) -> None:
    """Tables with gaps write 132.0 for 132; what is no whole number is no zone, in CSV and in Parquet."""
    header = "pickup_datetime,dropoff_datetime,PUlocationID,DOlocationID,fare"
    time = "2018-02-09 23:55:00,2018-02-10 00:15:00"
    rows = [f"{time},132.0,7,5", f"{time},132.9,7,5", f"{time},132,7.0,6", f"{time},,7,5"]
    zones = {132: (-73.8, 40.6), 7: (-73.9, 40.7)}
    trips = read_trips(table(tmp_path, *rows, header=header), zones=zones)
    assert (len(trips), trips.dropped) == (2, 2)
    np.testing.assert_array_equal(trips.fare, [5, 6])


def test_a_zero_is_an_unknown_place(tmp_path: Path) -> None:
    """One coordinate of zero is as unknown as two."""
    time = "2018-02-09 23:55:00,2018-02-10 00:15:00"
    rows = [f"{time},{places},5" for places in (
        "-73.9,0,-73.9,40.7", "0,40.7,-73.9,40.7", "-73.9,40.7,-73.9,0.0", "-73.9,40.7,0,0", "-73.9,40.7,-73.8,40.7",
    )]  # fmt: skip
    trips = read_trips(table(tmp_path, *rows))
    assert (len(trips), trips.dropped) == (1, 4)


def test_tables_of_chicago(tmp_path: Path) -> None:
    """The portal's own names, and those of the form with Unix seconds and no end."""
    portal = table(
        tmp_path,
        'a,b,09/30/2013 07:15:00 PM,09/30/2013 07:45:00 PM,8,32,"$7.05","$1,000.00",41.98,-87.63,41.87,-87.65',
        header="Trip ID,Taxi ID,Trip Start Timestamp,Trip End Timestamp,Pickup Community Area,Dropoff Community Area,"
        "Fare,Trip Total,Pickup Centroid Latitude,Pickup Centroid Longitude,Dropoff Centroid Latitude,"
        "Dropoff Centroid  Longitude",
    )
    trips = read_trips(portal)
    assert trips.pick_up_s == [(19 * 60 + 15) * 60]
    assert trips.drop_off_s - trips.pick_up_s == [1800]
    assert trips.fare == [7.05]
    assert trips.pick_up_deg.tolist() == [[-87.63, 41.98]]
    by_area = read_trips(portal, zones={8: (-87.6, 41.9), 32: (-87.6, 41.8)})
    assert by_area.drop_off_deg.tolist() == [[-87.6, 41.8]]
    unix = table(
        tmp_path,
        "60,27.05,1380593700,41.83,-87.64,41.92,-87.67,1380,,",
        "60,27.05,1380593700,41.83,-87.64,41.92,-87.67,,,",
        header="pickup_community_area,fare,trip_start_timestamp,pickup_latitude,pickup_longitude,dropoff_latitude,"
        "dropoff_longitude,trip_seconds,dropoff_community_area,tips",
    )
    trips = read_trips(unix)
    assert (len(trips), trips.dropped) == (1, 1)
    assert trips.drop_off_s - trips.pick_up_s == [1380]


def test_tables_without_fares(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """For-hire vehicles: quoted, zones only, no fares; every ride pays 1 a minute, and the log says so."""
    path = table(
        tmp_path,
        '"2018-02-09 23:55:00","2018-02-10 00:15:00","265","72","","B01268",""',
        '"2018-02-09 23:38:26","2018-02-09 23:53:44","","72","","B01273",""',
        header='"Pickup_DateTime","DropOff_datetime","PUlocationID","DOlocationID","SR_Flag","Dispatching_base_number",""',
    )
    zones = table(
        tmp_path, "265,Queens,40.7,-73.8", "72,Queens,40.6,-73.9", "1,Unknown,,",
        header="LocationID,Borough,latitude,longitude", name="zones.csv",
    )  # fmt: skip
    centres = read_zones(zones)
    assert centres == {265: (-73.8, 40.7), 72: (-73.9, 40.6)}
    with caplog.at_level(logging.WARNING):
        trips = read_trips(path, zones=centres)
    assert trips.fare == [20]
    assert "no fares" in caplog.text
    with pytest.raises(ValueError, match=r"no column for fare .looked for price"):
        read_trips(path, zones=centres, columns={"fare": "price"})
    with pytest.raises(ValueError, match=r"zones\.csv: there is no column longitude"):
        read_zones(table(tmp_path, "1,2", header="LocationID,lat", name="zones.csv"))
    with pytest.raises(ValueError, match="none of its rows has a number"):
        read_zones(table(tmp_path, "x,2,3", header="LocationID,lat,lon", name="zones.csv"))


def stray(*pick_ups: float) -> Trips:
    """Trips at these seconds, between two places."""
    begin = np.sort(np.array(pick_ups))
    n = len(begin)
    ends = np.tile([[-73.9, 40.7], [-73.8, 40.8]], (n, 1, 1))
    return Trips(begin, begin + 600, ends[:, 0], ends[:, 1], np.full(n, 9.0), 0, datetime(2008, 12, 31))


def test_a_city_starts_where_the_trips_are(caplog: pytest.LogCaptureFixture) -> None:
    """Stray rows of another year are left out with a word; a night with few trips is no stray row."""
    crowd = 5e8 + 60.0 * np.arange(100)
    with caplog.at_level(logging.WARNING):
        city = city_from_trips(stray(0.0, 40.0, *crowd), 3)
    assert len(city.arrival) == 100
    assert "2 trips before it are left out, the first at 0 s (2008-12-31 00:00:00)" in caplog.text
    caplog.clear()
    night = [600.0 * k for k in range(30)]  # a trip in ten minutes, then one a minute
    with caplog.at_level(logging.WARNING):
        city = city_from_trips(stray(*night, *(18000 + 60.0 * np.arange(100))), 3)
    assert len(city.arrival) == 12
    assert not caplog.text
    with pytest.raises(ValueError, match=r"no trip begins between 60 s .2008-12-31 00:01:00. and"):
        city_from_trips(stray(0.0, *crowd), 3, start_s=60.0)
    with pytest.raises(ValueError, match="start_s must be a finite"):
        city_from_trips(stray(0.0), 3, start_s=np.nan)


GOOD = timed("2018-02-09 23:55:00", "2018-02-10 00:15:00")
DAMAGE = {
    "open quote": (f'{HEADER}\n{GOOD}\n"2018{GOOD}\n'.encode(), "line 3: a quote is opened here and never closed"),
    "stray quote": (f'{HEADER}\n"a"b,{GOOD}\n'.encode(), "line 2: not CSV"),
    "huge field": (f"{HEADER}\n{'9' * 200_000},{GOOD}\n".encode(), "line 2: a field of more than 131072"),
    "NUL": (f"{HEADER}\n{GOOD}\n\0{GOOD}\n".encode(), "line 3: a NUL byte"),
    "cut archive": (gzip.compress(f"{HEADER}\n{GOOD}\n".encode() * 500)[:-9], "the archive is damaged or cut"),
    "cut early": (gzip.compress(f"{HEADER}\n{GOOD}\n".encode())[:12], "the archive is damaged or cut"),
    "no archive": (b"\x1f\x8b and so on", "the archive is damaged or cut"),
    "zip": (b"PK\x03\x04...", "a zip archive; unpack it first"),
    "no Parquet": (b"PAR1 and so on", "damaged or no Parquet file"),
    "only blanks": (b" \n\n", "the table is empty"),
}  # fmt: skip


@pytest.mark.parametrize("kind", DAMAGE)
@pytest.mark.parametrize("name", ["t.csv", "t.csv.gz", "t"])
def test_damage_is_one_error_with_the_path(kind: str, name: str, tmp_path: Path) -> None:
    """Whatever is wrong with a file, and whatever it is called: one ValueError with its path."""
    if kind == "no Parquet":
        pytest.importorskip("pyarrow")
    data, reason = DAMAGE[kind]
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(ValueError, match=reason) as caught:
        read_trips(path)
    assert str(path) in str(caught.value)


@settings(max_examples=150, deadline=None)
@given(data=st.data(), form=st.sampled_from(["csv", "gz", "parquet", "utf-16"]))
def test_random_damage(data: st.DataObject, form: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    """A changed, cut or doubled piece gives trips or one ValueError with the path, and nothing else."""
    folder = tmp_path_factory.mktemp("trips")
    text = f"{HEADER}\n" + f"{GOOD}\n" * 8
    content = text.encode("utf-16" if form == "utf-16" else "utf-8")
    if form == "gz":
        content = gzip.compress(content)
    elif form == "parquet":
        pa = pytest.importorskip("pyarrow")
        rows = [line.split(",") for line in text.splitlines()]
        columns = {name: list(c) for name, c in zip(rows[0], zip(*rows[1:], strict=True), strict=True)}
        pytest.importorskip("pyarrow.parquet").write_table(pa.table(columns), folder / "good")
        content = (folder / "good").read_bytes()
    first = data.draw(st.integers(0, len(content) - 1))
    last = data.draw(st.integers(first, min(len(content), first + 30)))
    piece = data.draw(st.one_of(st.just(b""), st.binary(max_size=6), st.just(content[first:last] * 2)))
    path = folder / "damaged"
    path.write_bytes(content[:first] + piece + content[last:])
    try:
        assert len(read_trips(path)) >= 1
    except ValueError as error:
        assert str(path) in str(error)  # noqa: PT017
