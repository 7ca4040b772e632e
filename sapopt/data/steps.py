"""The forms in which the benefits of steps are held: an array, or one CSR over all steps; and the checks of both."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray, real_array, real_csr

StepMatrix: TypeAlias = np.ndarray | sp.csr_array
"""The benefits of one step: an ``(n, m)`` array or a CSR matrix of that shape."""


@dataclass(frozen=True, eq=False)
class Flat:
    """One CSR matrix over all steps: row ``k * n + i`` holds the benefits of agent i at step k.

    Attributes
    ----------
    indptr : ndarray of int64, shape (T * n + 1,)
        Row offsets.
    indices : ndarray of int32, shape (nnz,)
        Tasks, ascending and unique inside a row.
    data : ndarray of float64, shape (nnz,)
        Benefits; pairs that are not stored have benefit 0.
    """

    indptr: IntArray
    indices: np.ndarray
    data: FloatArray


def dense_step(step: StepMatrix) -> FloatArray:
    """One step as an ``(n, m)`` array."""
    return step if isinstance(step, np.ndarray) else step.toarray()


def forbidding(step: StepMatrix) -> bool:
    """Whether a pair of the step is forbidden."""
    return bool(np.isneginf(step if isinstance(step, np.ndarray) else step.data).any())


def gather(step: StepMatrix, tasks: IntArray) -> FloatArray:
    """Benefit of every agent under an assignment, shape ``(n,)``."""
    agents = np.arange(len(tasks))
    if isinstance(step, np.ndarray):
        return np.asarray(step[agents, tasks])
    # A binary search in every row at once: tasks ascend inside a row, so `row * m + task` ascends over the matrix.
    n, m = step.shape
    if step.nnz == 0:
        return np.zeros(n)
    keys = np.repeat(agents, np.diff(step.indptr)) * m + step.indices
    wanted = agents * m + tasks
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[place] == wanted, step.data[place], 0.0)


def checked_shape(shape: Sequence[int]) -> tuple[int, int, int]:
    """Three positive whole numbers, or a ValueError."""
    try:
        steps, n, m = (operator.index(s) for s in shape)
    except (TypeError, ValueError):
        steps, n, m = 0, 0, 0
    if min(steps, n, m) < 1:
        raise ValueError(f"benefits need a shape (T, n, m) of three positive whole numbers, got {shape!r}")
    return steps, n, m


def check_values(values: FloatArray, name: str) -> None:
    """Refuse NaN, +inf, and numbers whose sum overflows."""
    # The sum is finite for almost every valid input, and one pass is all that then happens.
    with np.errstate(over="ignore", invalid="ignore"):
        total = values.sum()
    if np.isfinite(total):
        return
    if np.isnan(values).any():
        where = (
            ""
            if values.ndim == 1
            else f" (first at index {tuple(int(i) for i in np.argwhere(np.isnan(values))[0])})"
        )
        raise ValueError(f"{name} contain NaN{where}; use 0 for no benefit or -inf for a forbidden pair")
    if np.isposinf(values).any():
        raise ValueError(f"{name} contain +inf; use a finite number")
    with np.errstate(over="ignore"):
        if not np.isfinite(values[np.isfinite(values)].sum()):
            raise ValueError(f"{name} are so large that their sum overflows")


def dense_array(values: Any) -> FloatArray:
    """Values from outside as a checked array ``(T, n, m)``."""
    try:
        array = real_array(values, "values")
    except ValueError as error:
        raise ValueError(
            "benefits must be a (T, n, m) array of numbers with the same n and m at every step, "
            f"or a list of sparse matrices ({error})"
        ) from None
    if array.ndim != 3:
        hint = "; for a single step pass values[None]" if array.ndim == 2 else ""
        raise ValueError(f"benefits must have three axes (T, n, m), got shape {array.shape}{hint}")
    checked_shape(array.shape)
    check_values(array, "benefits")
    return array


def canonical(matrix: sp.csr_array) -> Flat:
    """Rows with ascending tasks, none of them twice, none of benefit zero."""
    if not matrix.has_canonical_format or (matrix.data == 0).any():
        matrix = matrix.copy()
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
    return Flat(
        np.asarray(matrix.indptr, dtype=np.int64),
        np.asarray(matrix.indices, dtype=np.int32),
        np.asarray(matrix.data, dtype=np.float64),
    )


def flatten(values: Sequence[Any]) -> tuple[Flat, tuple[int, int, int]]:
    """One CSR of steps from outside, at least one of them sparse, and the shape ``(T, n, m)``."""
    parts: list[Flat] = []
    first: tuple[int, ...] = ()
    for k, value in enumerate(values):
        name = f"benefits at step {k}"
        matrix = value if sp.issparse(value) else real_array(value, name)
        first = first or matrix.shape
        if matrix.shape != first or len(first) != 2:
            raise ValueError(f"{name} have shape {matrix.shape}, step 0 has {first}; all must be (n, m)")
        flat = canonical(real_csr(matrix, name))
        check_values(flat.data, name)
        parts.append(flat)
    shape = checked_shape((len(values), *first))
    starts = np.concatenate([[0], np.cumsum([len(p.data) for p in parts])])
    indptr = np.concatenate([[0]] + [p.indptr[1:] + s for p, s in zip(parts, starts[:-1], strict=True)])
    return (
        Flat(
            indptr.astype(np.int64),
            np.concatenate([p.indices for p in parts]),
            np.concatenate([p.data for p in parts]),
        ),
        shape,
    )


def flatten_array(dense: FloatArray) -> Flat:
    """One CSR of the entries of a ``(T, n, m)`` array that are not zero."""
    steps, n, m = dense.shape
    counts: list[np.ndarray] = [np.zeros(1, dtype=np.int64)]
    indices: list[np.ndarray] = []
    data: list[FloatArray] = []
    for step in dense:
        place = np.flatnonzero(step != 0)  # by way of truth values twice as fast as from the numbers
        counts.append(np.bincount(place // m, minlength=n))
        indices.append((place % m).astype(np.int32))
        data.append(step.ravel()[place] if step.flags.c_contiguous else step[place // m, place % m])
    return Flat(np.cumsum(np.concatenate(counts)), np.concatenate(indices), np.concatenate(data))
