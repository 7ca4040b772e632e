"""The benefits of a call: checked with the ids of those they belong to, and brought into the inner order."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Benefits
from sapopt.data.types import IntArray
from sapopt.live.names import Name


def arranged(benefits: Benefits, rows: IntArray, columns: IntArray) -> Benefits:
    """Benefits (T, n', m') of the agents `rows` (n',) and the tasks `columns` (m',) alone, in that order."""
    steps, n, m = benefits.shape
    all_rows, all_columns = _is_range(rows, n), _is_range(columns, m)
    if all_rows and all_columns:
        return benefits
    if not benefits.is_sparse:
        dense = benefits.dense()
        return Benefits(dense[:, rows[:, None], columns])
    flat = benefits.flat()
    whole = sp.csr_array((flat.data, flat.indices, flat.indptr), shape=(steps * n, m))
    if not all_rows:
        whole = sp.csr_array(whole[(np.arange(steps)[:, None] * n + rows).ravel()])
    indices, data, indptr = whole.indices, whole.data, whole.indptr
    if not all_columns:
        place = np.full(m, -1, dtype=np.int64)
        place[columns] = np.arange(len(columns))
        indices = place[indices]
        if len(columns) < m:
            kept = indices >= 0
            indptr = np.concatenate([[0], np.cumsum(kept)])[indptr]
            indices, data = indices[kept], data[kept]
    out = sp.csr_array((data.copy(), indices, indptr), shape=(len(indptr) - 1, len(columns)))
    out.sort_indices()
    return Benefits.from_flat(out.indptr, out.indices, out.data, (steps, len(rows), len(columns)))


def _is_range(places: IntArray, count: int) -> bool:
    return len(places) == count and bool((places == np.arange(count)).all())


def read_benefits(values: Any, agents: Any, tasks: Any) -> Benefits:
    """The benefits of a call as they came, checked.

    Raises
    ------
    ValueError
        If they are no benefits; where a number is wrong, the message names agent, task and step.
    """
    try:
        return Benefits(values)
    except ValueError as error:
        where = _first_wrong(values)
        if where is None:
            raise
        k, i, j = where
        agent, task = _called(agents, i), _called(tasks, j)
        raise ValueError(
            f"benefits: that of agent {agent!r} for task {task!r} at step {k} of the window is no number that can be "
            f"used ({error})"
        ) from None


def _first_wrong(values: Any) -> tuple[int, int, int] | None:
    """Step, agent and task of the first NaN or +inf; None where there is none, or the form is wrong altogether."""
    try:
        for k, step in enumerate(values):
            if sp.issparse(step):
                entries = step.tocoo()
                bad = np.flatnonzero(np.isnan(entries.data) | np.isposinf(entries.data))
                if len(bad):
                    return k, int(entries.coords[0][bad[0]]), int(entries.coords[1][bad[0]])
            else:
                dense = np.asarray(step, dtype=np.float64)
                wrong = np.argwhere(np.isnan(dense) | np.isposinf(dense))
                if len(wrong):
                    return k, int(wrong[0, 0]), int(wrong[0, 1])
    except (TypeError, ValueError, IndexError):
        pass
    return None


def _called(names: Any, place: int) -> Name:
    return place if names is None else names[place]
