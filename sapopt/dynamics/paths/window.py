"""The benefits of a window as the compiled recursions of all families read them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray


def flat_benefits(
    benefits: Benefits | Any,
) -> tuple[IntArray, NDArray[np.int32], FloatArray, tuple[int, int, int]]:
    """Benefits as one CSR of T*n rows (row k*n + i): (indptr, indices, data, (T, n, m)). Explicit zeros are dropped.

    Parameters
    ----------
    benefits : Benefits or (T, n, m) float array
    """
    T, n, m = (int(d) for d in benefits.shape)
    if isinstance(benefits, Benefits) and benefits.is_sparse:
        flat = benefits.flat()
        indptr = np.ascontiguousarray(flat.indptr, dtype=np.int64)
        indices = np.ascontiguousarray(flat.indices, dtype=np.int32)
        data = np.ascontiguousarray(flat.data, dtype=np.float64)
        return indptr, indices, data, (T, n, m)
    dense = np.asarray(benefits.dense() if isinstance(benefits, Benefits) else benefits, dtype=np.float64)
    rows = dense.reshape(T * n, m)
    filled = rows != 0.0
    indptr = np.concatenate([[0], np.cumsum(filled.sum(axis=1))]).astype(np.int64)
    return indptr, np.nonzero(filled)[1].astype(np.int32), rows[filled], (T, n, m)


def checked_prices(prices: FloatArray, shape: tuple[int, int, int], columns: str = "") -> FloatArray:
    """Prices (T, columns) as the recursions of a window of `shape` (T, n, columns) read them.

    Raises
    ------
    ValueError
        If they have another shape. `columns` says in the message what the columns are if not the tasks alone.
    """
    p = np.ascontiguousarray(prices, dtype=np.float64)
    if p.shape != (shape[0], shape[2]):
        raise ValueError(f"prices: expected shape {(shape[0], shape[2])}{columns}, got {p.shape}")
    return p


def coldest_temperature(move: float) -> float:
    """Lowest temperature of soft paths whose dearest move costs `move`: its weight exp(-move / temperature) is 1e-130.

    Below it the weight of two moves, their product, leaves the range of floats.
    """
    return move / 300.0
