"""Compiled parts of `Battery` that look at a few steps only."""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from sapopt.kernels.jit import njit
from sapopt.kernels.windows import fill_sorted


@njit(cache=True, nogil=True)
def interval_gains(indptr, indices, data, steps, m, before, rule):
    """What every agent gains by holding one task over all `steps`, for the tasks that it sees at some step.

    Parameters
    ----------
    indptr, indices, data : arrays
        Flat benefits; row ``k * n + i`` is agent i at step k.
    before : sapopt.dynamics.battery.hard.Before
    rule : sapopt.dynamics.battery.hard.Rule
        The value of what is left over does not count.

    Returns
    -------
    row_start, tasks, gains
        Sorted rows of a `GainMatrix`; pairs that yield 0 are left out.
    """
    cost, drain, charge, capacity, entries, end = rule
    n = before.levels.size
    row_start = np.zeros(n + 1, np.int64)
    tasks = np.empty(indptr[-1] - indptr[0], np.int32)
    gains = np.empty(indptr[-1] - indptr[0])
    total = np.zeros(m)
    seen = np.zeros(m, np.int64)  # agent + 1 that touched the task last
    level = np.zeros(m, np.int64)
    until = np.zeros(m, np.int64)  # steps that are accounted for
    ready = np.zeros(m, np.bool_)
    filled = np.int64(
        0
    )  # a plain 0 would be a type of its own to the compiler, and `fill_sorted` compiled twice
    for i in range(n):
        begin = filled
        for k in range(steps):
            for e in range(indptr[k * n + i], indptr[k * n + i + 1]):
                j = indices[e]
                if seen[j] != i + 1:
                    seen[j] = i + 1
                    total[j] = 0.0
                    level[j] = before.levels[i]
                    until[j] = 0
                    ready[j] = before.ready[i] == j
                    tasks[filled] = j
                    filled += 1
                idle = k - until[j]
                if idle > 0:
                    ready[j] = not entries
                    if level[j] > 0:
                        level[j] = min(level[j] + idle * charge, capacity)
                until[j] = k + 1
                if data[e] > 0.0 and level[j] > 0:
                    total[j] += data[e]
                    if not ready[j] and not (before.free and k == 0):
                        total[j] -= cost
                    level[j] = max(level[j] - drain, 0)
                    ready[j] = True
                else:
                    total[j] += min(data[e], 0.0)
                    ready[j] = not entries
                    if level[j] > 0:
                        level[j] = min(level[j] + charge, capacity)
        kept = begin
        for e in range(begin, filled):
            if total[tasks[e]] != 0.0:
                tasks[kept] = tasks[e]
                kept += 1
        filled = kept
        fill_sorted(tasks, gains, total, begin, filled)
        row_start[i + 1] = filled
    return row_start, tasks[:filled].copy(), gains[:filled].copy()
