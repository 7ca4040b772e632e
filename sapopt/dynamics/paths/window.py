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
