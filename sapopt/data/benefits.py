"""Benefits of agents for tasks over time: dense, sparse, or computed step by step."""

from __future__ import annotations

import operator
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray, index_array, real_array

StepMatrix: TypeAlias = np.ndarray | sp.csr_array
"""The benefits of one step: an ``(n, m)`` array or a CSR matrix of that shape."""

_STEPS_KEPT = 32
"""Steps of a function-backed `Benefits` that stay in memory; more than any lookahead in use."""


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


class Benefits:
    """The static benefits beta, shape ``(T, n, m)``, time first.

    Build it from a dense array or a list of sparse matrices with ``Benefits(values)``, from one flat CSR with
    `from_flat`, or from a function of the step with `from_function`. The values are copied only where their form
    has to change; they must not be modified afterwards.

    Parameters
    ----------
    values : array_like of shape (T, n, m), sequence of T sparse matrices of shape (n, m), or Benefits
        Finite numbers; ``-inf`` marks a pair that is forbidden at that step.

    Raises
    ------
    ValueError
        If the values are ragged, empty, or contain NaN or +inf.
    """

    shape: tuple[int, int, int]

    def __init__(self, values: Any) -> None:
        self._dense: FloatArray | None = None
        self._flat: Flat | None = None
        self._function: Callable[[int], Any] | None = None
        self._kept: OrderedDict[int, StepMatrix] = OrderedDict()
        self._offset = 0
        if isinstance(values, Benefits):
            self.__dict__.update(values.__dict__)
        elif isinstance(values, (list, tuple)) and len(values) > 0 and any(sp.issparse(v) for v in values):
            self._flat, self.shape = _flatten(values)
        elif sp.issparse(values):
            raise ValueError(
                "benefits: one sparse matrix is one step; pass a list with a matrix for every step"
            )
        else:
            self._dense = _dense_array(values)
            self.shape = (self._dense.shape[0], self._dense.shape[1], self._dense.shape[2])

    @classmethod
    def from_flat(cls, indptr: Any, indices: Any, data: Any, shape: tuple[int, int, int]) -> Benefits:
        """Build from one CSR over all steps (row ``k * n + i`` is agent i at step k), see `Flat`.

        Raises
        ------
        ValueError
            If the arrays do not describe such a matrix, or hold NaN or +inf.
        """
        steps, n, m = _checked_shape(shape)
        matrix = sp.csr_array(
            (real_array(data, "data"), index_array(indices, "indices"), index_array(indptr, "indptr")),
            shape=(steps * n, m),
        )
        matrix.check_format(full_check=True)
        out = cls.__new__(cls)
        out.__dict__.update(_dense=None, _function=None, _kept=OrderedDict(), _offset=0)
        out._flat = _canonical(matrix)
        _check_values(out._flat.data, "benefits")
        out.shape = (steps, n, m)
        return out

    @classmethod
    def from_function(cls, function: Callable[[int], Any], shape: tuple[int, int, int]) -> Benefits:
        """Build from a function of the step, called when a step is first needed.

        Parameters
        ----------
        function : callable
            ``function(k)`` returns the ``(n, m)`` array or sparse matrix of step k (0-based), the same at every call.
        shape : (T, n, m)
        """
        out = cls.__new__(cls)
        out.__dict__.update(_dense=None, _flat=None, _kept=OrderedDict(), _offset=0)
        out._function = function
        out.shape = _checked_shape(shape)
        return out

    def __repr__(self) -> str:
        steps, n, m = self.shape
        form = "function" if self._function is not None else "sparse" if self._flat is not None else "dense"
        return f"Benefits(T={steps}, n={n}, m={m}, {form})"

    @property
    def is_sparse(self) -> bool:
        """Whether the steps are CSR matrices."""
        return self._flat is not None or (self._function is not None and sp.issparse(self.step(0)))

    def step(self, k: int) -> StepMatrix:
        """Benefits of step k, 0-based: ``(n, m)`` array, or CSR matrix if sparse."""
        steps, n, m = self.shape
        if not 0 <= k < steps:
            raise ValueError(f"step {k} is outside 0..{steps - 1}")
        if self._dense is not None:
            return self._dense[k]
        if self._flat is not None:
            indptr = self._flat.indptr[k * n : (k + 1) * n + 1]
            span = slice(indptr[0], indptr[-1])
            return sp.csr_array(
                (self._flat.data[span], self._flat.indices[span], indptr - indptr[0]), shape=(n, m)
            )
        return self._computed(k)

    def _computed(self, k: int) -> StepMatrix:
        assert self._function is not None
        if k in self._kept:
            self._kept.move_to_end(k)
            return self._kept[k]
        _, n, m = self.shape
        raw = self._function(k + self._offset)
        value: StepMatrix
        name = f"benefits at step {k + self._offset}"
        if sp.issparse(raw):
            flat = _canonical(_real_csr(raw, name))
            value = sp.csr_array((flat.data, flat.indices, flat.indptr), shape=raw.shape)
            _check_values(flat.data, name)
        else:
            value = real_array(raw, name).copy()  # the function may fill one buffer again and again
            _check_values(value, name)
        if value.shape != (n, m):
            raise ValueError(f"{name} have shape {value.shape}, expected {(n, m)}")
        self._kept[k] = value
        if len(self._kept) > _STEPS_KEPT:
            self._kept.popitem(last=False)
        return value

    def slice(self, start: int, stop: int) -> Benefits:
        """Benefits of the steps ``start .. stop - 1``, without a copy."""
        steps, n, m = self.shape
        if not 0 <= start < stop <= steps:
            raise ValueError(f"steps {start}..{stop - 1} are not within 0..{steps - 1}")
        out = Benefits.__new__(Benefits)
        out.__dict__.update(self.__dict__, _kept=OrderedDict(), shape=(stop - start, n, m))
        if self._dense is not None:
            out._dense = self._dense[start:stop]
        elif self._flat is not None:
            indptr = self._flat.indptr[start * n : stop * n + 1]
            span = slice(indptr[0], indptr[-1])
            out._flat = Flat(indptr - indptr[0], self._flat.indices[span], self._flat.data[span])
        else:
            out._offset = self._offset + start
        return out

    def flat(self) -> Flat:
        """All steps as one CSR; a dense array gives up its zeros."""
        if self._flat is not None:
            return self._flat
        return _flatten([sp.csr_array(self.step(k)) for k in range(self.shape[0])])[0]

    def dense(self) -> FloatArray:
        """All steps as an array of shape ``(T, n, m)``."""
        if self._dense is not None:
            return self._dense
        return np.stack([dense_step(self.step(k)) for k in range(self.shape[0])])

    def at(self, plan: IntArray) -> FloatArray:
        """Benefit of every agent at every step of a plan.

        Parameters
        ----------
        plan : ndarray of int, shape (T, n)

        Returns
        -------
        ndarray of float64, shape (T, n)
        """
        steps, n, _ = self.shape
        plan = np.asarray(plan)
        if self._dense is not None:
            return np.take_along_axis(self._dense, plan[:, :, None], axis=2)[:, :, 0]
        return np.stack([_gather(self.step(k), plan[k]) for k in range(steps)])

    def window(self, start: int, stop: int) -> StepMatrix:
        """Sum of the benefits of the steps ``start .. stop - 1``, as array or CSR matrix."""
        total = self.step(start)
        for k in range(start + 1, stop):
            total = total + self.step(k)
        return total

    def task_totals(self) -> FloatArray:
        """Benefit of every task summed over agents and steps, shape ``(m,)``; forbidden pairs count nothing."""
        total = np.zeros(self.shape[2])
        for k in range(self.shape[0]):
            step = self.step(k)
            if isinstance(step, np.ndarray):
                total += np.maximum(step, 0.0).sum(axis=0)
            else:
                worth = np.maximum(step.data, 0.0)
                total += np.bincount(step.indices, weights=worth, minlength=len(total))
        return total

    def with_idle_tasks(self, count: int | None = None) -> Benefits:
        """Append `count` tasks of zero benefit (by default one per agent), so that agents can idle."""
        steps, n, m = self.shape
        extra = n if count is None else int(count)
        if extra < 0:
            raise ValueError(f"count must not be negative, got {extra}")
        if self._flat is not None:
            out = Benefits.__new__(Benefits)
            out.__dict__.update(self.__dict__, shape=(steps, n, m + extra))
            return out
        if self._dense is not None:
            return Benefits(np.concatenate([self._dense, np.zeros((steps, n, extra))], axis=2))

        def widened(k: int) -> StepMatrix:
            value = self.step(k)
            if isinstance(value, np.ndarray):
                return np.concatenate([value, np.zeros((n, extra))], axis=1)
            return sp.csr_array((value.data, value.indices, value.indptr), shape=(n, m + extra))

        return Benefits.from_function(widened, (steps, n, m + extra))

    def forbids(self) -> bool:
        """Whether some pair is forbidden (``-inf``) at some step."""
        if self._dense is not None:
            return bool(np.isneginf(self._dense).any())
        if self._flat is not None:
            return bool(np.isneginf(self._flat.data).any())
        return any(_has_neginf(self.step(k)) for k in range(self.shape[0]))


