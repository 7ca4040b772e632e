"""Plans as GeoJSON (RFC 7946): places with who serves them when, and the ground tracks of the satellites."""

from __future__ import annotations

import json
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sapopt.data.files import write_text
from sapopt.data.types import FloatArray
from sapopt.exchange.above import Above, above, stamp
from sapopt.problem.result import Result
from sapopt.problem.sap import SAP

_DIGITS = 5
"""Of degrees: a metre on the ground."""


def write_geojson(result: Result, path: str | Path, scenario: Any, problem: SAP | None = None) -> None:
    """Write a plan as GeoJSON: a point for each place, a line for each satellite.

    Properties tell ``kind`` ("task", and "satellite" or, where they do not move, "agent"), ``name``, of a task its
    ``priority``, and ``stays``: who serves whom from when to when, in UTC. Tracks are cut where they cross the
    antimeridian.

    Parameters
    ----------
    result : Result
    path : str or Path
        An existing file is replaced.
    scenario : Constellation, a scenario that rides on one, or Places
        What the problem was made of, or where its agents and tasks are if none moves. Without a date the first step is
        2000-01-01 12:00 UTC.
    problem : SAP, optional
        Needed only if the result was read from a file.

    Raises
    ------
    ValueError
        If the scenario has no places, or is not the one that the problem was made of.
    """
    shown = above(result, scenario, problem)
    by_place: dict[int, list[dict[str, str]]] = defaultdict(list)
    by_satellite: dict[int, list[dict[str, str]]] = defaultdict(list)
    for satellite, place, first, stop in sorted(shown.runs(), key=lambda run: run[2]):
        span = {"start": stamp(shown.starts[first]), "stop": stamp(shown.ends[stop - 1])}
        by_place[place].append({shown.kind: shown.satellites[satellite], **span})
        by_satellite[satellite].append({"task": shown.places[place], **span})
    features = [_place(shown, j, by_place[j]) for j in range(len(shown.places)) if shown.priority[j] > 0]
    features += [_satellite(shown, i, by_satellite[i]) for i in range(len(shown.satellites))]
    collection = {"type": "FeatureCollection", "features": features}
    write_text(path, json.dumps(collection, ensure_ascii=False, allow_nan=False) + "\n")


def _place(shown: Above, j: int, stays: list[dict[str, str]]) -> dict[str, Any]:
    told = {"kind": "task", "name": shown.places[j], "priority": float(shown.priority[j]), "stays": stays}
    return _feature({"type": "Point", "coordinates": _point(shown, j)}, told)


def _point(places: Any, j: int) -> list[float]:
    east = (float(places.longitude_deg[j]) + 180.0) % 360.0 - 180.0
    return [round(east, _DIGITS), round(float(places.latitude_deg[j]), _DIGITS)]


def _satellite(shown: Above, i: int, stays: list[dict[str, str]]) -> dict[str, Any]:
    told = {"kind": shown.kind, "name": shown.satellites[i], "stays": stays}
    if shown.positions_km is None:
        return _feature({"type": "Point", "coordinates": _point(shown.fixed, i)}, told)
    x, y, z = shown.positions_km[:, i].T
    track = np.column_stack(
        [np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z / np.sqrt(x * x + y * y + z * z)))]
    )
    if len(track) == 1:
        return _feature({"type": "Point", "coordinates": track[0].round(_DIGITS).tolist()}, told)
    return _feature({"type": "MultiLineString", "coordinates": cut(track)}, told)


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def cut(track: FloatArray) -> list[list[list[float]]]:
    """A track (points, 2) of longitudes and latitudes as lines that do not cross the antimeridian (RFC 7946, 3.1.9).

    Between two points the shorter way round is meant; where it crosses, both lines get a point on the antimeridian.
    """
    lines: list[list[list[float]]] = [[_rounded(track[0])]]
    for before, after in pairwise(track):
        jump = after[0] - before[0]
        if abs(jump) > 180.0:
            edge = 180.0 if jump < 0 else -180.0
            share = (edge - before[0]) / (jump + 360.0 if jump < 0 else jump - 360.0)
            latitude = before[1] + share * (after[1] - before[1])
            lines[-1].append(_rounded((edge, latitude)))
            lines.append([_rounded((-edge, latitude))])
        lines[-1].append(_rounded(after))
    return lines


def _rounded(point: Any) -> list[float]:
    return [round(float(value), _DIGITS) for value in point]
