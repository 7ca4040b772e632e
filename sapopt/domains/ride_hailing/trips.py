"""Public trip tables: when and where rides began and ended, and what they cost."""

from __future__ import annotations

import csv
import gzip
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray

log = logging.getLogger(__name__)

# Names in the tables of the New York taxi commission over the years, lower case, the usual one first.
_NAMES: dict[str, tuple[str, ...]] = {
    "pick_up_time": (
        "tpep_pickup_datetime", "lpep_pickup_datetime", "pickup_datetime", "trip_pickup_datetime",
    ),
    "drop_off_time": (
        "tpep_dropoff_datetime", "lpep_dropoff_datetime", "dropoff_datetime", "trip_dropoff_datetime",
    ),
    "pick_up_longitude": ("pickup_longitude", "start_lon"),
    "pick_up_latitude": ("pickup_latitude", "start_lat"),
    "drop_off_longitude": ("dropoff_longitude", "end_lon"),
    "drop_off_latitude": ("dropoff_latitude", "end_lat"),
    "fare": ("fare_amount", "fare_amt", "base_passenger_fare", "total_amount", "total_amt"),
}  # fmt: skip
_ZONES: dict[str, tuple[str, ...]] = {
    "pick_up_zone": ("pulocationid",),
    "drop_off_zone": ("dolocationid",),
}


class MissingReaderError(ImportError):
    """An optional package is not installed; the message names the extra that brings it."""


@dataclass(frozen=True, eq=False)
class Trips:
    """Trips of a table, in the order of their pick-ups.

    Attributes
    ----------
    pick_up_s, drop_off_s : ndarray, shape (R,)
        Seconds since the table's first midnight.
    pick_up_deg, drop_off_deg : ndarray, shape (R, 2)
        Longitude and latitude.
    fare : ndarray, shape (R,)
    dropped : int
        Rows that were left out because a value is missing or impossible.
    """

    pick_up_s: FloatArray
    drop_off_s: FloatArray
    pick_up_deg: FloatArray
    drop_off_deg: FloatArray
    fare: FloatArray
    dropped: int = 0

    def __len__(self) -> int:
        return len(self.fare)


def read_trips(
    path: str | Path,
    *,
    columns: Mapping[str, str] | None = None,
    zones: Mapping[int, Sequence[float]] | None = None,
    limit: int | None = None,
) -> Trips:
    """Read a trip table with pick-up and drop-off times and places, such as those of the New York taxi commission.

    Parameters
    ----------
    path : str or Path
        ``.csv``, ``.csv.gz`` or ``.parquet`` (this one needs the extra ``tables``).
    columns : mapping of str to str, optional
        Names of the columns where they are not the usual ones; keys are ``pick_up_time``, ``drop_off_time``,
        ``pick_up_longitude``, ``pick_up_latitude``, ``drop_off_longitude``, ``drop_off_latitude`` and ``fare``.
    zones : mapping of int to (longitude, latitude), optional
        Centres of the zones, for tables that tell zones in place of coordinates (``PULocationID``, ``DOLocationID``).
    limit : int, optional
        Read at most this many rows.

    Returns
    -------
    Trips
        Rows without a time, place, fare, or with an end before the start, are left out and counted.

    Raises
    ------
    FileNotFoundError
    ValueError
        If a column is missing, or no row can be used.
    MissingReaderError
        If a Parquet file is given and pyarrow is not installed.
    """
    path = Path(path)
    if limit is not None and limit < 1:
        raise ValueError(f"limit must be at least 1, got {limit!r}")
    rows = _parquet_rows(path) if path.suffix.lower() == ".parquet" else _csv_rows(path)
    header = next(rows, None)
    if header is None:
        raise ValueError(f"{path}: the table is empty")
    place = _places(path, [str(name) for name in header], columns or {}, zones is not None)
    kept: list[list[float]] = []
    times: list[tuple[datetime, datetime]] = []
    read = 0
    for row in rows:
        if limit is not None and read >= limit:
            break
        read += 1
        try:
            begin, end = (_time(row[place[name]]) for name in ("pick_up_time", "drop_off_time"))
            if zones is None:
                where = [float(row[place[name]]) for name in list(_NAMES)[2:6]]
            else:
                where = [float(x) for name in _ZONES for x in zones[int(row[place[name]])]]
            fare = float(row[place["fare"]])
        except (ValueError, TypeError, KeyError, IndexError):
            continue
        if end >= begin and _possible(where) and math.isfinite(fare) and fare > 0:
            times.append((begin, end))
            kept.append([*where, fare])
    if not kept:
        raise ValueError(f"{path}: none of its {read} rows has times, places and a fare that make sense")
    if len(kept) < read:
        log.warning(
            "%s: %d of %d rows left out, a value is missing or impossible", path, read - len(kept), read
        )
    first = min(begin for begin, _ in times).replace(hour=0, minute=0, second=0, microsecond=0)
    seconds = np.array([[(t - first).total_seconds() for t in pair] for pair in times])
    values = np.array(kept)
    order = np.argsort(seconds[:, 0], kind="stable")
    seconds, values = seconds[order], values[order]
    return Trips(seconds[:, 0], seconds[:, 1], values[:, 0:2], values[:, 2:4], values[:, 4], read - len(kept))


