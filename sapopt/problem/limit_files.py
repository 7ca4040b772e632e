"""Limits as plain values and arrays: for files, and for a problem's fingerprint."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import real_csr
from sapopt.problem.limit import Limit, Team

_KINDS = ("weight", "once", "visits", "cover", "work", "handovers")


def described_limits(limits: tuple[Limit | Team, ...]) -> tuple[dict[str, Any], dict[str, Any]]:
    """What decides the limits, under names that begin with ``limit``; nothing where there are none."""
    if not limits:
        return {}, {}
    arrays: dict[str, Any] = {}
    told = []
    for number, limit in enumerate(limits):
        if isinstance(limit, Team):
            told.append({"kind": "team", "task": limit.task, "needs": int(limit.needs), "reward": limit.reward,
                         "steps": _listed(limit.steps)})  # fmt: skip
            continue
        entry: dict[str, Any] = {"kind": limit.kind, "at_most": limit.at_most, "at_least": limit.at_least,
                                 "name": limit.name, "penalty": limit.penalty, "each": limit.each}  # fmt: skip
        for name in ("tasks", "agents", "steps"):
            entry[name] = _listed(getattr(limit, name))
        if limit.served:  # older files do not know it
            entry["served"] = True
        if limit.kind == "weight":
            entry["form"], parts = _weight(limit.weight)
            arrays |= {f"limit.{number}.{key}": value for key, value in parts.items()}
        told.append(entry)
    return {"limits": told}, arrays


def rebuilt_limits(meta: dict[str, Any], arrays: dict[str, Any]) -> tuple[Limit | Team, ...]:
    """Undo `described_limits`.

    Raises
    ------
    ValueError, KeyError, TypeError
        If the values are not those of limits.
    """
    out: list[Limit | Team] = []
    for number, entry in enumerate(meta.get("limits", [])):
        if entry["kind"] == "team":
            out.append(Team(entry["task"], entry["needs"], entry["reward"], entry["steps"]))
            continue
        if entry["kind"] not in _KINDS:
            raise ValueError(
                f"unknown kind of limit {entry['kind']!r}; the file was written by another version"
            )
        parts = {key: arrays.get(f"limit.{number}.{key}") for key in ("dense", "indptr", "indices", "data")}
        limit = Limit(
            _unpacked(entry.get("form"), parts), entry["at_most"], entry["at_least"], name=entry["name"],
            penalty=entry["penalty"],
        )  # fmt: skip
        for name in ("kind", "tasks", "agents", "steps", "each"):
            object.__setattr__(limit, name, entry[name])
        object.__setattr__(limit, "served", bool(entry.get("served", False)))
        out.append(limit)
    return tuple(out)


def _listed(chosen: Any) -> Any:
    """Indices or labels as plain values."""
    if chosen is None or isinstance(chosen, str):
        return chosen
    if isinstance(chosen, np.ndarray):
        return np.flatnonzero(chosen).tolist() if chosen.dtype == bool else chosen.tolist()
    if isinstance(chosen, (list, tuple, range)):
        return [value if isinstance(value, str) else int(value) for value in chosen]
    if isinstance(chosen, (set, frozenset)):
        return sorted((value if isinstance(value, str) else int(value) for value in chosen), key=str)
    return int(chosen)


def _weight(weight: Any) -> tuple[list[int] | None, dict[str, Any]]:
    if isinstance(weight, (list, tuple)) and any(sp.issparse(w) for w in weight):
        stacked = sp.csr_array(sp.vstack([real_csr(w, "weight") for w in weight], format="csr"))
        stacked.sum_duplicates()
        parts = {"indptr": stacked.indptr.astype(np.int64), "indices": stacked.indices.astype(np.int64),
                 "data": stacked.data}  # fmt: skip
        return [len(weight), *weight[0].shape], parts
    return None, {"dense": np.asarray(weight, dtype=np.float64)}


def _unpacked(form: list[int] | None, parts: dict[str, Any]) -> Any:
    if form is None:
        return parts["dense"]
    steps, n, m = form
    stacked = sp.csr_array((parts["data"], parts["indices"], parts["indptr"]), shape=(steps * n, m))
    return [stacked[k * n : (k + 1) * n] for k in range(steps)]
