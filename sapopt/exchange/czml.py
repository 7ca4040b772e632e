"""Plans as CZML, which Cesium shows: satellites on their ways, places, and who serves what when."""

from __future__ import annotations

import html
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from sapopt.data.extras import needed
from sapopt.data.files import write_text
from sapopt.exchange.above import Above, above, stamp
from sapopt.problem.result import Result
from sapopt.problem.sap import SAP

_SATELLITE, _PLACE, _LINK = [255, 255, 255, 255], [86, 180, 233, 255], [230, 159, 0, 255]
_SPEED = 60.0
"""Seconds of the plan that pass in one second of the film."""
_TRAIL_S = 600.0
_MOST_LABELS = 60


def write_czml(result: Result, path: str | Path, scenario: Any, problem: SAP | None = None) -> None:
    """Write a plan as CZML.

    Parameters
    ----------
    result : Result
    path : str or Path
        An existing file is replaced.
    scenario : Constellation, a scenario that rides on one, or Places
        What the problem was made of, or where its agents and tasks are if none moves. Its date is the start of the
        film; without one that is 2000-01-01 12:00 UTC.
    problem : SAP, optional
        Needed only if the result was read from a file.

    Raises
    ------
    ValueError
        If the scenario has no places, or is not the one that the problem was made of.
    ImportError
        If czml3 is not installed (extra ``space``).

    Notes
    -----
    Positions are Earth-fixed; Cesium interpolates between the steps. A satellite serves a place while it holds a task
    there of positive benefit: a line joins the two then.
    """
    czml, properties, types = (
        needed(f"czml3.{part}", "space", "CZML") for part in ("core", "properties", "types")
    )
    film = above(result, scenario, problem)
    interval = types.TimeInterval(start=stamp(film.starts[0]), end=stamp(film.ends[-1]))
    clock = properties.Clock(interval=interval, currentTime=stamp(film.starts[0]), multiplier=_SPEED)
    packets = [czml.Packet(id="document", name=f"{result.solver}", version="1.0", clock=clock)]
    served = film.runs()
    packets += _satellites(czml, properties, types, film, interval, served)
    packets += _places(czml, properties, types, film, served)
    packets += _links(czml, properties, types, film, interval, served)
    write_text(path, czml.Document(packets=packets).dumps() + "\n")


Runs = list[tuple[int, int, int, int]]


def _satellites(
    czml: Any, properties: Any, types: Any, film: Above, interval: Any, served: Runs
) -> list[Any]:
    told: dict[int, list[str]] = defaultdict(list)
    for satellite, place, first, stop in sorted(served, key=lambda run: run[2]):
        told[satellite].append(_line(film, film.places[place], first, stop))
    colour = properties.Color(rgba=_SATELLITE)
    trail = properties.Path(
        leadTime=0, trailTime=_TRAIL_S, width=1,
        material=properties.PolylineMaterial(solidColor=properties.SolidColorMaterial(color=colour)),
    )  # fmt: skip
    return [
        czml.Packet(
            id=f"satellite/{i}", name=name, availability=interval, position=_position(properties, film, i),
            description="".join(told[i]) or "serves nothing",
            point=properties.Point(pixelSize=6, color=colour), path=trail if film.fixed is None else None,
            label=_label(properties, types, name, film.satellites) if film.fixed is not None else None,
        )
        for i, name in enumerate(film.satellites)
    ]  # fmt: skip


def _position(properties: Any, film: Above, i: int) -> Any:
    """Where a satellite flies, or an agent that does not move stays."""
    if film.positions_km is None:
        return _still(properties, film.fixed, i)
    step_s = (film.ends[0] - film.starts[0]).total_seconds()
    seconds = step_s * np.arange(len(film.starts))
    samples = np.column_stack([seconds, np.round(film.positions_km[:, i] * 1000.0, 1)])
    return properties.Position(
        referenceFrame="FIXED", epoch=stamp(film.starts[0]), cartesian=samples.ravel().tolist(),
        interpolationAlgorithm="LAGRANGE", interpolationDegree=min(5, max(len(seconds) - 1, 1)),
        forwardExtrapolationType="EXTRAPOLATE", forwardExtrapolationDuration=step_s,
    )  # fmt: skip


def _still(properties: Any, places: Any, j: int) -> Any:
    return properties.Position(
        cartographicDegrees=[float(places.longitude_deg[j]), float(places.latitude_deg[j]), 0.0]
    )


def _label(properties: Any, types: Any, name: str, among: list[str]) -> Any:
    """A name beside a point, as long as there are few enough to be read."""
    if len(among) > _MOST_LABELS:
        return None
    return properties.Label(
        text=name, font="13px sans-serif", horizontalOrigin="LEFT",
        pixelOffset=types.Cartesian2Value(values=[9, 0]),
    )  # fmt: skip


def _places(czml: Any, properties: Any, types: Any, film: Above, served: Runs) -> list[Any]:
    told: dict[int, list[str]] = defaultdict(list)
    for satellite, place, first, stop in sorted(served, key=lambda run: run[2]):
        told[place].append(_line(film, film.satellites[satellite], first, stop))
    colour = properties.Color(rgba=_PLACE)
    return [
        czml.Packet(
            id=f"task/{j}", name=name, description="".join(told[j]) or "is never served",
            position=_still(properties, film, j), point=properties.Point(pixelSize=5, color=colour),
            label=_label(properties, types, name, film.places),
        )
        for j, name in enumerate(film.places)
        if film.priority[j] > 0
    ]  # fmt: skip


def _line(film: Above, name: str, first: int, stop: int) -> str:
    """A line of the text that Cesium shows of what is clicked."""
    return f"<p>{stamp(film.starts[first])} to {stamp(film.ends[stop - 1])}: {html.escape(name)}</p>"


def _links(czml: Any, properties: Any, types: Any, film: Above, interval: Any, served: Runs) -> list[Any]:
    spans: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for satellite, place, first, stop in served:
        spans[satellite, place].append((first, stop))
    material = properties.PolylineMaterial(
        solidColor=properties.SolidColorMaterial(color=properties.Color(rgba=_LINK))
    )
    packets = []
    for (i, j), times in spans.items():
        # Outside of all intervals Cesium would show the line, so the whole time is said first.
        show = [types.IntervalValue(start=interval.start, end=interval.end, value=False)]
        show += [
            types.IntervalValue(start=stamp(film.starts[first]), end=stamp(film.ends[stop - 1]), value=True)
            for first, stop in times
        ]
        line = properties.Polyline(
            show=types.TimeIntervalCollection(values=show),
            positions=properties.PositionList(references=[f"satellite/{i}#position", f"task/{j}#position"]),
            width=2, material=material, arcType=properties.ArcType(arcType="NONE"),
        )  # fmt: skip
        packets.append(
            czml.Packet(
                id=f"assignment/{i}/{j}",
                name=f"{film.satellites[i]} serves {film.places[j]}",
                availability=interval,
                polyline=line,
            )
        )
    return packets
