"""The map of a constellation at work."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D

from sapopt.data.types import FloatArray
from sapopt.plotting.aboard import aboard
from sapopt.plotting.coastline import coastline_deg
from sapopt.plotting.style import BEST, BOUND, HEAT, MUTED, PALETTE, axes_or_new

if TYPE_CHECKING:
    from sapopt.problem.result import Result

_SERVED, _FREE = PALETTE[2], "#AEBDCB"


def world_map(
    scenario: Any,
    result: Result | None = None,
    step: int = 0,
    *,
    prices: Any = None,
    trail: int = 9,
    ax: Axes | None = None,
) -> Axes:
    """Draw satellites with their ground tracks, tasks, and who serves what at a step.

    Parameters
    ----------
    scenario : Constellation
        Or anything with ``positions_km``, ``tasks`` and ``benefits``, or a domain's scenario that wraps one.
    result : Result, optional
        Lines run from each satellite that gains something to its task, orange where the task was handed over.
    step : int
        0-based.
    prices : array_like, shape (T, m), optional
        Colours the tasks by their price at the step, the highest where several lie at one place.
    trail : int
        So many steps of the past are drawn behind the satellites.
    ax : Axes, optional

    Returns
    -------
    Axes
        Longitude and latitude in degrees.

    Raises
    ------
    ValueError
        If there is no such step, the result does not fit the scenario, or the scenario has no satellites.
    """
    found = aboard(scenario)
    if found is None:
        raise ValueError(f"scenario: a {type(scenario).__name__} has no satellites and places to draw")
    scenario, carrier, place = found
    steps, n = len(scenario.positions_km), len(carrier)
    if not 0 <= step < steps:
        raise ValueError(f"step must lie in 0..{steps - 1}, got {step}")
    if result is not None and (result.plan.shape[1] != n or len(result.plan) <= step):
        raise ValueError(
            f"result: its plan has shape {result.plan.shape}, the scenario {steps} steps and {n} agents"
        )
    ax = axes_or_new(ax, (10.0, 5.0))
    ax.set_facecolor("#E4EDF5")
    ax.add_collection(PolyCollection(coastline_deg(), facecolors="#FCFDFD", edgecolors=_FREE, linewidths=0.5))
    first = max(0, step - trail)
    track = ground_tracks_deg(scenario.positions_km[first : step + 1])
    for age in range(len(track) - 1):
        ax.add_collection(
            LineCollection(
                _strands(track[age], track[age + 1]), colors=BEST, lw=0.8, alpha=0.45 * (age + 1) / len(track)
            )
        )
    here, tasks = track[-1], scenario.tasks
    places = np.stack([tasks.longitude_deg, tasks.latitude_deg], axis=-1)
    size = 9.0 * tasks.priority / max(tasks.priority.max(), 1e-12)
    served = np.zeros(tasks.m, dtype=bool)
    busy = np.zeros(len(here), dtype=bool)
    if result is not None:
        before, now = (at if place is None else place[at] for at in result.plan[[max(step - 1, 0), step]])
        width = int(max(before.max(), now.max(), tasks.m)) + 1
        seen = scenario.benefits.slice(step, step + 1).flat()
        row = np.repeat(np.arange(len(here)), np.diff(seen.indptr))
        pair = carrier * width + now
        gains = np.isin(pair, (row * width + seen.indices)[seen.data > 0])
        moved = gains & ~np.isin(pair, carrier * width + before)
        served[now[gains]] = busy[carrier[gains]] = True
        for who, color, thick in ((gains & ~moved, _SERVED, 1.0), (moved, BOUND, 1.6)):
            lines = _strands(here[carrier[who]], places[now[who]])
            ax.add_collection(LineCollection(lines, colors=color, lw=thick))
    if prices is not None:
        look = {"cmap": HEAT, "vmin": 0.0, "lw": 0.3, "edgecolors": MUTED, "zorder": 3}
        asked = np.asarray(prices)[step]
        at = np.arange(len(asked)) if place is None else place
        dearest = np.zeros(tasks.m)
        np.maximum.at(dearest, at[at < tasks.m], asked[at < tasks.m])
        _dots(ax, places, 4 + 3 * size, dearest, marker="s", **look)
    else:
        _dots(ax, places[~served], size[~served], _FREE, marker="s", zorder=3)
        _dots(ax, places[served], 1.4 * size[served], _SERVED, marker="s", zorder=3)
    _dots(ax, here[~busy], 7, MUTED, alpha=0.6, zorder=4)
    _dots(ax, here[busy], 9, BEST, zorder=4)
    highest = min(90.0, max(60.0, float(np.abs(here[:, 1]).max()) + 7.0))
    _legend(ax, result is not None, prices is not None)
    ax.set(xlim=(-180, 180), ylim=(-highest, highest), aspect="equal")
    ax.set_xticks(range(-180, 181, 60))
    ax.set_yticks(range(-60, 61, 30))
    ax.tick_params(length=0, labelsize=8, colors=MUTED)
    for spine in ax.spines.values():
        spine.set_visible(False)
    return ax


def _legend(ax: Axes, served: bool, priced: bool) -> None:
    """What the marks mean, below the map."""
    square: dict[str, Any] = {"marker": "s", "ls": "none", "ms": 5}
    dot: dict[str, Any] = {"marker": "o", "ls": "none", "ms": 4}
    marks = [
        Line2D([], [], color=MUTED, alpha=0.6, label="satellite that idles" if served else "satellite", **dot)
    ]
    if served:
        marks.insert(0, Line2D([], [], color=BEST, label="satellite at work", **dot))
    if priced:
        marks.append(Line2D([], [], color=HEAT(0.6), label="task: the darker, the dearer", **square))
    else:
        marks += [Line2D([], [], color=_SERVED, label="task served", **square)] if served else []
        marks.append(Line2D([], [], color=_FREE, label="task not served" if served else "task", **square))
    if served:
        marks.append(Line2D([], [], color=BOUND, lw=1.6, label="just handed over"))
    ax.legend(
        handles=marks, loc="upper center", bbox_to_anchor=(0.5, -0.05), ncols=len(marks), frameon=False, fontsize=8,
        handletextpad=0.4,
    )  # fmt: skip


def _dots(ax: Axes, at: FloatArray, size: Any, color: Any, **look: Any) -> None:
    ax.scatter(at[:, 0], at[:, 1], s=size, c=color, **({"lw": 0} | look))


def ground_tracks_deg(positions_km: FloatArray) -> FloatArray:
    """Longitude and latitude below satellites at Earth-fixed positions (..., 3) in kilometres: shape (..., 2)."""
    x, y, z = np.moveaxis(np.asarray(positions_km, dtype=np.float64), -1, 0)
    return np.stack([np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))], axis=-1)


def _strands(begin: FloatArray, end: FloatArray) -> list[FloatArray]:
    """Lines between places, the short way round; those over the date line are drawn at both edges."""
    turn = np.zeros_like(begin)
    turn[:, 0] = 360.0 * np.round((end - begin)[:, 0] / 360.0)
    lines = np.stack([begin, end - turn], axis=1)
    over = turn[:, 0] != 0
    return [*lines, *np.stack([begin + turn, end], axis=1)[over]]
