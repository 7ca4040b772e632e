"""Public trip tables: when and where rides began and ended, and what they cost."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.domains.ride_hailing.columns import Columns, find_columns
from sapopt.domains.ride_hailing.rows import MissingReaderError, table_rows
from sapopt.domains.ride_hailing.values import is_place, number_of, time_of, zone_of

__all__ = ["MissingReaderError", "Trips", "read_trips", "read_zones"]

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Trips:
    """Trips of a table, in the order of their pick-ups.

    Attributes
    ----------
    pick_up_s, drop_off_s : ndarray, shape (R,)
        Seconds since `midnight`.
    pick_up_deg, drop_off_deg : ndarray, shape (R, 2)
        Longitude and latitude.
    fare : ndarray, shape (R,)
    dropped : int
        Rows that were left out because a value is missing or impossible.
    midnight : datetime or None
        Begin of the day of the first trip, in UTC where the table tells offsets, else without a time zone.
    """

    pick_up_s: FloatArray
    drop_off_s: FloatArray
    pick_up_deg: FloatArray
    drop_off_deg: FloatArray
    fare: FloatArray
    dropped: int = 0
    midnight: datetime | None = None

    def __len__(self) -> int:
        return len(self.fare)

    def told(self, second: float) -> str:
        """A second as messages show it, with the date if it is known."""
        if self.midnight is None:
            return f"{second:g} s"
        return f"{second:g} s ({self.midnight + timedelta(seconds=second):%Y-%m-%d %H:%M:%S})"


def read_trips(
    path: str | Path,
    *,
    columns: Mapping[str, str] | None = None,
    zones: Mapping[int, Sequence[float]] | None = None,
    limit: int | None = None,
) -> Trips:
    """Read a trip table with pick-up and drop-off times and places: those of the New York taxi commission, of Chicago.

    Parameters
    ----------
    path : str or Path
        CSV, gzipped CSV, or Parquet (this one needs the extra ``tables``); the content tells which.
    columns : mapping of str to str, optional
        Names of the columns where they are not the usual ones; keys are ``pick_up_time``, ``drop_off_time`` (or
        ``duration_s``), ``pick_up_longitude``, ``pick_up_latitude``, ``drop_off_longitude``, ``drop_off_latitude``,
        ``pick_up_zone``, ``drop_off_zone`` and ``fare``.
    zones : mapping of int to (longitude, latitude), optional
        Centres of the zones, for tables that tell zones in place of coordinates (``PULocationID``, ``DOLocationID``),
        see `read_zones`.
    limit : int, optional
        Read at most this many rows.

    Returns
    -------
    Trips
        Rows without a time, place, fare, or with an end before the start, are left out and counted. Coordinates with a
        zero are unknown places. Times with an offset are compared as instants; where some rows have one and others do
        not, the rarer kind is left out.

    Raises
    ------
    FileNotFoundError
    ValueError
        If the file is damaged, a column is missing, or no row can be used.
    MissingReaderError
        If a Parquet file is given and pyarrow is not installed.

    Notes
    -----
    A table without any fare (for-hire vehicles of New York) gets one for every minute of the ride, and the log says so.
    """
    path = Path(path)
    if limit is not None and limit < 1:
        raise ValueError(f"limit must be at least 1, got {limit!r}")
    rows = table_rows(path)
    header = next(rows, None)
    if header is None:
        raise ValueError(f"{path}: the table is empty")
    found = find_columns(path, [str(name) for name in header], columns or {}, zones is not None)
    if found.fare is None:
        log.warning("%s: the table has no fares; every ride pays 1 for each of its minutes", path)
    read = 0
    kept: list[tuple[datetime, datetime, list[float]]] = []
    for row in islice(rows, limit):
        read += 1
        try:
            trip = _trip(row, found, zones or {})
        except (ValueError, TypeError, KeyError, IndexError, OverflowError):
            continue
        if trip is not None:
            kept.append(trip)
    aware = sum(begin.tzinfo is not None for begin, _, _ in kept)
    if 0 < aware < len(kept):
        log.warning("%s: %d of %d times tell an offset; the rarer kind is left out", path, aware, len(kept))
        kept = [trip for trip in kept if (trip[0].tzinfo is not None) == (2 * aware > len(kept))]
    if not kept:
        raise ValueError(f"{path}: none of its {read} rows has times, places and a fare that make sense")
    if len(kept) < read:
        log.warning(
            "%s: %d of %d rows left out, a value is missing or impossible", path, read - len(kept), read
        )
    midnight = min(begin for begin, _, _ in kept).replace(hour=0, minute=0, second=0, microsecond=0)
    seconds = np.array([[(t - midnight).total_seconds() for t in trip[:2]] for trip in kept])
    values = np.array([trip[2] for trip in kept])
    order = np.argsort(seconds[:, 0], kind="stable")
    seconds, values = seconds[order], values[order]
    return Trips(
        seconds[:, 0], seconds[:, 1], values[:, 0:2], values[:, 2:4], values[:, 4], read - len(kept), midnight
    )


def _trip(
    row: Sequence[Any], columns: Columns, zones: Mapping[int, Sequence[float]]
) -> tuple[datetime, datetime, list[float]] | None:
    """Begin, end, and (places, fare) of a row; None, or an error, if it cannot be used."""
    begin = time_of(row[columns.begin])
    if columns.end is not None:
        end = time_of(row[columns.end])
    elif columns.duration is not None:
        end = begin + timedelta(seconds=number_of(row[columns.duration]))
    if (begin.tzinfo is None) != (end.tzinfo is None) or end < begin:
        return None
    if columns.zoned:
        where = [float(x) for index in columns.places for x in zones[zone_of(row[index])]]
    else:
        where = [number_of(row[index]) for index in columns.places]
    minutes = (end - begin).total_seconds() / 60.0
    fare = minutes if columns.fare is None else number_of(row[columns.fare])
    good = is_place(*where[:2]) and is_place(*where[2:]) and fare > 0
    return (begin, end, [*where, fare]) if good else None


def read_zones(path: str | Path) -> dict[int, tuple[float, float]]:
    """Centres of zones, from a table with a number, a longitude and a latitude for each: the `zones` of `read_trips`.

    Parameters
    ----------
    path : str or Path
        CSV, gzipped CSV or Parquet, with the columns ``LocationID`` (or ``zone``, ``area_number``, ``id``),
        ``longitude`` and ``latitude`` (or ``lon`` and ``lat``).

    Raises
    ------
    FileNotFoundError
    ValueError
        If the file is damaged, a column is missing, or no row can be used.
    """
    path = Path(path)
    rows = table_rows(path)
    header = [str(name).strip().lower() for name in next(rows, ())]
    at = []
    for names in (
        ("locationid", "location_id", "area_number", "zone_id", "zone", "id"),
        ("longitude", "lon"),
        ("latitude", "lat"),
    ):
        index = next((header.index(name) for name in names if name in header), None)
        if index is None:
            raise ValueError(f"{path}: there is no column {names[0]} (there are {', '.join(header)})")
        at.append(index)
    zones = {}
    for row in rows:
        try:
            number, longitude, latitude = zone_of(row[at[0]]), number_of(row[at[1]]), number_of(row[at[2]])
        except (ValueError, TypeError, IndexError, OverflowError):
            continue
        if is_place(longitude, latitude):
            zones[number] = (longitude, latitude)
    if not zones:
        raise ValueError(f"{path}: none of its rows has a number, a longitude and a latitude")
    return zones
