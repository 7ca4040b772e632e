"""Compiled loops of the visibility search. Import them where they are needed: this loads numba."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from sapopt.data.types import FloatArray, IntArray


@njit(cache=True)
def _band(ground: FloatArray, sine_latitude: float, footprint: float) -> Any:
    """Range of the south-to-north sorted `ground` points whose latitude a satellite can see."""
    latitude = math.asin(min(1.0, max(-1.0, sine_latitude)))
    half_pi = 0.5 * math.pi
    # A hair wider than needed, so that rounding never cuts the edge; the exact test follows.
    south = max(-half_pi, latitude - footprint - 1e-9)
    north = min(half_pi, latitude + footprint + 1e-9)
    z = ground[:, 2]
    return (
        np.searchsorted(z, math.sin(south) - 1e-15),
        np.searchsorted(z, math.sin(north) + 1e-15, side="right"),
    )


@njit(cache=True)
def visible_tasks(
    positions: FloatArray, footprint: FloatArray, ground: FloatArray, task_of_point: IntArray
) -> Any:
    """Tasks seen from each position, as rows of a CSR matrix without values.

    Parameters
    ----------
    positions : ndarray, shape (rows, 3)
    footprint : ndarray, shape (rows,)
        Largest angle at the Earth's centre to a visible task, radians.
    ground : ndarray, shape (m, 3)
        Directions of the tasks, sorted by their z.
    task_of_point : ndarray of int, shape (m,)
        Task of each of these directions.

    Returns
    -------
    indptr : ndarray of int64, shape (rows + 1,)
    indices : ndarray of int32, shape (nnz,)
        Ascending inside a row.
    """
    rows = positions.shape[0]
    indptr = np.zeros(rows + 1, dtype=np.int64)
    # Counting first costs a second search, and saves growing buffers of twice the memory.
    for fill in range(2):
        indices = np.empty(indptr[rows] if fill else 0, dtype=np.int32)
        for row in range(rows):
            x, y, z = positions[row]
            radius = math.sqrt(x * x + y * y + z * z)
            least = radius * math.cos(footprint[row])
            first, last = _band(ground, z / radius, footprint[row])
            count = indptr[row]
            for point in range(first, last):
                if x * ground[point, 0] + y * ground[point, 1] + z * ground[point, 2] >= least:
                    if fill:
                        indices[count] = task_of_point[point]
                    count += 1
            if fill:
                indices[indptr[row] : count].sort()
            else:
                indptr[row + 1] = count
    return indptr, indices


@njit(cache=True)
def proximities(
    positions: FloatArray,
    ground: FloatArray,
    indptr: IntArray,
    indices: IntArray,
    earth_radius: float,
    half_angle: float,
    sigma: float,
) -> FloatArray:
    """Proximity (eq. 4.1) of every stored pair; `ground` in the order of the tasks."""
    data = np.empty(len(indices), dtype=np.float64)
    for row in range(positions.shape[0]):
        x, y, z = positions[row]
        radius = math.sqrt(x * x + y * y + z * z)
        for entry in range(indptr[row], indptr[row + 1]):
            task = indices[entry]
            cosine = (x * ground[task, 0] + y * ground[task, 1] + z * ground[task, 2]) / radius
            sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
            off_nadir = math.atan2(earth_radius * sine, radius - earth_radius * cosine)
            # A task on the very edge may round to an angle beyond it.
            data[entry] = math.exp(-0.5 * (min(off_nadir, half_angle) / sigma) ** 2)
    return data
