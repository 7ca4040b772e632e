"""Sums of benefits over windows of steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.benefits import Benefits, StepMatrix, dense_step
from sapopt.data.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class GainRows:
    """Window sums as CSR rows sorted by decreasing gain."""

    row_start: IntArray
    tasks: np.ndarray
    gains: FloatArray
    has_negative: bool

    @property
    def arrays(self) -> tuple[IntArray, np.ndarray, FloatArray]:
        """Row offsets, tasks, gains."""
        return self.row_start, self.tasks, self.gains


class WindowSums:
    """Sums of benefits over windows of steps, each computed once.

    Parameters
    ----------
    benefits : Benefits
    first : int
        Step of the problem that step 0 of `benefits` stands for (forecasts start at the current step).
    """

    def __init__(self, benefits: Benefits, first: int = 0) -> None:
        self.benefits = benefits
        self.first = first
        self.n, self.m = benefits.shape[1:]
        self.end = first + benefits.shape[0]
        self.is_sparse = benefits.is_sparse
        self._gains: dict[tuple[int, int, float], GainRows] = {}
        self._sparse: dict[tuple[int, int], StepMatrix] = {}
        self._dense: dict[tuple[int, int], FloatArray] = {}

    def slice(self, start: int, stop: int) -> Benefits:
        """Benefits of the steps ``start .. stop - 1`` of the problem."""
        return self.benefits.slice(start - self.first, stop - self.first)

    def gains(self, start: int, stop: int, entry_cost: float) -> GainRows:
        """Sparse window sum; `entry_cost` is subtracted from pairs of positive benefit at step `start`."""
        key = (start, stop, entry_cost)
        rows = self._gains.get(key)
        if rows is None:
            from sapopt.kernels.windows import window_gains

            flat = self.slice(start, stop).flat()
            row_start, tasks, gains = window_gains(
                flat.indptr, flat.indices, flat.data, 0, stop - start, self.n, self.m, entry_cost
            )
            rows = self._gains[key] = GainRows(row_start, tasks, gains, bool(len(gains) and gains.min() < 0))
        return rows

    def summed(self, start: int, stop: int) -> StepMatrix:
        """Window sum in the form of the benefits, sparse or dense."""
        if not self.is_sparse:
            return self.dense(start, stop)
        key = (start, stop)
        if key not in self._sparse:
            self._sparse[key] = self.benefits.window(start - self.first, stop - self.first)
        return self._sparse[key]

    def dense(self, start: int, stop: int) -> FloatArray:
        """Window sum as an array of shape ``(n, m)``."""
        key = (start, stop)
        if key not in self._dense:
            self._dense[key] = dense_step(self.benefits.window(start - self.first, stop - self.first))
        return self._dense[key]

    def forget(self, before: int) -> None:
        """Drop windows that start before a step."""
        self._gains = {key: rows for key, rows in self._gains.items() if key[0] >= before}
        self._sparse = {key: sums for key, sums in self._sparse.items() if key[0] >= before}
        self._dense = {key: sums for key, sums in self._dense.items() if key[0] >= before}
