"""The land of the Earth for maps: simplified rings of Natural Earth (public domain), see `tools/coastline.py`."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray


@cache
def coastline_data() -> dict[str, Any]:
    """The file as it is: ``rings`` of whole numbers (first point, then differences) in units of ``unit_deg``."""
    path = files("sapopt.plotting") / "data" / "coastline.json"
    data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return data


def coastline_deg() -> list[FloatArray]:
    """Outlines of the land, the longest first.

    Returns
    -------
    list of ndarray, each of shape (points, 2)
        Longitude and latitude in degrees; the first point is repeated at the end.
    """
    data = coastline_data()
    rings = (np.cumsum(np.reshape(ring, (-1, 2)), axis=0) * data["unit_deg"] for ring in data["rings"])
    return [np.concatenate([ring, ring[:1]]) for ring in rings]
