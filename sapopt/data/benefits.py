"""Benefits of agents for tasks over time: dense, sparse, or computed step by step."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.steps import (
    Flat,
    StepMatrix,
    canonical,
    check_values,
    checked_shape,
    dense_array,
    dense_step,
    flatten,
    flatten_array,
    forbidding,
    gather,
)
from sapopt.data.types import FloatArray, IntArray, index_array, real_array, real_csr

__all__ = ["Benefits", "Flat", "StepMatrix", "dense_step"]

_SPARSE_SHARE = 0.5
"""Benefits with at most this share of pairs other than zero are held sparse: a CSR then takes three quarters of the
memory of the array or less, and HAAL's compiled search, which reads CSR, is the faster one even where none is zero."""
_STEPS_KEPT = 32
"""Steps of a function-backed `Benefits` that stay in memory; more than any lookahead in use."""


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
    _dense: FloatArray | None = None
    _flat: Flat | None = None
    _function: Callable[[int], Any] | None = None
    _offset: int = 0  # of a function: the step that it has for our step 0
    _wants_sparse: bool | None = (
        None  # form in which the steps of a function are handed out; None: as they come
    )
    _forbids: bool | None = None  # of a function, once all its steps were seen

    def __init__(self, values: Any) -> None:
        self._kept: OrderedDict[int, StepMatrix] = OrderedDict()
        if isinstance(values, Benefits):
            self.__dict__.update(values.__dict__)
        elif isinstance(values, (list, tuple)) and len(values) > 0 and any(sp.issparse(v) for v in values):
            self._flat, self.shape = flatten(values)
        elif sp.issparse(values):
            raise ValueError(
                "benefits: one sparse matrix is one step; pass a list with a matrix for every step"
            )
        else:
            self._dense = dense_array(values)
            self.shape = (self._dense.shape[0], self._dense.shape[1], self._dense.shape[2])

    @classmethod
    def from_flat(cls, indptr: Any, indices: Any, data: Any, shape: tuple[int, int, int]) -> Benefits:
        """Build from one CSR over all steps (row ``k * n + i`` is agent i at step k), see `Flat`.

        Raises
        ------
        ValueError
            If the arrays do not describe such a matrix, or hold NaN or +inf.
        """
        steps, n, m = checked_shape(shape)
        matrix = sp.csr_array(
            (real_array(data, "data"), index_array(indices, "indices"), index_array(indptr, "indptr")),
            shape=(steps * n, m),
        )
        matrix.check_format(full_check=True)
        out = cls.__new__(cls)
        out._kept = OrderedDict()
        out._flat = canonical(matrix)
        check_values(out._flat.data, "benefits")
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
        out._kept = OrderedDict()
        out._function = function
        out.shape = checked_shape(shape)
        return out

    def __repr__(self) -> str:
        steps, n, m = self.shape
        form = "function" if self._function is not None else "sparse" if self._flat is not None else "dense"
        return f"Benefits(T={steps}, n={n}, m={m}, {form})"

    @property
    def is_sparse(self) -> bool:
        """Whether the steps are CSR matrices."""
        if self._function is not None:
            return sp.issparse(self.step(0)) if self._wants_sparse is None else self._wants_sparse
        return self._flat is not None

    def settled(self) -> Benefits:
        """The same benefits in the form that suits the numbers: sparse if at most half of the pairs are not zero.

        A problem holds its benefits like this, so that one problem has one speed and, where plans tie, one plan,
        however its benefits were given. A function is called for every step, and again later for steps that were
        dropped from memory; what it returns is handed out in the one form.

        Returns
        -------
        Benefits
            This very object if it is in that form.
        """
        steps, n, m = self.shape
        most = int(_SPARSE_SHARE * steps * n * m)
        if self._function is not None:
            return self if self._forbids is not None else self._surveyed(most)
        if self._flat is not None:
            return self if len(self._flat.data) <= most else Benefits(self.dense())
        assert self._dense is not None
        filled = 0
        for step in self._dense:
            filled += int(np.count_nonzero(step != 0))  # counting truth values is the fastest way
            if filled > most:
                return self
        out = Benefits.__new__(Benefits)
        out.__dict__.update(_kept=OrderedDict(), _flat=flatten_array(self._dense), shape=self.shape)
        return out

    def _surveyed(self, most: int) -> Benefits:
        """A function's benefits after a look at every step."""
        out = Benefits.__new__(Benefits)
        kept = OrderedDict(self._kept)  # steps that are in memory already, perhaps in another form
        out.__dict__.update(self.__dict__, _kept=kept, _wants_sparse=None, _forbids=False)
        filled = 0
        for k in range(self.shape[0]):
            step = out.step(k)
            filled += int(np.count_nonzero(step != 0)) if isinstance(step, np.ndarray) else step.nnz
            out._forbids = out._forbids or forbidding(step)
        out._wants_sparse = filled <= most
        for k, step in out._kept.items():
            out._kept[k] = out._handed_out(step)
        return out

    def _handed_out(self, step: StepMatrix) -> StepMatrix:
        """A function's step in the form that was settled on."""
        if self._wants_sparse is None or self._wants_sparse == sp.issparse(step):
            return step
        if sp.issparse(step):
            return dense_step(step)
        flat = flatten_array(np.asarray(step)[None])
        return sp.csr_array((flat.data, flat.indices, flat.indptr), shape=step.shape)

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
        k += self._offset
        if k in self._kept:
            self._kept.move_to_end(k)
            return self._kept[k]
        _, n, m = self.shape
        raw = self._function(k)
        value: StepMatrix
        name = f"benefits at step {k}"
        if sp.issparse(raw):
            flat = canonical(real_csr(raw, name))
            value = sp.csr_array((flat.data, flat.indices, flat.indptr), shape=raw.shape)
            check_values(flat.data, name)
        else:
            value = real_array(raw, name).copy()  # the function may fill one buffer again and again
            check_values(value, name)
        if value.shape != (n, m):
            raise ValueError(f"{name} have shape {value.shape}, expected {(n, m)}")
        value = self._kept[k] = self._handed_out(value)
        if len(self._kept) > _STEPS_KEPT:
            self._kept.popitem(last=False)
        return value

    def slice(self, start: int, stop: int) -> Benefits:
        """Benefits of the steps ``start .. stop - 1``, without a copy."""
        steps, n, m = self.shape
        if not 0 <= start < stop <= steps:
            raise ValueError(f"steps {start}..{stop - 1} are not within 0..{steps - 1}")
        out = Benefits.__new__(Benefits)
        out.__dict__.update(self.__dict__, shape=(stop - start, n, m))  # the steps in memory are shared
        if self._dense is not None:
            out._dense = self._dense[start:stop]
        elif self._flat is not None:
            indptr = self._flat.indptr[start * n : stop * n + 1]
            span = slice(indptr[0], indptr[-1])
            out._flat = Flat(indptr - indptr[0], self._flat.indices[span], self._flat.data[span])
        else:
            out._offset = self._offset + start
            out._forbids = None  # the steps that forbid may lie outside
        return out

    def flat(self) -> Flat:
        """All steps as one CSR; a dense array gives up its zeros."""
        if self._flat is not None:
            return self._flat
        if self._dense is not None:
            return flatten_array(self._dense)
        return flatten([sp.csr_array(self.step(k)) for k in range(self.shape[0])])[0]

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
        return np.stack([gather(self.step(k), plan[k]) for k in range(steps)])

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
            out.__dict__.update(self.__dict__, _kept=OrderedDict(), shape=(steps, n, m + extra))
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
        if self._forbids is not None:
            return self._forbids
        return any(forbidding(self.step(k)) for k in range(self.shape[0]))
