"""From a trip table to a city: places on a grid, times in steps."""

from __future__ import annotations

import logging

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.domains.ride_hailing.city import City
from sapopt.domains.ride_hailing.trips import Trips

logger = logging.getLogger(__name__)

_CROWD = 0.1
"""Windows with less than this share of the fullest one's trips hold stray rows; a city's quietest hours have more."""

_KM_PER_DEGREE = 111.195
"""Length of one degree of latitude on a sphere of radius 6371 km."""


def city_from_trips(
    trips: Trips,
    drivers: int,
    *,
    start_s: float | None = None,
    steps: int = 60,
    step_s: float = 120.0,
    cell_km: float = 1.0,
    speed_km_h: float | None = None,
    patience: int = 4,
    seed: int = 0,
) -> City:
    """The trips of a stretch of time as requests to a fleet.

    Pick-ups and drop-offs are moved to the centres of square cells. A way takes its length along the grid divided by
    the speed, rounded up to whole steps. The drivers start where trips of the table begin (drawn with the seed).

    Parameters
    ----------
    trips : Trips
        See `read_trips`.
    drivers : int
        n.
    start_s : float, optional
        Second at which step 0 begins, as `Trips` counts them. If omitted, that of the first trip, or, where only stray
        trips lie near it (tables have rows of other months and years), of the first one from which on trips come at
        a tenth of their highest rate; the log says how many are left out before it.
    steps, step_s : int, float
        T, and the seconds of a step.
    cell_km : float
        Side of a cell.
    speed_km_h : float, optional
        The median speed of the trips along the grid if omitted.
    patience : int
        Most steps between a request and its pick-up.
    seed : int

    Raises
    ------
    ValueError
        If an argument is out of range, or no trip begins in that time.
    """
    for name, value in (("step_s", step_s), ("cell_km", cell_km)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value!r}")
    for name, whole in (("drivers", drivers), ("steps", steps)):
        if int(whole) != whole or whole < 1:
            raise ValueError(f"{name} must be a whole number of at least 1, got {whole!r}")
    begin = _begin(trips, steps * step_s) if start_s is None else float(start_s)
    if not np.isfinite(begin):
        raise ValueError(f"start_s must be a finite number of seconds, got {start_s!r}")
    step = np.floor((trips.pick_up_s - begin) / step_s).astype(np.int64)
    chosen = np.flatnonzero((step >= 0) & (step < steps))
    if len(chosen) == 0:
        raise ValueError(
            f"start_s: no trip begins between {trips.told(begin)} and {trips.told(begin + steps * step_s)}; the table "
            f"goes from {trips.told(trips.pick_up_s[0])} to {trips.told(trips.pick_up_s[-1])}"
        )
    ends_deg = np.concatenate([trips.pick_up_deg[chosen], trips.drop_off_deg[chosen]])
    ends_km = _flat_km(ends_deg)
    cells, place = np.unique(np.floor(ends_km / cell_km).astype(np.int64), axis=0, return_inverse=True)
    places_km = np.asarray((cells + 0.5) * cell_km, dtype=np.float64)
    pick_up, drop_off = place.reshape(2, -1)
    speed = _speed_km_h(trips, chosen, ends_km) if speed_km_h is None else float(speed_km_h)
    if not (np.isfinite(speed) and speed > 0):
        raise ValueError(
            f"speed_km_h must be positive, got {speed!r} (the median of the trips, if none was given)"
        )
    way_km = np.abs(places_km[:, None] - places_km[None]).sum(axis=2)
    # A hair less, so that a way of exactly q steps does not become q + 1 by rounding.
    travel = np.ceil(way_km / (speed * step_s / 3600.0) - 1e-9).astype(np.int64)
    home = np.random.default_rng(seed).choice(pick_up, int(drivers))
    return City(
        places_km, travel, step[chosen], pick_up, drop_off, trips.fare[chosen], home, int(steps), float(step_s),
        int(patience),
    )  # fmt: skip


def _begin(trips: Trips, window_s: float) -> float:
    """Where the trips are: the first pick-up whose window holds a tenth of the trips of the fullest one."""
    times = trips.pick_up_s
    within = np.searchsorted(times, times + window_s, side="left") - np.arange(len(times))
    first = int(np.argmax(within >= _CROWD * within.max()))
    if first:
        logger.warning(
            "start_s: step 0 begins at %s; %d trips before it are left out, the first at %s",
            trips.told(times[first]),
            first,
            trips.told(times[0]),
        )
    return float(times[first])


def _flat_km(degrees: FloatArray) -> FloatArray:
    """East and north of points near each other; the scale is that of their mean latitude."""
    longitude, latitude = degrees.T
    scale = np.cos(np.radians(latitude.mean()))
    return _KM_PER_DEGREE * np.stack(
        [(longitude - longitude.min()) * scale, latitude - latitude.min()], axis=1
    )


def _speed_km_h(trips: Trips, chosen: np.ndarray, ends_km: FloatArray) -> float:
    way_km = np.abs(ends_km[: len(chosen)] - ends_km[len(chosen) :]).sum(axis=1)
    hours = (trips.drop_off_s[chosen] - trips.pick_up_s[chosen]) / 3600.0
    moved = (hours > 0) & (way_km > 0)
    return float(np.median(way_km[moved] / hours[moved])) if moved.any() else float("nan")
