"""Benefit matrices of one assignment problem, in the form the sparse kernel reads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray, real_array, real_csr


@dataclass(frozen=True, eq=False)
class GainMatrix:
    """An ``(n, m)`` benefit matrix in which all unlisted pairs have one common value.

    The value of pair (i, j) is ``rest + held_gain[i]`` if ``j == held[i]``, else ``rest`` plus the listed gain, else
    ``rest``. This is beta_hat of a sparse problem with a switching cost: idling costs the same on any task.

    Attributes
    ----------
    row_start : ndarray of int64, shape (n + 1,)
    tasks : ndarray of int32, shape (nnz,)
    gains : ndarray of float64, shape (nnz,)
        Sorted by decreasing gain inside a row, equal gains by ascending task.
    held : ndarray of int64, shape (n,)
        Task with a gain of its own, -1 for none.
    held_gain : ndarray of float64, shape (n,)
    rest : float
    m : int
        Number of tasks.
    has_negative : bool
        Whether a gain is negative, so that idle agents must look where they park.
    """

    row_start: IntArray
    tasks: np.ndarray
    gains: FloatArray
    held: IntArray
    held_gain: FloatArray
    rest: float
    m: int
    has_negative: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """``(n, m)``."""
        return len(self.held), self.m

    @classmethod
    def from_matrix(cls, matrix: np.ndarray | sp.csr_array) -> GainMatrix:
        """Read a dense or sparse matrix; pairs of value zero are the common value."""
        from sapopt.kernels.windows import window_gains

        csr = sp.csr_array(matrix)
        n, m = csr.shape
        indptr, indices = csr.indptr.astype(np.int64), csr.indices.astype(np.int32)
        data = csr.data.astype(np.float64)
        row_start, tasks, gains = window_gains(indptr, indices, data, 0, 1, n, m, 0.0)
        negative = bool(len(data) and data.min() < 0)
        return cls(row_start, tasks, gains, np.full(n, -1), np.zeros(n), 0.0, m, negative)

    def toarray(self) -> FloatArray:
        """The matrix as an array of shape ``(n, m)``."""
        n, m = self.shape
        out = np.full((n, m), self.rest)
        rows = np.repeat(np.arange(n), np.diff(self.row_start))
        out[rows, self.tasks] = self.rest + self.gains
        holds = np.flatnonzero(self.held >= 0)
        out[holds, self.held[holds]] = self.rest + self.held_gain[holds]
        return out

    def plus(self, matrix: sp.csr_array) -> GainMatrix:
        """The sum with a sparse matrix of shape ``(n, m)`` without forbidden pairs."""
        n, m = self.shape
        listed = sp.csr_array((self.gains, self.tasks, self.row_start), shape=(n, m))
        total = GainMatrix.from_matrix(sp.csr_array(listed + matrix))
        holds = np.flatnonzero(self.held >= 0)
        held_gain = self.held_gain.copy()
        if len(holds):  # scipy cannot take an empty list of entries
            held_gain[holds] += np.asarray(sp.csr_array(matrix)[holds, self.held[holds]]).ravel()
        return replace(total, held=self.held, held_gain=held_gain, rest=self.rest)

    def value(self, assignment: IntArray) -> float:
        """Total benefit of an assignment."""
        from sapopt.kernels.matching import total_gain

        gain = total_gain(self.row_start, self.tasks, self.gains, self.held, self.held_gain, assignment)
        return float(gain + len(self.held) * self.rest)


Matrix: TypeAlias = FloatArray | GainMatrix


def checked_matrix(matrix: Any) -> Matrix:
    """A matrix from outside: sparse without negative entries as a GainMatrix, else as an array.

    Raises
    ------
    ValueError
        If it has not two axes, or holds NaN, +inf or anything but real numbers.
    """
    if isinstance(matrix, GainMatrix):
        return matrix
    is_sparse = sp.issparse(matrix)
    if is_sparse:
        matrix = real_csr(matrix, "matrix")
    values = real_array(matrix.data if is_sparse else matrix, "matrix")
    shape = matrix.shape if is_sparse else values.shape
    if len(shape) != 2 or 0 in shape:
        raise ValueError(f"matrix must have shape (n, m), got {shape}")
    if np.isnan(values).any() or np.isposinf(values).any():
        raise ValueError("matrix contains NaN or +inf; use -inf for a forbidden pair")
    if not is_sparse:
        return values
    if len(values) == 0 or values.min() >= 0:
        return GainMatrix.from_matrix(matrix)
    dense: FloatArray = matrix.toarray().astype(np.float64)
    return dense


def value_of(matrix: Matrix, assignment: IntArray) -> float:
    """Total benefit of an assignment under a matrix of either form."""
    if isinstance(matrix, GainMatrix):
        return matrix.value(assignment)
    return float(matrix[np.arange(len(assignment)), assignment].sum())
