"""Copies of rows and columns of benefits, and the checks of both transformations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Benefits
from sapopt.data.types import IntArray, index_array

Forecast = Callable[[int, int], Any]


def ranks(copies: IntArray) -> IntArray:
    """0, 1, ... inside every block of copies."""
    ends = np.cumsum(copies)
    return np.arange(ends[-1]) - np.repeat(ends - copies, copies)


def counts(copies: Any, count: int, what: str) -> IntArray:
    """Number of copies of each of `count` originals."""
    number = index_array(copies, "copies")
    if number.ndim > 1 or (number.ndim == 1 and len(number) != count) or number.min() < 1:
        raise ValueError(f"copies must be a positive whole number, or one for each of the {count} {what}s")
    return np.broadcast_to(number, (count,)).copy()


def copied_labels(labels: tuple[str, ...] | None, copies: IntArray) -> list[str] | None:
    """Names of the copies: that of the original, with ``#1``, ``#2``, ... where there are several; None without."""
    if labels is None:
        return None
    return [
        f"{label} #{rank + 1}" if count > 1 else label
        for label, count in zip(labels, copies.tolist(), strict=True)
        for rank in range(count)
    ]


def check_decay(decay: float) -> None:
    """Raise a ValueError unless the decay is above 0 and at most 1."""
    if not 0 < decay <= 1:
        raise ValueError(f"decay must be above 0 and at most 1, got {decay!r}")


def copied_agents(benefits: Benefits, copies: IntArray, decay: float, extra: int) -> Benefits:
    """Rows repeated and decayed, and `extra` idle tasks; sparse stays sparse."""
    weight = decay ** ranks(copies)

    def step(k: int) -> Any:
        wide = repeated(benefits.step(k), copies, extra)
        return sp.csr_array(wide.multiply(weight[:, None])) if sp.issparse(wide) else wide * weight[:, None]

    return _stacked([step(k) for k in range(benefits.shape[0])])


def repeated(step: Any, copies: IntArray, extra: int) -> Any:
    """Rows repeated, and `extra` columns of zeros."""
    rows = np.repeat(np.arange(step.shape[0]), copies)
    if not sp.issparse(step):
        return np.pad(step[rows], ((0, 0), (0, extra)))
    wide = sp.csr_array(step)[rows]
    return sp.csr_array((wide.data, wide.indices, wide.indptr), shape=(len(rows), step.shape[1] + extra))


def copied_tasks(benefits: Benefits, copies: IntArray, decay: float) -> Benefits:
    """Columns repeated and decayed; sparse stays sparse."""
    weight = decay ** ranks(copies)
    columns = np.repeat(np.arange(benefits.shape[2]), copies)
    spread = sp.csr_array(
        (weight, (columns, np.arange(len(columns)))), shape=(benefits.shape[2], len(columns))
    )

    def step(k: int) -> Any:
        one = benefits.step(k)
        return sp.csr_array(one @ spread) if sp.issparse(one) else one[:, columns] * weight

    return _stacked([step(k) for k in range(benefits.shape[0])])


def _stacked(steps: list[Any]) -> Benefits:
    return Benefits(steps if sp.issparse(steps[0]) else np.stack(steps))
