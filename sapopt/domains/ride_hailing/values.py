"""What single fields of trip tables mean: times, numbers, zones, places."""

from __future__ import annotations

import math
import re
from datetime import UTC, date, datetime, timedelta
from typing import Any

from sapopt.data.textfile import plain_number

_AMERICAN = re.compile(
    r"(\d{1,2})/(\d{1,2})/(\d{4}) (\d{1,2}):(\d\d)(?::(\d\d))? ?([AP]M)?", re.ASCII | re.IGNORECASE
)
_UNIX = re.compile(r"\d{9,10}(?:\.\d*)?", re.ASCII)


def time_of(value: Any) -> datetime:
    """The time that a field tells: in UTC if it has a time zone or an offset, else without a zone.

    ISO 8601 with or without an offset, ``09/30/2013 07:15:00 AM`` (Chicago), and seconds since 1970 are known.

    Raises
    ------
    ValueError
        If it is no time.
    """
    if isinstance(value, datetime):
        return _instant(value)
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day)
    text = str(value).strip()
    if _UNIX.fullmatch(text):
        return datetime(1970, 1, 1) + timedelta(seconds=float(text))
    if found := _AMERICAN.fullmatch(text):
        month, day, year, hour, minute, second, half = found.groups()
        hours = int(hour) if half is None else int(hour) % 12 + (12 if half.upper() == "PM" else 0)
        if half is not None and not 1 <= int(hour) <= 12:
            raise ValueError(f"{text!r}: there is no such time of day")
        return datetime(int(year), int(month), int(day), hours, int(minute), int(second or 0))
    if not re.match(r"\d{4}-?\d\d-?\d\d[T ]", text, re.ASCII | re.IGNORECASE):
        raise ValueError(f"{text!r} is no time")
    return _instant(datetime.fromisoformat(text))


def _instant(time: datetime) -> datetime:
    # Two times of one zone are subtracted by their clocks, not as instants, unless they are turned into UTC first.
    return time if time.tzinfo is None else time.astimezone(UTC)


def number_of(value: Any) -> float:
    """A finite number; text may have a dollar sign and commas between thousands.

    Raises
    ------
    ValueError
        If it is none.
    """
    if isinstance(value, str):
        text = re.sub(r"^\$|(?<=\d),(?=\d{3}(?:\D|$))", "", value.strip())
        return plain_number(text)
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value!r} is not finite")
    return number


def zone_of(value: Any) -> int:
    """The number of a zone; tables with gaps write ``132.0`` for 132.

    Raises
    ------
    ValueError
        If it is no whole number: 132.9 is no zone.
    """
    number = number_of(value)
    if not number.is_integer():
        raise ValueError(f"{value!r} is no whole number")
    return int(number)


def is_place(longitude: float, latitude: float) -> bool:
    """Whether a pair is on the globe and known: a zero is how these tables say "unknown", and one may stand alone."""
    return 0 < abs(longitude) <= 180 and 0 < abs(latitude) <= 90
