"""Times of orbit messages: the ASCII time codes of CCSDS 301.0-B-4, calendar and day of the year."""

from __future__ import annotations

import calendar
import re
from datetime import date

_FORM = re.compile(
    r"(\d{4})-(?:(\d\d)-(\d\d)|(\d{3}))[T ](\d\d):(\d\d):(\d\d)(?:[.,](\d*))?\s*(?:Z|([+-])(\d\d):?(\d\d))?",
    flags=re.ASCII | re.IGNORECASE,
)
_EPOCH = date(1949, 12, 31).toordinal()
"""SGP4 counts its days from 0 h on this date."""


def utc_days(text: str) -> tuple[int, float]:
    """Days since 0 h UTC on 31 December 1949: the whole ones, and the part of the last.

    Parameters
    ----------
    text : str
        ``2020-03-04T10:34:41.4264``, ``2020-064T10:34:41.4264`` (day of the year), with any number of decimals or
        none, with ``Z``, an offset from UTC (``+01:00``, ``+0100``), or nothing, which means UTC.

    Raises
    ------
    ValueError
        If it is no such time, or there is no such day.

    Notes
    -----
    A leap second (``23:59:60``) is read as the first second of the next day: SGP4 knows days of 86 400 s only.
    """
    found = _FORM.fullmatch(text.strip())
    if found is None:
        raise ValueError(
            f"{text!r} is no time of the form 2020-03-04T10:34:41.4264 or 2020-064T10:34:41.4264 (day of the year)"
        )
    year, month, day, of_year, hour, minute, second, decimals, sign, off_hour, off_minute = found.groups()
    days = _day(text, int(year), month, day, of_year)
    leap = (hour, minute, second) == ("23", "59", "60") or (
        off_hour is not None and second == "60" and minute == "59"
    )
    if int(hour) > 23 or int(minute) > 59 or (int(second) > 59 and not leap):
        raise ValueError(f"{text!r}: there is no such time of day")
    if off_hour is not None and (int(off_hour) > 23 or int(off_minute) > 59):
        raise ValueError(f"{text!r}: there is no such offset from UTC")
    offset = 0 if sign is None else (3600 * int(off_hour) + 60 * int(off_minute)) * (1 if sign == "+" else -1)
    # Whole seconds as integers: the decimals keep all the digits that a float has.
    more, seconds = divmod(3600 * int(hour) + 60 * int(minute) + int(second) - offset, 86400)
    return days + more, (seconds + float(f"0.{decimals or '0'}")) / 86400.0


def _day(text: str, year: int, month: str | None, day: str | None, of_year: str | None) -> int:
    if year < 1:
        raise ValueError(f"{text!r}: there is no year 0000")
    if of_year is None:
        try:
            return date(year, int(month or 0), int(day or 0)).toordinal() - _EPOCH
        except ValueError:
            raise ValueError(f"{text!r}: there is no such day") from None
    if not 1 <= int(of_year) <= 365 + calendar.isleap(year):
        raise ValueError(f"{text!r}: {year} has no day {of_year}")
    return date(year, 1, 1).toordinal() - 1 + int(of_year) - _EPOCH
