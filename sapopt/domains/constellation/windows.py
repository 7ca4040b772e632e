"""Time windows of tasks on the ground: outside of its own a task is worth nothing, whoever sees it."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.tables import Table, missing
from sapopt.data.times import as_text, moment

if TYPE_CHECKING:
    from sapopt.data.benefits import Benefits

Window = tuple[datetime | None, datetime | None]
"""From when, and until when, a task is wanted; None where it has no such end."""


def checked_windows(windows: Any, m: int) -> tuple[Window, ...]:
    """The windows of m tasks, or none at all; times without a zone are UTC.

    Raises
    ------
    ValueError
        If they are not one for each task, an end is no time, or a window ends before it begins.
    """
    if not isinstance(windows, Sequence) or isinstance(windows, str) or len(windows) not in (0, m):
        raise ValueError(f"windows must be one pair of times for each of {m} tasks, or none, got {windows!r}")
    out = []
    for task, window in enumerate(windows):
        if not isinstance(window, Sequence) or isinstance(window, str) or len(window) != 2:
            raise ValueError(f"windows: task {task} must have two times, got {window!r}")
        opens, closes = (_zoned(time, f"windows: task {task}") for time in window)
        if opens is not None and closes is not None and closes <= opens:
            raise ValueError(
                f"windows: task {task} ends at {as_text(closes)}, not after its beginning at {as_text(opens)}"
            )
        out.append((opens, closes))
    return tuple(out)


def windows_of_table(table: Table, opens: str | None, closes: str | None) -> tuple[Window, ...]:
    """The windows in two columns of a table; an empty cell leaves that end open."""
    if opens is None and closes is None:
        return ()
    known = {name: table.values(name) for name in (opens, closes) if name is not None}
    nothing: list[Any] = [None] * len(next(iter(known.values())))
    sides = [nothing if name is None else known[name] for name in (opens, closes)]
    out = []
    for row, ends in enumerate(zip(*sides, strict=True)):
        first, last = (
            _zoned(time, f"{name}: row {row} (counted from 0)")
            for time, name in zip(ends, (opens, closes), strict=True)
        )
        if first is not None and last is not None and last <= first:
            raise ValueError(f"{closes}: row {row} (counted from 0) ends before it begins ({opens})")
        out.append((first, last))
    return tuple(out)


def _zoned(time: Any, where: str) -> datetime | None:
    if missing(time) or time == "":
        return None
    try:
        found = moment(time)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    if not isinstance(found, datetime):
        raise ValueError(f"{where}: {time!r} is no date and time, such as 2026-03-01T10:00Z")
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found


def within(benefits: Benefits, windows: Sequence[Window], start: datetime, step_s: float) -> Benefits:
    """The benefits without what lies outside of the tasks' windows.

    Parameters
    ----------
    benefits : Benefits
        Sparse, shape (T, n, m).
    windows : sequence of m pairs of datetime or None
        A step counts if it begins in the window: at its opening or later, and before its end.
    start : datetime
        Of the first step, with a zone.
    step_s : float
        Seconds from one step to the next.
    """
    from sapopt.data.benefits import Benefits as Made

    T, n, m = benefits.shape
    first, stop = np.zeros(m), np.full(m, np.inf)
    for task, (opens, closes) in enumerate(windows):
        if opens is not None:
            first[task] = (opens - start) / timedelta(seconds=1)
        if closes is not None:
            stop[task] = (closes - start) / timedelta(seconds=1)
    flat = benefits.flat()
    row = np.repeat(np.arange(T * n), np.diff(flat.indptr))
    seconds = row // n * step_s
    # A thousandth of a second is given for steps whose length is no exact number.
    keep = (seconds >= first[flat.indices] - 1e-3) & (seconds < stop[flat.indices] - 1e-3)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row[keep], minlength=T * n))])
    return Made.from_flat(indptr.astype(flat.indptr.dtype), flat.indices[keep], flat.data[keep], (T, n, m))
