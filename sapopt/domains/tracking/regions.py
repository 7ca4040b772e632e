"""Hexagons of the H3 grid over the contiguous United States."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray

US_OUTLINE_DEG = (
    (48.4, -124.7), (49.0, -123.0), (49.0, -95.2), (48.6, -93.3), (47.9, -89.6), (46.5, -84.6), (45.8, -83.5),
    (43.0, -82.4), (41.7, -83.1), (42.3, -81.2), (43.3, -79.0), (44.3, -76.2), (45.0, -74.7), (45.2, -71.4),
    (47.4, -69.2), (47.3, -68.0), (45.2, -67.2), (44.8, -66.95), (43.6, -70.2), (41.7, -70.0), (40.6, -73.8),
    (38.0, -75.3), (35.2, -75.5), (33.9, -78.0), (31.0, -81.3), (28.5, -80.5), (25.2, -80.4), (25.8, -81.7),
    (28.0, -82.8), (29.8, -84.2), (30.3, -87.5), (29.2, -89.4), (29.7, -93.8), (28.0, -97.0), (25.9, -97.2),
    (27.5, -99.5), (29.8, -101.4), (29.0, -103.2), (31.8, -106.5), (31.3, -109.0), (31.35, -111.1),
    (32.5, -114.8), (32.55, -117.1), (34.4, -120.5), (36.6, -121.9), (38.9, -123.7), (40.4, -124.4),
    (43.0, -124.5), (46.3, -124.0),
)  # fmt: skip
"""A coarse outline of the contiguous United States: latitude and longitude in degrees."""


@dataclass(frozen=True, eq=False)
class Regions:
    """Cells of the H3 grid.

    Attributes
    ----------
    cells : tuple of str
        H3 indices, sorted.
    resolution : int
        H3 resolution: 2 has 90 cells of 87 000 km2 over the United States, 3 has 633 of 12 000 km2, 4 has 4433.
    latitude_deg, longitude_deg : ndarray, shape (R,)
        Centres.
    """

    cells: tuple[str, ...]
    resolution: int
    latitude_deg: FloatArray
    longitude_deg: FloatArray

    def __len__(self) -> int:
        return len(self.cells)

    def containing(self, latitude_deg: Any, longitude_deg: Any) -> IntArray:
        """Number of the region that each point lies in, -1 outside of all."""
        h3 = require_h3()
        known = {cell: index for index, cell in enumerate(self.cells)}
        latitude, longitude = np.broadcast_arrays(latitude_deg, longitude_deg)
        flat = zip(latitude.ravel().tolist(), longitude.ravel().tolist(), strict=True)
        found = [known.get(h3.latlng_to_cell(a, b, self.resolution), -1) for a, b in flat]
        return np.array(found, dtype=np.int64).reshape(latitude.shape)


def us_regions(resolution: int = 3) -> Regions:
    """The cells whose centres lie in the contiguous United States.

    Raises
    ------
    ImportError
        If h3 is not installed.
    ValueError
        If the resolution is not one of H3 that leaves a cell, 1 to 5.
    """
    h3 = require_h3()
    if isinstance(resolution, bool) or int(resolution) != resolution or not 1 <= resolution <= 5:
        raise ValueError(f"resolution must be a whole number in 1..5, got {resolution!r}")
    cells = tuple(sorted(h3.polygon_to_cells(h3.LatLngPoly(US_OUTLINE_DEG), int(resolution))))
    centres = np.array([h3.cell_to_latlng(cell) for cell in cells])
    return Regions(cells, int(resolution), centres[:, 0], centres[:, 1])


def require_h3() -> Any:
    """The module h3, or an error that says how to get it."""
    try:
        import h3
    except ImportError:
        raise ImportError("object tracking needs the package h3: pip install 'sapopt[space]'") from None
    return h3