def _csv_rows(path: Path) -> Iterator[Sequence[Any]]:
    opener: Any = gzip.open if path.suffix.lower() == ".gz" else open
    with opener(path, "rt", newline="", encoding="utf-8-sig") as file:
        yield from (row for row in csv.reader(file) if row)


def _parquet_rows(path: Path) -> Iterator[Sequence[Any]]:
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise MissingReaderError(
            "Parquet files need pyarrow: pip install 'sapopt[tables]' (CSV needs nothing)"
        ) from None
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        with parquet.ParquetFile(path) as table:
            yield table.schema_arrow.names
            for batch in table.iter_batches():
                yield from zip(*(column.to_pylist() for column in batch.columns), strict=True)
    except OSError as error:  # pyarrow's error for a damaged file is a ValueError, for a cut one an OSError
        raise ValueError(f"{path}: damaged or no Parquet file ({error})") from None


def _places(path: Path, header: list[str], columns: Mapping[str, str], zones: bool) -> dict[str, int]:
    """Index of every column that is needed."""
    known = {name.strip().lower(): index for index, name in reversed(list(enumerate(header)))}
    wanted = dict(_NAMES)
    if zones:
        wanted = {name: wanted[name] for name in ("pick_up_time", "drop_off_time", "fare")} | _ZONES
    if unknown := set(columns) - set(wanted):
        raise ValueError(f"columns: {sorted(unknown)[0]!r} is none of {', '.join(wanted)}")
    out = {}
    for key, usual in wanted.items():
        names = (columns[key].lower(),) if key in columns else usual
        found = next((known[name] for name in names if name in known), None)
        if found is None and not zones and any(name in known for name in ("pulocationid", "dolocationid")):
            raise ValueError(
                f"{path}: the table tells zones, not coordinates; pass zones={{id: (longitude, latitude)}} with the "
                "centres of the zones"
            )
        if found is None:
            raise ValueError(
                f"{path}: there is no column for {key} (looked for {', '.join(names)}; there are "
                f"{', '.join(header)}); name it with columns={{{key!r}: ...}}"
            )
        out[key] = found
    return out


def _time(value: Any) -> datetime:
    time = value if isinstance(value, datetime) else datetime.fromisoformat(str(value).strip())
    return time.replace(tzinfo=None)


def _possible(where: list[float]) -> bool:
    """Whether longitudes and latitudes are on the globe; exactly (0, 0) is how these tables say "unknown"."""
    pairs = (where[:2], where[2:])
    return all(abs(lon) <= 180 and abs(lat) <= 90 and (lon, lat) != (0.0, 0.0) for lon, lat in pairs)
