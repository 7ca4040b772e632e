"""Array types used throughout, and how values from outside become such arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def real_array(values: Any, name: str) -> FloatArray:
    """`values` as an array of float64, without a copy where it is one already.

    numpy would read numerals and dates as numbers and drop imaginary parts and masks; here they are errors.

    Raises
    ------
    ValueError
        If the values are ragged, masked, or not real numbers; `name` is the argument to blame.
    """
    _refuse_masked(values, name)
    try:
        raw = np.asarray(values)
        if raw.dtype.kind not in "biufO":
            raise ValueError(f"got {raw.dtype}")
        array: FloatArray = raw.astype(np.float64, copy=False)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"{name} must be real numbers in a regular array ({error})") from None
    return array


def real_csr(value: Any, name: str) -> sp.csr_array:
    """A sparse matrix from outside as CSR of float64; `name` is the argument to blame.

    The numbers become float64 before scipy adds up pairs that are listed twice: in uint8, 200 + 100 would be 44.
    """
    if value.dtype.kind not in "biuf":
        raise ValueError(f"{name} must be real numbers, got {value.dtype}")
    return sp.csr_array(value.astype(np.float64, copy=False))


def index_array(values: Any, name: str) -> IntArray:
    """`values` as a new array of int64.

    Raises
    ------
    ValueError
        If the values are ragged, masked, or not whole numbers; `name` is the argument to blame.
    """
    _refuse_masked(values, name)
    try:
        raw = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{name} must be a regular array ({error})") from None
    whole = raw.dtype.kind in "iu" or (raw.dtype.kind == "f" and bool((raw == np.round(raw)).all()))
    # An index beyond int64 is out of range everywhere; cast, it could wrap around into range.
    if not whole or (raw.size and not (float(raw.min()) >= -(2**63) and float(raw.max()) < 2**63)):
        raise ValueError(f"{name} must hold integers (indices of tasks)")
    return raw.astype(np.int64)


def _refuse_masked(values: Any, name: str) -> None:
    """Refuse masked entries, in lists of masked arrays as well: `numpy.asarray` would count what is masked."""
    if isinstance(values, (list, tuple)) or (isinstance(values, np.ndarray) and values.dtype.kind == "O"):
        for value in values:
            if isinstance(value, (list, tuple, np.ndarray)):
                _refuse_masked(value, name)
    if np.ma.isMaskedArray(values) and np.ma.is_masked(values):
        raise ValueError(f"{name} must not be masked; fill the masked entries")


def root_mean_square(values: FloatArray) -> float:
    """Typical size of the numbers that are finite; 1 where there are none but zeros.

    The squares are those of shares of the greatest number: they neither overflow nor vanish, whatever the scale.
    """
    sizes = np.abs(values[np.isfinite(values)])
    top = float(sizes.max(initial=0.0))
    return top * float(np.sqrt(np.mean((sizes / top) ** 2))) if top > 0 else 1.0


def checked_cost(cost: Any) -> float:
    """One cost of a dynamics.

    Raises
    ------
    ValueError
        If it is no finite number, or negative.
    """
    number = real_array(cost, "cost")
    if number.ndim or not np.isfinite(number) or number < 0:
        raise ValueError(f"cost must be one finite number, not negative, got {cost!r}")
    return float(number)
