"""What the page is told: problem, results, prices and map as JSON, arrays as base64 of small integers."""

from __future__ import annotations

import base64
import platform
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.plotting.aboard import aboard
from sapopt.plotting.coastline import coastline_data
from sapopt.problem.result import Result
from sapopt.problem.sap import SAP
from sapopt.report.limits import limits_of, why_of
from sapopt.report.moments import told_times

_FINE_CELLS = 400_000
"""Up to so many agents x steps, benefits are told in 65535 levels, beyond in 255, to keep the page small."""
_TRACE_POINTS = 400
_DUST = 1e-6
"""Prices below this share of what a step is worth are left out: they are what solvers leave of zero."""


def payload(
    problem: SAP,
    results: Mapping[str, Result],
    bound: float | None,
    prices: Any,
    scenario: Any,
    title: str,
    sized: bool = False,
) -> dict[str, Any]:
    """Everything that the page shows, as plain values.

    Parameters
    ----------
    problem : SAP
    results : mapping of str to Result
        Checked to belong to the problem.
    bound : float or None
        A proven upper bound.
    prices : ndarray of shape (T, m), or None
    scenario : object or None
        With ``positions_km`` and ``tasks``, as a `Constellation`; anything else gets no map.
    title : str
    sized : bool
        Whether the title tells the size of the problem already.
    """
    initial = problem.initial_assignment
    return {
        "title": title,
        "sized": sized,
        "made": f"sapopt {version('sapopt')}, Python {platform.python_version()}, numpy {np.__version__}",
        "T": problem.T,
        "n": problem.n,
        "m": problem.m,
        "dynamics": repr(problem.dynamics),
        "agents": None if problem.agents is None else list(problem.agents),
        "tasks": _task_labels(problem),
        "idle": problem.idle,
        **told_times(problem),
        "initial": None if initial is None else problem.placed(initial).tolist(),
        "bound": bound,
        "prices": _prices(prices, results),
        "results": [_told(problem, name, result, bound) for name, result in results.items()],
        "map": _map(problem, scenario),
    }


def _prices(prices: Any, results: Mapping[str, Result]) -> dict[str, Any] | None:
    """Prices worth showing: what is left of rounding, beside the benefits of a step, is not."""
    if prices is None:
        return None
    scale = max(float(np.abs(result.evaluation.benefit).max(initial=0.0)) for result in results.values())
    shown = np.where(prices > _DUST * scale, prices, 0.0)
    return _levels(shown, np.uint16)


def _task_labels(problem: SAP) -> list[str] | None:
    """Labels of the tasks, and of nothing where agents may hold it; None where numbers will do."""
    if not problem.idle:
        return None if problem.tasks is None else list(problem.tasks)
    own = [f"task {j}" for j in range(problem.m)] if problem.tasks is None else list(problem.tasks)
    return [*own, "nothing"]


def _told(problem: SAP, name: str, result: Result, bound: float | None) -> dict[str, Any]:
    held = problem.held_benefits(result.plan)
    kind = np.uint16 if held.size <= _FINE_CELLS else np.uint8
    return {
        "name": name,
        "solver": result.solver,
        "value": result.value,
        "handovers": result.handovers,
        "paid": result.evaluation.paid_handovers,
        "switches": result.evaluation.switches,
        "status": result.status.value,
        "message": result.status.message,
        "seconds": result.runtime,
        "seed": result.seed,
        "busy": float((held > 0).mean()),
        "plan": _base64(
            problem.placed(result.plan).astype(np.uint16 if problem.core.m <= 2**16 else np.uint32)
        ),
        "held": _levels(np.maximum(held, 0.0), kind),
        "benefit": _rounded(result.evaluation.benefit),
        "handover": _rounded(result.evaluation.handover),
        "trace": _trace(result, bound),
        "limits": limits_of(problem, result),
        "why": why_of(problem, result),
    }


def _trace(result: Result, bound: float | None) -> list[list[float]]:
    """Seconds, best bound and best value so far of a planner; thinned to what a chart can show."""
    known = [r for r in result.trace if r.get("bound") is not None and r.get("value") is not None]
    known = [r for r in known if np.isfinite(r["bound"]) and np.isfinite(r["value"]) and "seconds" in r]
    if not known:
        return []
    bounds = np.minimum.accumulate([r["bound"] for r in known])
    values = np.maximum.accumulate([r["value"] for r in known])
    kept = np.unique(np.linspace(0, len(known) - 1, min(len(known), _TRACE_POINTS)).round().astype(int))
    return [[round(known[k]["seconds"], 3), float(bounds[k]), float(values[k])] for k in kept]


def _map(problem: SAP, scenario: Any) -> dict[str, Any] | None:
    """Ground tracks and places of the tasks, if the scenario has them for this very problem."""
    found = aboard(scenario)
    if found is None:
        return None
    base, carrier, place = found
    positions, tasks = base.positions_km, base.tasks
    if place is None:
        place = np.arange(max(tasks.m, problem.m))
    if len(carrier) != problem.n or len(place) != problem.m or positions.shape[0] < problem.T:
        raise ValueError(
            f"scenario: it has {positions.shape[0]} steps, {len(carrier)} agents and {len(place)} tasks, the problem "
            f"{problem.T}, {problem.n} and {problem.m}; pass the scenario that the problem was made from"
        )
    x, y, z = np.moveaxis(positions[: problem.T, carrier], 2, 0)
    radius = np.sqrt(x * x + y * y + z * z)
    ground = np.stack([np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z / radius))], axis=-1)
    # Tasks that the problem has beyond those of the constellation are places to idle.
    known = np.zeros((3, int(place.max()) + 1))
    known[:, : tasks.m] = tasks.longitude_deg, tasks.latitude_deg, tasks.priority
    longitude, latitude, priority = known[:, place]
    land = coastline_data()
    return {
        "tracks": _base64(np.round(ground * 180.0).astype(np.int16)),  # units of 1/180 degree: 20 s of arc
        "places": _base64(np.round(np.stack([longitude, latitude], axis=-1) * 180.0).astype(np.int16)),
        "priority": _rounded(priority),
        "footprint": float(np.degrees(base.field_of_view.footprint_rad(radius).mean())),
        "step_s": base.step_s,
        "land": {"unit": land["unit_deg"], "rings": land["rings"], "source": land["source"]},
    }


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), 5) for value in values]


def _levels(values: FloatArray, kind: Any) -> dict[str, Any]:
    """Values from 0 to `top` as integers of `kind`; a value above 0 never becomes 0."""
    top = float(values.max(initial=0.0))
    most = np.iinfo(kind).max
    scaled = np.round(values * (most / top)) if top > 0 else np.zeros(values.shape)
    scaled = np.maximum(scaled, values > 0)
    return {"data": _base64(scaled.astype(kind)), "top": top, "bytes": int(np.dtype(kind).itemsize)}


def _base64(array: np.ndarray) -> str:
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return base64.b64encode(np.ascontiguousarray(little).tobytes()).decode("ascii")
