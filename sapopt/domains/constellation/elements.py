"""Real satellites: element sets (TLE or OMM) read from files and propagated with SGP4."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sapopt.data.textfile import read_text
from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.constellation.earth import EARTH_RADIUS_KM, greenwich_sidereal_rad, turn_about_pole
from sapopt.domains.constellation.orbits import Earth, step_times_s

if TYPE_CHECKING:
    from sgp4.api import Satrec

logger = logging.getLogger(__name__)

_STALE_DAYS = 30.0
"""SGP4 loses its accuracy within weeks."""


@dataclass(frozen=True, eq=False)
class ElementSets:
    """Element sets of satellites, one per satellite.

    Attributes
    ----------
    names : tuple of str
        Name of each satellite; its catalogue number if the file has none.
    satellites : tuple of sgp4.api.Satrec
    numbers : tuple of int, optional
        Catalogue number of each satellite, of up to nine digits; 0 where the file tells none. A `Satrec` can hold no
        number above 339 999 (its ``satnum`` is 0 there). Those of `satellites` if omitted.
    """

    names: tuple[str, ...]
    satellites: tuple[Satrec, ...]
    numbers: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.numbers:
            object.__setattr__(self, "numbers", tuple(s.satnum for s in self.satellites))
        for name in ("satellites", "numbers"):
            if len(getattr(self, name)) != len(self.names):
                raise ValueError(f"{name} has {len(getattr(self, name))} entries for {len(self.names)} names")

    @property
    def n(self) -> int:
        """Number of satellites."""
        return len(self.names)

    @property
    def latest_epoch(self) -> datetime:
        """Epoch of the newest element set, UTC."""
        newest = max(self.satellites, key=lambda s: s.jdsatepoch + s.jdsatepochF)
        days = (newest.jdsatepoch - 2451545.0) + newest.jdsatepochF
        return datetime(2000, 1, 1, 12, tzinfo=UTC) + timedelta(days=days)

    def take(self, indices: Sequence[int] | IntArray) -> ElementSets:
        """The satellites of these indices, in this order."""
        return ElementSets(
            tuple(self.names[i] for i in indices),
            tuple(self.satellites[i] for i in indices),
            tuple(self.numbers[i] for i in indices),
        )

    def named(self, prefix: str) -> ElementSets:
        """The satellites whose name starts with `prefix`; raises ValueError if there is none."""
        chosen = [i for i, name in enumerate(self.names) if name.startswith(prefix)]
        if not chosen:
            raise ValueError(
                f"prefix: no name starts with {prefix!r}; the first satellite is called {self.names[0]!r}"
            )
        return self.take(chosen)


def starlink_elements() -> ElementSets:
    """The Starlink satellites of the element sets of 14 June 2023 that come with the package.

    The file lists 4228 objects. Debris and other operators' satellites that were launched along with them are left
    out by their names.
    """
    path = Path(str(files("sapopt.domains") / "data" / "starlink_2023-06.tle"))
    return read_elements(path).named("STARLINK")


def read_elements(path: str | Path) -> ElementSets:
    """Read a file of element sets.

    The content tells the format, not the suffix: TLE, with or without name lines, or OMM (orbit mean-elements messages,
    CCSDS 502.0-B-3) as KVN, XML, JSON or CSV, the way the standard, CelesTrak and Space-Track write them. Of several
    element sets of the same satellite (catalogue number, else name) the newest is kept.

    Raises
    ------
    ValueError
        If the file is empty or damaged, or holds elements of another theory than SGP4; the message names file and line.
    FileNotFoundError
        If there is no such file.
    """
    from sapopt.domains.constellation.omm import omm_records
    from sapopt.domains.constellation.omm_forms import kind_of
    from sapopt.domains.constellation.tle import tle_records

    path = Path(path)
    text = read_text(path)
    if not text.strip():
        raise ValueError(f"{path}: the file is empty; expected TLE or OMM element sets")
    kind = kind_of(text, path.suffix.lower().lstrip("."))
    records = tle_records(text, str(path)) if kind == "tle" else omm_records(text, kind, str(path))
    newest: dict[int | str, tuple[str, int, Satrec]] = {}
    count = 0
    for name, number, satellite in records:
        count += 1
        known = newest.get(number or name)
        if known is None or _epoch(satellite) > _epoch(known[2]):
            newest[number or name] = (name or str(number), number, satellite)
    if not newest:
        raise ValueError(f"{path}: no element set found; expected TLE or OMM element sets")
    if len(newest) < count:
        logger.warning(
            "%s: kept the newest of several element sets of %d satellites", path, count - len(newest)
        )
    names, numbers, satellites = zip(*newest.values(), strict=True)
    return ElementSets(tuple(names), tuple(satellites), tuple(numbers))


def element_positions_km(
    elements: ElementSets,
    steps: int,
    step_s: float,
    *,
    start: datetime | None = None,
    earth: Earth = "rotating",
) -> tuple[FloatArray, IntArray]:
    """Earth-fixed positions of real satellites, by SGP4.

    SGP4's inertial frame (TEME) is turned by Greenwich mean sidereal time; polar motion and the difference between
    UTC and UT1 (less than 0.5 km on the ground) are left out. Satellites that SGP4 cannot propagate over the whole
    time, or that are below the ground (decayed), are left out with a warning in the log that names them.

    Parameters
    ----------
    elements : ElementSets
    steps : int
        Number of steps T.
    step_s : float
        Seconds from one step to the next.
    start : datetime, optional
        Time of the first step; UTC if it has no time zone. By default the epoch of the newest element set.
    earth : {"rotating", "still"}
        "still" stops the Earth at the first step.

    Returns
    -------
    positions_km : ndarray of float64, shape (T, n, 3)
    kept : ndarray of int, shape (n,)
        Index into `elements` of each of the satellites.

    Raises
    ------
    ValueError
        If an argument is out of range, or no satellite is left.
    """
    from sgp4.api import SGP4_ERRORS, SatrecArray

    if earth not in ("still", "rotating"):
        raise ValueError(f"earth must be 'still' or 'rotating', got {earth!r}")
    offset_days = step_times_s(steps, step_s) / 86400.0
    whole, part = _julian_day(elements.latest_epoch if start is None else start)
    days = part + offset_days
    error, position, _ = SatrecArray(list(elements.satellites)).sgp4(np.full(len(days), whole), days)
    low = np.linalg.norm(position, axis=2) <= EARTH_RADIUS_KM
    bad = ((error != 0) | low).any(axis=1)
    for i in np.flatnonzero(bad):
        reasons = error[i][error[i] != 0]
        why = SGP4_ERRORS.get(int(reasons[0]), "unknown error") if len(reasons) else "below the ground"
        logger.warning("left out satellite %s: %s", elements.names[i], why)
    kept = np.flatnonzero(~bad)
    if len(kept) == 0:
        raise ValueError(
            f"start: SGP4 can propagate none of the {elements.n} satellites to the time of the problem; "
            "choose a start near the epoch of the element sets"
        )
    age = np.array([abs(whole + part - _epoch(elements.satellites[i])) for i in kept])
    if age.max() > _STALE_DAYS:
        logger.warning(
            "%d element sets are more than %g days away from the start; SGP4 is inaccurate there",
            int((age > _STALE_DAYS).sum()),
            _STALE_DAYS,
        )
    dates = whole + days
    angle = greenwich_sidereal_rad(dates if earth == "rotating" else dates[:1])
    return turn_about_pole(np.ascontiguousarray(position[kept].transpose(1, 0, 2)), angle), kept


def _epoch(satellite: Satrec) -> float:
    return float(satellite.jdsatepoch + satellite.jdsatepochF)


def _julian_day(time: datetime) -> tuple[float, float]:
    """Whole and fractional part of the Julian date (UTC)."""
    if time.tzinfo is None:
        time = time.replace(tzinfo=UTC)
    days = (time - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1)
    return 2451545.0 + np.floor(days), float(days - np.floor(days))
