"""Places on the ground from tables and from GeoJSON."""

from __future__ import annotations

import json
import numbers
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sapopt.data.tables import Table
from sapopt.data.textfile import read_text


def columns_of_table(
    read: Table, latitude: str, longitude: str, priority: str | None, name: str | None
) -> tuple[Any, Any, Any, tuple[str, ...]]:
    """Latitudes, longitudes, priorities and names of the rows of a table; see `GroundTasks.from_table`."""
    north, east = read.numbers(latitude), read.numbers(longitude)
    worth = np.ones(len(north)) if priority is None else read.numbers(priority)
    for column, values in ((latitude, north), (longitude, east), (priority, worth)):
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise ValueError(f"{column}: row {int(bad[0])} (counted from 0) has no finite value")
    names = () if name is None else tuple(str(value) for value in read.values(name))
    return north, east, worth, names


def columns_of_geojson(source: Any, priority: str, name: str) -> tuple[Any, Any, Any, tuple[str, ...]]:
    """The same of the points of GeoJSON (RFC 7946); see `GroundTasks.from_geojson`."""
    told, where = (source, "GeoJSON") if isinstance(source, Mapping) else (_loaded(Path(source)), str(source))
    north, east, worth, names = [], [], [], []
    for number, feature in enumerate(_features(told, where)):
        here = f"{where}: feature {number} (counted from 0)"
        if not isinstance(feature, Mapping) or not isinstance(feature.get("geometry"), Mapping):
            raise ValueError(f"{here} has no geometry")
        geometry, properties = feature["geometry"], feature.get("properties") or {}
        if geometry.get("type") != "Point":
            raise ValueError(
                f"{here} is a {geometry.get('type')}; only points are tasks, such as an area's centre"
            )
        place = geometry.get("coordinates")
        if not isinstance(place, Sequence) or len(place) < 2 or not all(map(_is_number, place[:2])):
            raise ValueError(f"{here}: its coordinates are no longitude and latitude")
        if not isinstance(properties, Mapping):
            raise ValueError(f"{here}: its properties are no object")
        weight = properties.get(priority, 1.0)
        if not _is_number(weight):
            raise ValueError(f"{here}: {priority} is {weight!r}, no number")
        east.append(float(place[0]))  # longitude comes first in GeoJSON
        north.append(float(place[1]))
        worth.append(float(weight))
        names.append(str(properties.get(name, feature.get("id", number))))
    return north, east, worth, tuple(names)


def _loaded(path: Path) -> Any:
    try:
        return json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not JSON ({error})") from None


def _features(told: Any, where: str) -> Sequence[Any]:
    kind = told.get("type") if isinstance(told, Mapping) else None
    if kind == "Feature":
        return [told]
    features = told.get("features") if isinstance(told, Mapping) else None
    if kind != "FeatureCollection" or not isinstance(features, Sequence):
        raise ValueError(
            f"{where}: a FeatureCollection of points is needed, this is {kind or type(told).__name__}"
        )
    return features


def _is_number(value: Any) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool)
