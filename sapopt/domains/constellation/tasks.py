"""Tasks on the ground: where they are and what they are worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sapopt.data.tables import Table
from sapopt.data.types import FloatArray
from sapopt.domains.constellation.windows import Window, checked_windows, windows_of_table


@dataclass(frozen=True, eq=False)
class GroundTasks:
    """Tasks at fixed places on the ground.

    Attributes
    ----------
    latitude_deg, longitude_deg : ndarray, shape (m,)
        Geocentric, on the spherical Earth.
    priority : ndarray, shape (m,)
        Weight of the benefit of each task, at least 0; a task of priority 0 never yields anything (a place to idle).
    names : tuple of str
        Of the tasks, which problems, tables and maps then bear; empty if they have none.
    windows : tuple of pairs of datetime or None
        From when until when each task is wanted; None leaves that end open, and no windows at all mean always. Times
        without a zone are UTC. A constellation with such tasks needs a date.
    scattered : bool
        Whether the places were drawn at random or spread over the Earth: then one that no satellite ever sees is no
        mistake, and constellations do not warn of it.
    """

    latitude_deg: FloatArray
    longitude_deg: FloatArray
    priority: FloatArray
    names: tuple[str, ...] = ()
    windows: tuple[Window, ...] = ()
    scattered: bool = False

    def __post_init__(self) -> None:
        for name in ("latitude_deg", "longitude_deg", "priority"):
            array = np.asarray(getattr(self, name), dtype=np.float64)
            if array.ndim != 1 or len(array) != np.size(self.latitude_deg):
                raise ValueError(f"{name} must be one number per task, got shape {array.shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name} holds NaN or infinity at task {int(np.argmin(np.isfinite(array)))}")
            object.__setattr__(self, name, array)
        names = self.names
        if isinstance(names, str) or (len(names) not in (0, self.m)):
            raise ValueError(f"names must be one for each of {self.m} tasks, or none, got {names!r}")
        object.__setattr__(self, "names", tuple(str(name) for name in names))
        object.__setattr__(self, "windows", checked_windows(self.windows, self.m))
        if self.m == 0:
            raise ValueError("latitude_deg is empty; give at least one task")
        if (bad := np.abs(self.latitude_deg) > 90.0).any():
            task = int(np.argmax(bad))
            raise ValueError(
                f"latitude_deg must lie between -90 and 90, task {task} has {self.latitude_deg[task]}; "
                "are latitude and longitude exchanged?"
            )
        if (bad := self.priority < 0.0).any():
            task = int(np.argmax(bad))
            raise ValueError(
                f"priority must not be negative, task {task} has {self.priority[task]}; "
                "use 0 for a task that is worth nothing"
            )

    @classmethod
    def from_table(
        cls,
        table: Any,
        *,
        latitude: str = "latitude_deg",
        longitude: str = "longitude_deg",
        priority: str | None = None,
        name: str | None = None,
        opens: str | None = None,
        closes: str | None = None,
    ) -> GroundTasks:
        """Tasks from a table with one row for each.

        Parameters
        ----------
        table : data frame, mapping of str to sequence, str or Path
            A data frame of pandas or polars, a table of pyarrow, a mapping of names to lists, or a CSV or Parquet file.
        latitude, longitude : str
            Names of the columns, in degrees.
        priority, name : str, optional
            Names of these columns; without them every priority is 1, and tasks have no names.
        opens, closes : str, optional
            Names of the columns with the time window of each task, as dates or ISO 8601 texts, UTC where they name no
            zone. An empty cell leaves that end open.

        Raises
        ------
        ValueError
            If a column is missing or a value is none; rows are counted from 0.
        """
        from sapopt.domains.constellation.places import columns_of_table

        read = Table(table)
        windows = windows_of_table(read, opens, closes)
        return cls(*columns_of_table(read, latitude, longitude, priority, name), windows)

    @classmethod
    def from_geojson(cls, source: Any, *, priority: str = "priority", name: str = "name") -> GroundTasks:
        """Tasks from the points of GeoJSON (RFC 7946: WGS 84, the longitude first).

        Latitudes are taken as geocentric; the difference from geodetic ones is 0.2 degrees at most.

        Parameters
        ----------
        source : str, Path or mapping
            A file, or GeoJSON that was read already.
        priority, name : str
            Properties of the features. A feature without a priority has 1; one without a name has its ``id``, else its
            number.

        Raises
        ------
        ValueError
            If it is no GeoJSON, or a feature is no point; features are counted from 0.
        """
        from sapopt.domains.constellation.places import columns_of_geojson

        return cls(*columns_of_geojson(source, priority, name))

    @property
    def m(self) -> int:
        """Number of tasks."""
        return len(self.latitude_deg)

    def called(self, j: int) -> str:
        """What messages call a task: by its name, else by its number, with its place."""
        name = repr(self.names[j]) if self.names else f"task {j}"
        return f"{name} ({self.latitude_deg[j]:.1f}, {self.longitude_deg[j]:.1f} degrees)"

    def with_idle_tasks(self, count: int) -> GroundTasks:
        """Append `count` tasks of priority 0 (placed at latitude and longitude 0), so that agents can idle."""
        if count < 0:
            raise ValueError(f"count must not be negative, got {count}")
        zeros = np.zeros(count)
        return GroundTasks(
            np.concatenate([self.latitude_deg, zeros]),
            np.concatenate([self.longitude_deg, zeros]),
            np.concatenate([self.priority, zeros]),
            (*self.names, *(f"idle {i}" for i in range(count))) if self.names else (),
            (*self.windows, *((None, None) for _ in range(count))) if self.windows else (),
            self.scattered,
        )


def random_tasks(
    m: int,
    seed: int | np.random.Generator = 0,
    *,
    max_latitude_deg: float = 55.0,
    uniform_in: Literal["latitude", "area"] = "latitude",
    priorities: Sequence[float] | None = None,
) -> GroundTasks:
    """Tasks at random places.

    The defaults are those of the published code of Holder (2024): latitude uniform within 55 degrees, longitude
    uniform, priority uniform on [1, 2], drawn in this order; ``random_tasks(450, 0)`` gives its mid-size instance. The
    thesis itself says of the places only "randomly placed on the surface of the Earth" (section 4.2.1).

    Parameters
    ----------
    m : int
        Number of tasks.
    seed : int or numpy Generator
        Tasks are the same for the same seed.
    max_latitude_deg : float
        Places lie between this latitude south and north.
    uniform_in : {"latitude", "area"}
        "latitude" draws the latitude uniformly (denser towards the poles), "area" spreads the tasks evenly over the
        sphere; with ``max_latitude_deg=90`` that is the uniform distribution on the sphere.
    priorities : sequence of float, optional
        Draw every priority from this list with equal chances, as ``(1, 1, 1, 5)`` of the published code for 6.4;
        without it they are uniform on [1, 2].

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    if int(m) != m or m < 1:
        raise ValueError(f"m must be a whole number of at least 1, got {m}")
    if not 0.0 < max_latitude_deg <= 90.0:
        raise ValueError(f"max_latitude_deg must lie between 0 and 90 degrees, got {max_latitude_deg}")
    rng = np.random.default_rng(seed)
    if uniform_in == "latitude":
        latitude = rng.uniform(-max_latitude_deg, max_latitude_deg, m)
    elif uniform_in == "area":
        highest = np.sin(np.radians(max_latitude_deg))
        latitude = np.degrees(np.arcsin(rng.uniform(-highest, highest, m)))
    else:
        raise ValueError(f"uniform_in must be 'latitude' or 'area', got {uniform_in!r}")
    longitude = rng.uniform(-180.0, 180.0, m)
    return GroundTasks(latitude, longitude, _draw_priorities(m, rng, priorities), scattered=True)


