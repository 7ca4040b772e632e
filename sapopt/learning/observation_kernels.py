"""The observation of section 6.2 for all agents at one step, from the sparse benefits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sapopt.kernels.jit import njit
from sapopt.kernels.windows import window_gains


@njit(cache=True, nogil=True)
def look(indptr, indices, data, k, stop, n, m, M, N, largest):
    """Best tasks and most important competitors of every agent in the window ``k .. stop - 1``.

    Parameters
    ----------
    indptr, indices, data : arrays
        Flat benefits; row ``k * n + i`` is agent i at step k.
    k, stop, n, m : int
        The window, agents, tasks.
    M, N : int
        Tasks and neighbours wanted.
    largest : bool
        Rank a competitor by its largest sum for one of the agent's best tasks (section 6.2.2), or by the total of
        its sums for all of them (the published code).

    Returns
    -------
    tasks : ndarray of int64, shape (n, M)
        Tasks of positive benefit summed over the window, best first; -1 where there are no more.
    neighbours : ndarray of int64, shape (n, N)
        Other agents of the highest rank, best first, equal ones by number; -1 where nobody else sees those tasks.
    row_start, ranked : arrays
        All tasks of the window, every row by decreasing sum.
    """
    row_start, ranked, sums = window_gains(indptr, indices, data, k, stop, n, m, 0.0)
    # The same by task: who sees it, and at what sum.
    column_start = np.zeros(m + 1, np.int64)
    for e in range(row_start[n]):
        column_start[ranked[e] + 1] += 1
    for j in range(m):
        column_start[j + 1] += column_start[j]
    place = column_start[:-1].copy()
    viewer = np.empty(row_start[n], np.int64)
    view_sum = np.empty(row_start[n])
    for i in range(n):
        for e in range(row_start[i], row_start[i + 1]):
            p = place[ranked[e]]
            viewer[p] = i
            view_sum[p] = sums[e]
            place[ranked[e]] = p + 1

    tasks = np.full((n, M), -1, np.int64)
    neighbours = np.full((n, N), -1, np.int64)
    rivalry = np.zeros(n)
    rivals = np.empty(n, np.int64)
    for i in range(n):
        found = 0
        for e in range(row_start[i], min(row_start[i + 1], row_start[i] + M)):
            if sums[e] <= 0.0:
                break
            j = ranked[e]
            tasks[i, e - row_start[i]] = j
            for p in range(column_start[j], column_start[j + 1]):
                a = viewer[p]
                if a == i or view_sum[p] <= 0.0:
                    continue
                if rivalry[a] == 0.0:
                    rivals[found] = a
                    found += 1
                if not largest:
                    rivalry[a] += view_sum[p]
                elif view_sum[p] > rivalry[a]:
                    rivalry[a] = view_sum[p]
        for slot in range(min(N, found)):
            best = slot
            for q in range(slot + 1, found):
                a, b = rivals[q], rivals[best]
                if rivalry[a] > rivalry[b] or (rivalry[a] == rivalry[b] and a < b):
                    best = q
            rivals[slot], rivals[best] = rivals[best], rivals[slot]
            neighbours[i, slot] = rivals[slot]
        for q in range(found):
            rivalry[rivals[q]] = 0.0
    return tasks, neighbours, row_start, ranked


class Layout(NamedTuple):
    """What an observation holds: M tasks of an agent, N neighbours, L steps; that of section 6.2.2 or the code's."""

    tasks: int
    neighbours: int
    steps: int
    thesis: bool


