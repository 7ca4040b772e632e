"""How the page tells times: as short as they can be without a doubt."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Any

from sapopt.data.times import Time, step_ends
from sapopt.problem.sap import SAP


def told_times(problem: SAP) -> dict[str, Any]:
    """When every step begins, and when the last one ends; None where steps are only counted.

    A zone that all have in common is said once (``zone``). Steps of whole days (``days``) are told by their dates.
    """
    if problem.times is None:
        return {"times": None, "zone": "", "days": False}
    end = step_ends(problem.times)[-1]
    moments = [time for time in (*problem.times, end) if isinstance(time, datetime)]
    days = all((time.hour, time.minute, time.second, time.microsecond) == (0, 0, 0, 0) for time in moments)
    offsets = {time.utcoffset() for time in moments}
    shared = len(offsets) == 1 and None not in offsets
    zone = ("UTC" + moments[0].isoformat("T", "seconds")[19:]).replace("UTC+00:00", "UTC") if shared else ""
    told = [_moment(time, days, shared) for time in (*problem.times, end) if time is not None]
    if end is None:
        told.append("the end")
    return {"times": told, "zone": "" if days else zone, "days": days and len(moments) == len(told)}


def _moment(time: Time, day: bool, bare: bool) -> str:
    """A time to the minute, or to the second where it has some; its date alone for a whole `day`."""
    if not isinstance(time, datetime):
        return str(time)
    if day:
        return time.date().isoformat()
    exact = "seconds" if time.second or time.microsecond else "minutes"
    return (time.replace(tzinfo=None) if bare else time).isoformat(" ", exact)


def told_limit(problem: SAP, name: str) -> str:
    """A limit's name with its step as the page tells steps: by its time, or counted from 1."""
    found = re.search(r"step (\d+)\]$", name)
    if found is None:
        return name
    k = int(found.group(1))
    when = f"step {k + 1}" if problem.times is None else told_times(problem)["times"][k]
    return f"{name[: found.start()]}{when}]"
