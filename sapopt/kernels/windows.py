"""Sums of sparse benefits over a window of steps, rows sorted for the matching kernel."""

from __future__ import annotations

import numpy as np

from sapopt.kernels.jit import SMALL, njit

_INSERT = 64  # rows up to this length are sorted by plain insertion


@njit(cache=True, nogil=True, small=SMALL)
def window_gains(indptr, indices, data, first, last, n, m, entry_cost):
    """Sum the rows of the steps ``first .. last - 1`` and sort every row by decreasing gain.

    Parameters
    ----------
    indptr, indices, data : arrays
        Flat benefits; row ``k * n + i`` is agent i at step k.
    first, last : int
        The window.
    n, m : int
        Agents and tasks.
    entry_cost : float
        Subtracted from a pair whose benefit at step `first` is positive (the charge for entering a task that is
        worth something at the moment of the move); 0 where every move is charged alike.

    Returns
    -------
    row_start : ndarray of int64, shape (n + 1,)
    tasks : ndarray of int32
    gains : ndarray of float64
    """
    row_start = np.zeros(n + 1, np.int64)
    bound = 0
    for k in range(first, last):
        bound += indptr[(k + 1) * n] - indptr[k * n]
    tasks = np.empty(bound, np.int32)
    gains = np.empty(bound)
    total = np.zeros(m)
    seen = np.zeros(m, np.int64)  # agent + 1 that touched the task last
    filled = np.int64(
        0
    )  # a plain 0 would be a type of its own to the compiler, and `fill_sorted` compiled twice
    for i in range(n):
        begin = filled
        for k in range(first, last):
            for e in range(indptr[k * n + i], indptr[k * n + i + 1]):
                j = indices[e]
                value = data[e]
                if k == first and value > 0.0:
                    value -= entry_cost
                if seen[j] != i + 1:
                    seen[j] = i + 1
                    total[j] = value
                    tasks[filled] = j
                    filled += 1
                else:
                    total[j] += value
        fill_sorted(tasks, gains, total, begin, filled)
        row_start[i + 1] = filled
    return row_start, tasks[:filled].copy(), gains[:filled].copy()


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def longer_window(
    row_start, tasks, gains, indptr, indices, data, total, seen, entry_cost, out_start, out_tasks, out_gains
):
    """Add one more step at the end of a window: the rows of `window_gains`, from those of a window one step shorter.

    Parameters
    ----------
    row_start, tasks, gains : arrays
        The shorter window; without rows (``row_start`` of zeros) the result is the step alone.
    indptr, indices, data : arrays
        CSR rows of the step.
    total, seen : ndarray of float64 and int64, shape (m,)
        Work arrays; `seen` holds zeros.
    entry_cost : float
        See `window_gains`; of use only where the step is the first of the window.
    out_start, out_tasks, out_gains : arrays
        The result.

    Returns
    -------
    bool
        Whether a gain is negative.
    """
    filled = np.int64(
        0
    )  # a plain 0 would be a type of its own to the compiler, and `fill_sorted` compiled twice
    negative = False
    out_start[0] = 0
    for i in range(len(row_start) - 1):
        begin = filled
        for e in range(row_start[i], row_start[i + 1]):
            j = tasks[e]
            seen[j] = i + 1
            total[j] = gains[e]
            out_tasks[filled] = j
            filled += 1
        for e in range(indptr[i], indptr[i + 1]):
            j = indices[e]
            value = data[e]
            if value > 0.0:
                value -= entry_cost
            if seen[j] == i + 1:
                total[j] += value
            else:
                total[j] = value
                out_tasks[filled] = j
                filled += 1
        fill_sorted(out_tasks, out_gains, total, begin, filled)
        out_start[i + 1] = filled
        if filled > begin and out_gains[filled - 1] < 0.0:
            negative = True
    return negative


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def fill_sorted(tasks, gains, total, begin, end):
    """Write the gains of one row by decreasing gain, equal gains by ascending task (Shell's sort)."""
    for e in range(begin, end):
        gains[e] = total[tasks[e]]
    gap = 1
    while gap < (end - begin) // _INSERT:
        gap = 3 * gap + 1
    while gap > 0:
        for e in range(begin + gap, end):
            j = tasks[e]
            g = gains[e]
            q = e
            while q >= begin + gap:
                other = q - gap
                if gains[other] > g or (gains[other] == g and tasks[other] < j):
                    break
                gains[q] = gains[other]
                tasks[q] = tasks[other]
                q = other
            gains[q] = g
            tasks[q] = j
        gap //= 3


@njit(cache=True, nogil=True, small=SMALL)
def listed_gain(row_start, tasks, gains, chosen, bonus):
    """Gain listed for task ``chosen[i]`` of every agent i (0 where it is not listed), plus `bonus`."""
    out = np.full(len(chosen), bonus)
    for i in range(len(chosen)):
        for e in range(row_start[i], row_start[i + 1]):
            if tasks[e] == chosen[i]:
                out[i] += gains[e]
                break
    return out