def dense_step(step: StepMatrix) -> FloatArray:
    """One step as an ``(n, m)`` array."""
    return step if isinstance(step, np.ndarray) else step.toarray()


def _has_neginf(step: StepMatrix) -> bool:
    return bool(np.isneginf(step if isinstance(step, np.ndarray) else step.data).any())


def _gather(step: StepMatrix, tasks: IntArray) -> FloatArray:
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


def _checked_shape(shape: Sequence[int]) -> tuple[int, int, int]:
    try:
        steps, n, m = (operator.index(s) for s in shape)
    except (TypeError, ValueError):
        steps, n, m = 0, 0, 0
    if min(steps, n, m) < 1:
        raise ValueError(f"benefits need a shape (T, n, m) of three positive whole numbers, got {shape!r}")
    return steps, n, m


def _check_values(values: FloatArray, name: str) -> None:
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


def _dense_array(values: Any) -> FloatArray:
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
    _checked_shape(array.shape)
    _check_values(array, "benefits")
    return array


def _real_csr(value: Any, name: str) -> sp.csr_array:
    if value.dtype.kind not in "biuf":
        raise ValueError(f"{name} must be real numbers, got {value.dtype}")
    return sp.csr_array(value, dtype=np.float64)


def _canonical(matrix: sp.csr_array) -> Flat:
    if not matrix.has_canonical_format or (matrix.data == 0).any():
        matrix = matrix.copy()
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
    return Flat(
        np.asarray(matrix.indptr, dtype=np.int64),
        np.asarray(matrix.indices, dtype=np.int32),
        np.asarray(matrix.data, dtype=np.float64),
    )


def _flatten(values: Sequence[Any]) -> tuple[Flat, tuple[int, int, int]]:
    parts: list[Flat] = []
    first: tuple[int, ...] = ()
    for k, value in enumerate(values):
        name = f"benefits at step {k}"
        matrix = value if sp.issparse(value) else real_array(value, name)
        first = first or matrix.shape
        if matrix.shape != first or len(first) != 2:
            raise ValueError(f"{name} have shape {matrix.shape}, step 0 has {first}; all must be (n, m)")
        flat = _canonical(_real_csr(matrix, name))
        _check_values(flat.data, name)
        parts.append(flat)
    shape = _checked_shape((len(values), *first))
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
