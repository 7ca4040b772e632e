"""When steps begin: time stamps or numbers, in ascending order.

Time stamps with a zone are compared as moments and shown in the zone they came in. Python compares two stamps of one
zone by their wall clocks, which read alike twice in the night when the clocks are set back; so whatever is compared or
subtracted here is turned to UTC first.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Mapping
from datetime import UTC, date, datetime, timedelta, timezone
from typing import Any, Protocol, runtime_checkable
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

Time = datetime | int | float
"""A time stamp (with a zone or without) or a number."""


@runtime_checkable
class _Fine(Protocol):
    """A time stamp that counts nanoseconds, as those of pandas do."""

    @property
    def nanosecond(self) -> int:
        """Nanoseconds beyond the microsecond."""


def moment(value: Any) -> Time:
    """A time stamp or number as Python's own.

    Parameters
    ----------
    value : datetime, date, numpy.datetime64, number or str
        Texts are ISO 8601, for example ``2026-03-01T06:00+01:00``; a date is its midnight.

    Raises
    ------
    ValueError
        If it is none of these, not finite, or finer than a microsecond.
    """
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value.strip())
        except ValueError:
            raise ValueError(
                f"{value!r} is neither a number nor a time such as 2026-03-01T06:00+01:00 (ISO 8601)"
            ) from None
    if isinstance(value, np.datetime64):
        whole = value.astype("datetime64[us]")
        if np.isnat(value) or whole != value:
            raise ValueError(f"{value!r} is no time in whole microseconds")
        value = whole.item()
    if isinstance(value, datetime):
        return _own(value)
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day)
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Real):
        raise ValueError(f"{value!r} is neither a number nor a time")
    if isinstance(value, numbers.Integral):
        return int(value)
    if not math.isfinite(value):
        raise ValueError(f"{value!r} is not finite")
    number = float(value)
    return int(number) if number.is_integer() else number


def _own(value: datetime) -> datetime:
    if isinstance(value, _Fine) and value.nanosecond:
        raise ValueError(f"{value!r} is no time in whole microseconds")
    return datetime(
        value.year, value.month, value.day, value.hour, value.minute, value.second, value.microsecond, value.tzinfo,
        fold=value.fold,
    )  # fmt: skip


def instant(time: Time) -> Any:
    """What to compare and subtract: a stamp with a zone in UTC, everything else as it is."""
    return time.astimezone(UTC) if isinstance(time, datetime) and time.tzinfo is not None else time


def kind_of(time: Time) -> str:
    """What a time is, in words: only times of one kind can be compared."""
    if not isinstance(time, datetime):
        return "a number"
    return "a time without a zone" if time.tzinfo is None else "a time with a zone"


def check_one_kind(times: Iterable[Time], name: str) -> None:
    """Raise a ValueError if numbers, times with a zone and times without are mixed."""
    first: Time | None = None
    for time in times:
        if first is None:
            first = time
        elif kind_of(time) != kind_of(first):
            raise ValueError(f"{name}: {first} is {kind_of(first)}, {time} is {kind_of(time)}; use one kind")


def checked_times(times: Any, T: int) -> tuple[Time, ...] | None:
    """The times of T steps, or None.

    Raises
    ------
    ValueError
        If they are not T times of one kind in ascending order.
    """
    if times is None:
        return None
    if isinstance(times, (str, Mapping)) or not isinstance(times, Iterable):
        raise ValueError(f"times must be a list of {T} time stamps or numbers, got {times!r}")
    out: list[Time] = []
    for k, value in enumerate(times):
        try:
            out.append(moment(value))
        except ValueError as error:
            raise ValueError(f"times: step {k}: {error}") from None
    if len(out) != T:
        raise ValueError(f"times: {len(out)} times for {T} steps")
    check_one_kind(out, "times")
    for k in range(1, T):
        if not instant(out[k - 1]) < instant(out[k]):
            raise ValueError(f"times: step {k} begins at {out[k]}, not after step {k - 1} ({out[k - 1]})")
    return tuple(out)


def step_ends(times: tuple[Time, ...]) -> list[Time | None]:
    """When every step ends: where the next begins; the last one lasts as long as the one before.

    A single step with a time stamp has no known end.
    """
    last = times[-1]
    if not isinstance(last, datetime):
        before = times[-2] if len(times) > 1 else last - 1
        assert not isinstance(before, datetime)
        return [*times[1:], last + (last - before)]
    if len(times) == 1:
        return [None]
    end: Any = instant(last) - instant(times[-2]) + instant(last)
    return [*times[1:], end.astimezone(last.tzinfo) if last.tzinfo is not None else end]


def as_text(time: Time | None) -> str | int | float | None:
    """A time for files of text: ISO 8601 for stamps."""
    return time.isoformat() if isinstance(time, datetime) else time


def described_times(times: tuple[Time, ...] | None) -> dict[str, Any]:
    """Times as plain values for files; nothing where there are none."""
    if times is None:
        return {}
    zones = {_key(time) for time in times}
    zone = zones.pop() if len(zones) == 1 else None
    return {"times": [as_text(time) for time in times], "zone": zone}


def _key(time: Time) -> str | None:
    """The name of a stamp's zone, where it has one."""
    zone = time.tzinfo if isinstance(time, datetime) else None
    return (
        zone.key if isinstance(zone, ZoneInfo) else "UTC" if zone in (UTC, timezone(timedelta(0))) else None
    )


def rebuilt_times(meta: Mapping[str, Any]) -> list[Time] | None:
    """Undo `described_times`; a zone that this machine does not know leaves the stamps with their offsets from UTC."""
    if meta.get("times") is None:
        return None
    times = [moment(value) for value in meta["times"]]
    try:
        zone = {None: None, "UTC": UTC}.get(meta.get("zone")) or (meta.get("zone") and ZoneInfo(meta["zone"]))
    except (ZoneInfoNotFoundError, ValueError, OSError):
        return times
    return [time.astimezone(zone) if zone and isinstance(time, datetime) else time for time in times]
