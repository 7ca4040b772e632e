"""Objects that appear without notice, move, and disappear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.constellation.earth import EARTH_RADIUS_KM
from sapopt.domains.tracking.regions import Regions

_KM_PER_DEG = EARTH_RADIUS_KM * np.pi / 180.0


@dataclass(frozen=True, eq=False)
class Objects:
    """Where objects are, step by step.

    Attributes
    ----------
    region : ndarray of int, shape (T, N)
        Region that object o is in at step k; -1 before it appears and after it is gone.
    latitude_deg, longitude_deg, heading_deg : ndarray, shape (T, N)
        Place and direction of travel (clockwise from north), NaN where there is no object.
    speed_km_per_step : ndarray, shape (N,)
    """

    region: IntArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    heading_deg: FloatArray
    speed_km_per_step: FloatArray

    def counts(self, regions: int) -> IntArray:
        """Number of objects in every region at every step, shape ``(T, regions)``."""
        out = np.zeros((len(self.region), regions), dtype=np.int64)
        for k, row in enumerate(self.region):
            out[k] = np.bincount(row[row >= 0], minlength=regions)
        return out

    def predicted(self, k: int, steps: int, regions: Regions) -> IntArray:
        """Expected objects per region at the steps ``k .. k + steps - 1`` as known at step k, ``(steps, regions)``.

        Objects that are there go straight on; turns, ends and newcomers are not foreseen.
        """
        there = np.flatnonzero(self.region[k] >= 0)
        out = np.zeros((steps, len(regions)), dtype=np.int64)
        out[0] = np.bincount(self.region[k, there], minlength=len(regions))
        place = self.latitude_deg[k, there], self.longitude_deg[k, there]
        for ahead in range(1, steps):
            place = moved(*place, self.heading_deg[k, there], self.speed_km_per_step[there])
            region = regions.containing(*place)
            out[ahead] = np.bincount(region[region >= 0], minlength=len(regions))
        return out


def moved(
    latitude_deg: FloatArray, longitude_deg: FloatArray, heading_deg: FloatArray, distance_km: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Places after a short straight way (flat within one step)."""
    north = np.cos(np.radians(heading_deg)) * distance_km / _KM_PER_DEG
    east = np.sin(np.radians(heading_deg)) * distance_km / _KM_PER_DEG
    return latitude_deg + north, longitude_deg + east / np.cos(np.radians(latitude_deg))


def moving_objects(
    regions: Regions,
    steps: int,
    seed: int = 0,
    *,
    arrivals_per_step: float = 1.0,
    mean_life_steps: float = 25.0,
    speed_km_per_step: tuple[float, float] = (5.0, 40.0),
    turn_deg_per_step: float = 4.0,
    along_grid: bool = False,
) -> Objects:
    """Objects drawn at random.

    The number of arrivals in a step is Poisson; before the first step there are as many as there are on average. An
    object starts at a random place in a random region, flies with constant speed and a heading that wanders, and is
    gone when its life (exponential) is over or it leaves the regions.

    Parameters
    ----------
    regions : Regions
    steps : int
    seed : int
    arrivals_per_step : float
        Mean number of newcomers.
    mean_life_steps : float
        Mean life if an object does not leave before.
    speed_km_per_step : (float, float)
        Uniform between the two; the default is 300 to 2400 km/h at a minute a step.
    turn_deg_per_step : float
        Standard deviation of the change of heading.
    along_grid : bool
        Objects keep to one of the four points of the compass and never turn: "targets move horizontally or vertically
        through the grid regions" (Holder 2024, Figure 4.5).

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    for name, value in (("arrivals_per_step", arrivals_per_step), ("mean_life_steps", mean_life_steps)):
        if not 0 < value < np.inf:
            raise ValueError(f"{name} must be a positive number, got {value!r}")
    slow, fast = speed_km_per_step
    if not 0 <= slow <= fast or turn_deg_per_step < 0:
        raise ValueError(
            "speed_km_per_step must be (least, most), 0 <= least <= most, and turns not negative"
        )
    rng = np.random.default_rng(seed)
    standing = rng.poisson(arrivals_per_step * mean_life_steps)  # already there before the first step
    later = rng.poisson(arrivals_per_step, steps)
    born = np.concatenate([np.zeros(standing, dtype=np.int64), np.repeat(np.arange(steps), later)])
    count = max(len(born), 1)
    born = born if len(born) else np.zeros(1, dtype=np.int64)
    life = np.ceil(rng.exponential(mean_life_steps, count)).astype(np.int64)
    home = rng.integers(len(regions), size=count)
    spread = 0.25 * np.sqrt(510.1e6 / 8 / 7 ** (regions.resolution + 1)) / _KM_PER_DEG  # well inside a cell
    latitude = regions.latitude_deg[home] + rng.uniform(-spread, spread, count)
    longitude = regions.longitude_deg[home] + rng.uniform(-spread, spread, count)
    heading: FloatArray = rng.uniform(0.0, 360.0, count)
    if along_grid:
        heading = 90.0 * np.floor(heading / 90.0)
    speed = rng.uniform(slow, fast, count)
    shape = (steps, count)
    region = np.full(shape, -1, dtype=np.int64)
    track = [np.full(shape, np.nan) for _ in range(3)]
    gone = np.zeros(count, dtype=bool)
    for k in range(steps):
        here = (born <= k) & ~gone & (k < born + life)
        old = np.flatnonzero(here & (born < k))
        latitude[old], longitude[old] = moved(latitude[old], longitude[old], heading[old], speed[old])
        if not along_grid:
            heading[old] += rng.normal(0.0, turn_deg_per_step, len(old))
        now = np.flatnonzero(here)
        region[k, now] = regions.containing(latitude[now], longitude[now])
        gone[now] |= region[k, now] < 0
        there = now[region[k, now] >= 0]
        for values, current in zip(track, (latitude, longitude, heading), strict=True):
            values[k, there] = current[there]
    return Objects(region, track[0], track[1], track[2], speed)
