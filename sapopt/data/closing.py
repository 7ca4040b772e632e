"""Benefits with closed tasks, and with a place for holding nothing."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Benefits, StepMatrix
from sapopt.data.types import IntArray


def closing(benefits: Benefits, capacity: IntArray | None, extra: int) -> Benefits:
    """The benefits with `extra` tasks of zero benefit at the end, and pairs of closed tasks forbidden.

    Parameters
    ----------
    benefits : Benefits
    capacity : ndarray of int64, shape (T, m), or None
        0 closes a task at a step.
    extra : int
    """
    wide = benefits.with_idle_tasks(extra) if extra else benefits
    if capacity is None or (capacity > 0).all():
        return wide.settled()
    _, n, m = wide.shape

    def closed(k: int) -> StepMatrix:
        step = wide.step(k)
        shut = np.flatnonzero(capacity[k] == 0)
        if isinstance(step, np.ndarray):
            out = step.copy()
            out[:, shut] = -np.inf
            return out
        keep = ~np.isin(step.indices, shut)
        row = np.repeat(np.arange(n), np.diff(step.indptr))[keep]
        everyone = np.repeat(np.arange(n), len(shut))
        return sp.csr_array(
            (
                np.concatenate([step.data[keep], np.full(len(everyone), -np.inf)]),
                (np.concatenate([row, everyone]), np.concatenate([step.indices[keep], np.tile(shut, n)])),
            ),
            shape=(n, m),
        )

    if not wide.is_sparse:
        return Benefits(np.stack([np.asarray(closed(k)) for k in range(wide.shape[0])])).settled()
    return Benefits([closed(k) for k in range(wide.shape[0])]).settled()
