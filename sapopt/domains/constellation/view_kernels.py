"""Compiled loops of the visibility search."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit

_SMALL = 10_000
_INSERT = 64  # ranges up to this length are sorted by plain insertion


@njit(cache=True, borrows=True, no_cpython_wrapper=True)
def _band(ground: FloatArray, sine_latitude: float, footprint: float) -> Any:
    """Range of the south-to-north sorted `ground` points whose latitude a satellite can see."""
    latitude = math.asin(min(1.0, max(-1.0, sine_latitude)))
    half_pi = 0.5 * math.pi
    # A hair wider than needed, so that rounding never cuts the edge; the exact test follows.
    south = max(-half_pi, latitude - footprint - 1e-9)
    north = min(half_pi, latitude + footprint + 1e-9)
    return _first_above(ground, math.sin(south) - 2e-15), _first_above(ground, math.sin(north) + 1e-15)


@njit(cache=True, borrows=True, no_cpython_wrapper=True)
def _first_above(ground: FloatArray, z: float) -> int:
    """The first of the south-to-north sorted `ground` points that lies north of `z`."""
    low, high = 0, len(ground)
    while low < high:
        middle = (low + high) // 2
        if ground[middle, 2] > z:
            high = middle
        else:
            low = middle + 1
    return low


@njit(cache=True, borrows=True, no_cpython_wrapper=True)
def _sort(values: IntArray, begin: int, end: int) -> None:
    """Sort a range in ascending order (Shell's sort; numba's own takes seconds to compile)."""
    gap = 1
    while gap < (end - begin) // _INSERT:
        gap = 3 * gap + 1
    while gap > 0:
        for e in range(begin + gap, end):
            value = values[e]
            q = e
            while q >= begin + gap and values[q - gap] > value:
                values[q] = values[q - gap]
                q -= gap
            values[q] = value
        gap //= 3


@njit(cache=True, small=_SMALL)
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
                _sort(indices, indptr[row], count)
            else:
                indptr[row + 1] = count
    return indptr, indices


@njit(cache=True, small=_SMALL)
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
            share = min(off_nadir, half_angle) / sigma
            data[entry] = math.exp(-0.5 * (share * share))
    return data
