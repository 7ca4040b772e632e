"""Names of columns in public trip tables, and which of them a table has."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

USUAL: dict[str, tuple[str, ...]] = {
    "pick_up_time": (
        "tpep_pickup_datetime", "lpep_pickup_datetime", "pickup_datetime", "trip_pickup_datetime",
        "trip_start_timestamp",
    ),
    "drop_off_time": (
        "tpep_dropoff_datetime", "lpep_dropoff_datetime", "dropoff_datetime", "trip_dropoff_datetime",
        "trip_end_timestamp",
    ),
    "duration_s": ("trip_seconds", "trip_time", "trip_time_in_secs"),
    "pick_up_longitude": ("pickup_longitude", "start_lon", "pickup_centroid_longitude"),
    "pick_up_latitude": ("pickup_latitude", "start_lat", "pickup_centroid_latitude"),
    "drop_off_longitude": ("dropoff_longitude", "end_lon", "dropoff_centroid_longitude"),
    "drop_off_latitude": ("dropoff_latitude", "end_lat", "dropoff_centroid_latitude"),
    "pick_up_zone": ("pulocationid", "pickup_community_area"),
    "drop_off_zone": ("dolocationid", "dropoff_community_area"),
    "fare": ("fare_amount", "fare_amt", "base_passenger_fare", "fare", "total_amount", "total_amt", "trip_total"),
}  # fmt: skip
"""Names in the tables of the New York taxi commission and of Chicago over the years, the usual one first; case, blanks
and marks do not count."""

PLACES = ("pick_up_longitude", "pick_up_latitude", "drop_off_longitude", "drop_off_latitude")
ZONES = ("pick_up_zone", "drop_off_zone")


@dataclass(frozen=True)
class Columns:
    """Index of every column that is needed; None where the table does without.

    Attributes
    ----------
    begin : int
    end, duration : int or None
        One of them is there.
    places : tuple of int
        Longitude and latitude of the pick-up and of the drop-off, or (`zoned`) the two zones.
    zoned : bool
    fare : int or None
    """

    begin: int
    end: int | None
    duration: int | None
    places: tuple[int, ...]
    zoned: bool
    fare: int | None


def find_columns(path: Path, header: list[str], named: Mapping[str, str], zones: bool) -> Columns:
    """Which columns of a header hold what.

    Parameters
    ----------
    path : Path
        For messages.
    header : list of str
    named : mapping of str to str
        The caller's own names.
    zones : bool
        Whether the centres of zones are known.

    Raises
    ------
    ValueError
        If a column is missing, or a name is none of the table's.
    """
    known: dict[str, int] = {}
    for index, name in enumerate(header):
        known.setdefault(_plain(name), index)
    if unknown := set(named) - set(USUAL):
        raise ValueError(f"columns: {sorted(unknown)[0]!r} is none of {', '.join(USUAL)}")

    def find(key: str) -> int | None:
        names = (_plain(named[key]),) if key in named else USUAL[key]
        return next((known[name] for name in names if name in known), None)

    def need(key: str) -> int:
        index = find(key)
        if index is None:
            looked = named[key] if key in named else ", ".join(USUAL[key])
            raise ValueError(
                f"{path}: there is no column for {key} (looked for {looked}; there are {', '.join(header)}); name it "
                f"with columns={{{key!r}: ...}}"
            )
        return index

    begin = need("pick_up_time")
    end = find("drop_off_time")
    duration = need("duration_s") if end is None and find("duration_s") is not None else None
    if end is None and duration is None:
        need("drop_off_time")
    zoned = zones and (any(find(key) is not None for key in ZONES) or find(PLACES[0]) is None)
    if not zones and find(PLACES[0]) is None and any(find(key) is not None for key in ZONES):
        raise ValueError(
            f"{path}: the table tells zones, not coordinates; pass zones={{id: (longitude, latitude)}} with the "
            "centres of the zones (read_zones reads them)"
        )
    places = tuple(need(key) for key in (ZONES if zoned else PLACES))
    fare = need("fare") if "fare" in named else find("fare")
    return Columns(begin, end, duration, places, zoned, fare)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.strip().lower()).strip("_")