@njit(cache=True, nogil=True)
def observe(indptr, indices, data, k, stop, m, layout, held, charge, out):
    """Write the observations of all agents at step k; see `sapopt.learning.observation` for the layouts.

    Parameters
    ----------
    indptr, indices, data, k, stop, m
        As in `look`.
    layout : Layout
    held : ndarray of int64, shape (n,)
        Previous task of every agent, -1 for none.
    charge : ndarray of float64, shape (n,), or (0,)
        Charge of every agent; without it the block of charges is left out.
    out : ndarray of float32, shape (n, size)
        Zeros on entry.

    Returns
    -------
    tasks : ndarray of int64, shape (n, M)
    """
    M, N, L, thesis = layout
    n = len(held)
    tasks, neighbours, row_start, ranked = look(indptr, indices, data, k, stop, n, m, M, N, thesis)
    H = 0 if thesis else M // 2  # a neighbour's other tasks
    rivals_at = M * L
    others_at = rivals_at + N * M * L
    flags_at = others_at + N * H * L
    charges_at = flags_at + (M * (1 + N) if thesis else M)
    slot = np.empty(m, np.int64)  # of a task among the agent's best
    mine = np.zeros(m, np.int64)  # agent + 1 whose best tasks were marked last
    other_slot = np.empty(m, np.int64)
    other = np.zeros(m, np.int64)  # mark of the (agent, neighbour) pair
    pair = 0
    for i in range(n):
        for s in range(M):
            if tasks[i, s] < 0:
                break
            slot[tasks[i, s]] = s
            mine[tasks[i, s]] = i + 1
            if tasks[i, s] == held[i]:
                out[i, flags_at + s] = 1.0
        for step in range(k, stop):
            for e in range(indptr[step * n + i], indptr[step * n + i + 1]):
                j = indices[e]
                if mine[j] == i + 1:
                    out[i, slot[j] * L + step - k] = data[e]
        for q in range(N):
            a = neighbours[i, q]
            if a < 0:
                break
            if thesis and held[a] >= 0 and mine[held[a]] == i + 1:
                out[i, flags_at + (1 + q) * M + slot[held[a]]] = 1.0
            pair += 1
            filled = 0
            for e in range(row_start[a], row_start[a + 1]):
                j = ranked[e]
                if mine[j] == i + 1:
                    continue
                if filled == H:
                    break
                other_slot[j] = filled
                other[j] = pair
                filled += 1
            for step in range(k, stop):
                for e in range(indptr[step * n + a], indptr[step * n + a + 1]):
                    j = indices[e]
                    if mine[j] == i + 1:
                        out[i, rivals_at + (q * M + slot[j]) * L + step - k] = data[e]
                    elif other[j] == pair:
                        out[i, others_at + (q * H + other_slot[j]) * L + step - k] = data[e]
        if len(charge) > 0:
            out[i, charges_at] = charge[i]
            for q in range(N):
                if neighbours[i, q] >= 0:
                    out[i, charges_at + 1 + q] = charge[neighbours[i, q]]
    return tasks


@njit(cache=True, nogil=True)
def alpha_rows(q, tasks):
    """Q-values as sparse rows for the matching kernel: gain of every listed task over the last output.

    Parameters
    ----------
    q : ndarray of float64, shape (n, M + 1)
    tasks : ndarray of int64, shape (n, M)

    Returns
    -------
    row_start, listed, gains : arrays
        CSR rows sorted by decreasing gain, equal gains by ascending task.
    negative : bool
        Whether a gain is negative.
    """
    n, M = tasks.shape
    row_start = np.zeros(n + 1, np.int64)
    listed = np.empty(n * M, np.int32)
    gains = np.empty(n * M)
    filled = 0
    negative = False
    for i in range(n):
        begin = filled
        for s in range(M):
            j = tasks[i, s]
            if j < 0:
                break
            g = q[i, s] - q[i, M]
            negative |= g < 0.0
            p = filled
            while p > begin and (gains[p - 1] < g or (gains[p - 1] == g and listed[p - 1] > j)):
                gains[p] = gains[p - 1]
                listed[p] = listed[p - 1]
                p -= 1
            gains[p] = g
            listed[p] = j
            filled += 1
        row_start[i + 1] = filled
    return row_start, listed[:filled].copy(), gains[:filled].copy(), negative


@njit(cache=True, nogil=True)
def action_index(tasks, assignment):
    """Output of the network that stands for the assigned task: its slot, or M for any other task."""
    n, M = tasks.shape
    out = np.full(n, M, np.int64)
    for i in range(n):
        for s in range(M):
            if tasks[i, s] == assignment[i]:
                out[i] = s
                break
    return out


@njit(cache=True, nogil=True)
def place_idle(chosen, listed, m):
    """Give the agents with -1 in `chosen` free tasks that they do not list, see `sapopt.learning.choices`."""
    n, M = listed.shape
    out = chosen.copy()
    taken = np.zeros(m, np.bool_)
    for i in range(n):
        if chosen[i] >= 0:
            taken[chosen[i]] = True
    first = 0
    for i in range(n):
        if chosen[i] >= 0:
            continue
        while taken[first]:
            first += 1
        spot = first
        while spot < m:
            if not taken[spot]:
                seen = False
                for s in range(M):
                    if listed[i, s] == spot:
                        seen = True
                        break
                if not seen:
                    break
            spot += 1
        if spot == m:
            spot = first
        out[i] = spot
        taken[spot] = True
    return out