def even_tasks(
    spacing_deg: float = 7.0,
    max_latitude_deg: float = 80.0,
    seed: int | np.random.Generator = 0,
    *,
    priorities: Sequence[float] | None = None,
) -> GroundTasks:
    """Tasks spread evenly: rings of latitude `spacing_deg` apart, and as many tasks on each as fit at that distance.

    The rings lie half a spacing, one and a half spacings, ... north and south of the equator. The defaults give 812
    tasks: 80 degrees is as far north as a satellite at 550 km with 70 degrees of inclination can see. The thesis has
    the same number within 70 degrees (section 4.2.2): see `ring_tasks`.

    Parameters
    ----------
    spacing_deg : float
        Distance between neighbours in degrees of arc.
    max_latitude_deg : float
        No ring beyond this latitude.
    seed, priorities
        As in `random_tasks`; they matter for the priorities only.

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    if not 0.0 < max_latitude_deg <= 90.0:
        raise ValueError(f"max_latitude_deg must lie between 0 and 90 degrees, got {max_latitude_deg}")
    if not 0.0 < spacing_deg <= 2 * max_latitude_deg:
        raise ValueError(
            f"spacing_deg must be positive and at most twice max_latitude_deg, got {spacing_deg}"
        )
    rings = int((max_latitude_deg - spacing_deg / 2) / spacing_deg) + 1
    north = np.minimum(spacing_deg * (np.arange(rings) + 0.5), max_latitude_deg)
    latitudes, longitudes = [], []
    for ring in np.concatenate([-north[::-1], north]):
        fit = max(int(360.0 * np.cos(np.radians(ring)) / spacing_deg + 1e-9), 1)
        latitudes.append(np.full(fit, ring))
        longitudes.append(-180.0 + 360.0 * np.arange(fit) / fit)
    latitude = np.concatenate(latitudes)
    priority = _draw_priorities(len(latitude), np.random.default_rng(seed), priorities)
    return GroundTasks(latitude, np.concatenate(longitudes), priority, scattered=True)


def ring_tasks(
    m: int = 812,
    max_latitude_deg: float = 70.0,
    rings: int = 21,
    seed: int | np.random.Generator = 0,
    *,
    priorities: Sequence[float] | None = None,
) -> GroundTasks:
    """A given number of tasks spread evenly over rings of latitude, the outermost at the highest latitude.

    The defaults are the 812 tasks "evenly across Earth from latitude -70 to 70 degrees" of section 4.2.2. How they lie
    there is ours: rings 7 degrees apart, which 812 tasks, shared in proportion to the length of the rings (by largest
    remainders), fill with neighbours 7.0 degrees of arc apart at the equator.

    Parameters
    ----------
    m : int
        Number of tasks, at least one for each ring.
    max_latitude_deg : float
        Latitude of the outermost rings, north and south.
    rings : int
        At least 2.
    seed, priorities
        As in `random_tasks`; they matter for the priorities only.

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    if not 0.0 < max_latitude_deg < 90.0:
        raise ValueError(f"max_latitude_deg must lie between 0 and 90 degrees, got {max_latitude_deg}")
    if int(rings) != rings or rings < 2:
        raise ValueError(f"rings must be a whole number of at least 2, got {rings}")
    if int(m) != m or m < rings:
        raise ValueError(f"m must be a whole number of at least one task a ring, {rings}, got {m}")
    latitudes = np.linspace(-max_latitude_deg, max_latitude_deg, int(rings))
    length = np.cos(np.radians(latitudes))
    share = 1.0 + (m - rings) * length / length.sum()
    fit = np.floor(share).astype(np.int64)
    fit[np.argsort(fit - share, kind="stable")[: m - fit.sum()]] += 1
    longitude = np.concatenate([-180.0 + 360.0 * np.arange(count) / count for count in fit])
    priority = _draw_priorities(int(m), np.random.default_rng(seed), priorities)
    return GroundTasks(np.repeat(latitudes, fit), longitude, priority, scattered=True)


def _draw_priorities(m: int, rng: np.random.Generator, priorities: Any) -> FloatArray:
    if priorities is None:
        return rng.uniform(1.0, 2.0, m)
    values = np.asarray(priorities, dtype=np.float64)
    if values.ndim != 1 or len(values) == 0 or not np.isfinite(values).all() or (values < 0).any():
        raise ValueError(
            f"priorities must be a list of numbers of at least 0 to draw from, got {priorities!r}"
        )
    return rng.choice(values, m)
