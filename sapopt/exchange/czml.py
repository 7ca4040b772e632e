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


def write_czml(result: Result, path: str | Path, scenario: Any, problem: SAP | None = None) -> None:
    """Write a plan as CZML.

    Parameters
    ----------
    result : Result
    path : str or Path
        An existing file is replaced.
    scenario : Constellation, or a scenario that rides on one
        What the problem was made of. Its date is the start of the film; without one that is 2000-01-01 12:00 UTC.
    problem : SAP, optional
        Needed only if the result was read from a file.

    Raises
    ------
    ValueError
        If the scenario has no satellites, or is not the one that the problem was made of.
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
    packets += _satellites(czml, properties, film, interval, served)
    packets += _places(czml, properties, film, served)
    packets += _links(czml, properties, types, film, interval, served)
    write_text(path, czml.Document(packets=packets).dumps() + "\n")


Runs = list[tuple[int, int, int, int]]


def _satellites(czml: Any, properties: Any, film: Above, interval: Any, served: Runs) -> list[Any]:
    step_s = (film.ends[0] - film.starts[0]).total_seconds()
    seconds = step_s * np.arange(len(film.starts))
    told: dict[int, list[str]] = defaultdict(list)
    for satellite, place, first, stop in sorted(served, key=lambda run: run[2]):
        told[satellite].append(_line(film, film.places[place], first, stop))
    colour = properties.Color(rgba=_SATELLITE)
    packets = []
    for i, name in enumerate(film.satellites):
        samples = np.column_stack([seconds, np.round(film.positions_km[:, i] * 1000.0, 1)])
        position = properties.Position(
            referenceFrame="FIXED", epoch=stamp(film.starts[0]), cartesian=samples.ravel().tolist(),
            interpolationAlgorithm="LAGRANGE", interpolationDegree=min(5, max(len(seconds) - 1, 1)),
            forwardExtrapolationType="EXTRAPOLATE", forwardExtrapolationDuration=step_s,
        )  # fmt: skip
        packets.append(
            czml.Packet(
                id=f"satellite/{i}", name=name, availability=interval, position=position,
                description="".join(told[i]) or "serves nothing",
                point=properties.Point(pixelSize=6, color=colour),
                path=properties.Path(
                    leadTime=0, trailTime=_TRAIL_S, width=1,
                    material=properties.PolylineMaterial(solidColor=properties.SolidColorMaterial(color=colour)),
                ),
            )
        )  # fmt: skip
    return packets


def _places(czml: Any, properties: Any, film: Above, served: Runs) -> list[Any]:
    told: dict[int, list[str]] = defaultdict(list)
    for satellite, place, first, stop in sorted(served, key=lambda run: run[2]):
        told[place].append(_line(film, film.satellites[satellite], first, stop))
    colour = properties.Color(rgba=_PLACE)
    return [
        czml.Packet(
            id=f"task/{j}", name=name, description="".join(told[j]) or "is never served",
            position=properties.Position(
                cartographicDegrees=[float(film.longitude_deg[j]), float(film.latitude_deg[j]), 0.0]
            ),
            point=properties.Point(pixelSize=5, color=colour),
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
