"""Compiled recursions of `groups`: one group of copies after another, O(T (m + copies * tasks in sight)) each.

State r < R means that real task r is held, state R that nothing is held, and R + 1 (only before the first step) that
the first step is free. Prices have a column for every task, then one for every agent: what its place in the group
costs.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.copies.hard import charge
from sapopt.kernels.jit import njit


class Groups(NamedTuple):
    """Benefits and rule of G groups of copies over a window; row ``k * G + g`` is group g at step k.

    Attributes
    ----------
    size : (G,) int64
        Copies of every group.
    members : (G, most) int64
        Their numbers, padded with -1.
    indptr : (T * G + 1,) int64
    indices : (entries,) int32
        Tasks of which some copy of the group has a benefit stored.
    data : (entries, most) float64
        Their benefits for every copy, 0 where none is stored.
    real : (m,) int64
        The real task of every task.
    real_count : int
        R, the number of real tasks.
    shared : (m,) bool
        Whether a task is one of several copies. A group of several agents may enter those without paying: too
        good for it, so bounds hold.
    cost, forfeit : float
        What a move into a positive benefit pays: the cost and this share of the benefit.
    idle_is_free, needs_sight : bool
        Whether a move to a task without benefit is free, and leads to holding nothing.
    start : (n,) int64
        State before the first step.
    """

    size: IntArray
    members: IntArray
    indptr: IntArray
    indices: NDArray[np.int32]
    data: FloatArray
    real: IntArray
    real_count: int
    shared: NDArray[np.bool_]
    cost: float
    forfeit: float
    idle_is_free: bool
    needs_sight: bool
    start: IntArray


@njit(cache=True, borrows=True, nogil=True)
def _to_go(g, first, groups, prices, gains, best, move, stay):
    """Value to go before every step and state, ``best`` (T + 1, R + 2), and the choices behind it.

    For the steps from `first` on, with j running over all tasks, r over the places of the group, and the state that j
    leads to:

        kept_j     = max_r (benefit_k[r, j] - price of r)          - price_k[j] + best[k + 1, state]
        moved_j    = max_r (benefit_k[r, j] - charge - price of r) - price_k[j] + best[k + 1, state]
        best[k, s] = max(max_j moved_j, max over the copies j of s of kept_j)

    ``move[k]`` is the best task of who pays, ``stay[k, s]`` the best copy of real task s for who holds it, -1 where
    moving is better. `gains` (3, m) is for work: kept, moved, and whether the task counts as held.
    """
    size, members, indptr, indices, data, real, R, shared, cost, forfeit, idle_free, sight, start = groups
    T, m, G = prices.shape[0], len(real), len(size)
    most = size[g]
    best[T, :] = 0.0
    for k in range(T - 1, first - 1, -1):
        cheapest = np.inf
        for r in range(most):
            cheapest = min(cheapest, prices[k, m + members[g, r]])
        kept, moved = -cheapest, -cheapest - (0.0 if idle_free else cost)
        for j in range(m):
            gains[0, j], gains[1, j] = kept, moved
            gains[2, j] = 0.0 if sight else 1.0
        for e in range(indptr[k * G + g], indptr[k * G + g + 1]):
            j = indices[e]
            gains[0, j] = gains[1, j] = -np.inf
            for r in range(most):
                value, place = data[e, r], prices[k, m + members[g, r]]
                gains[0, j] = max(gains[0, j], value - place)
                gains[1, j] = max(gains[1, j], value - charge(value, cost, forfeit, idle_free) - place)
                if value > 0.0:
                    gains[2, j] = 1.0
        top, choice = -np.inf, -1
        for s in range(R):
            best[k, s] = -np.inf
            stay[k, s] = -1
        free = -np.inf
        for j in range(m):
            s = real[j]
            following = best[k + 1, s if gains[2, j] > 0.0 else R] - prices[k, j]
            keeps = gains[0, j] + following
            moves = keeps if most > 1 and shared[j] else gains[1, j] + following
            if keeps > best[k, s]:
                best[k, s] = keeps
                stay[k, s] = j
            if keeps > free:
                free = keeps
                stay[k, R + 1] = j
            if moves > top:
                top, choice = moves, j
        move[k] = choice
        best[k, R], stay[k, R] = top, -1
        best[k, R + 1] = free
        for s in range(R):
            if best[k, s] < top:
                best[k, s] = top
                stay[k, s] = -1


@njit(cache=True, nogil=True)
def paths(begin, end, groups, prices, values, plan):
    """Longest paths of the copies of groups ``begin..end - 1``: ``values`` (n,) and ``plan`` (T, 2 n) are filled.

    The first n columns of the plan are tasks, the others the columns of the places in the prices.
    """
    size, members, indptr, indices, data, real, R, shared, cost, forfeit, idle_free, sight, start = groups
    T, m, n, G = prices.shape[0], len(real), len(start), len(size)
    gains = np.zeros((3, m))
    best = np.zeros((T + 1, R + 2))
    move = np.zeros(T, np.int64)
    stay = np.full((T, R + 2), -1, np.int64)
    for g in range(begin, end):
        most = size[g]
        _to_go(g, np.int64(0), groups, prices, gains, best, move, stay)
        for copy in range(most):
            i = members[g, copy]
            for twin in range(copy):  # the same path as a copy that began alike
                if start[members[g, twin]] == start[i]:
                    values[i] = values[members[g, twin]]
                    for k in range(T):
                        plan[k, i] = plan[k, members[g, twin]]
                        plan[k, n + i] = plan[k, n + members[g, twin]]
                    break
            else:
                s = start[i]
                values[i] = best[0, s]
                for k in range(T):
                    keeps = stay[k, s] >= 0
                    j = stay[k, s] if keeps else move[k]
                    plan[k, i] = j
                    plan[k, n + i] = m + members[g, 0]
                    if j < 0:  # nothing is allowed: the value is -inf
                        continue
                    entry = -1
                    for e in range(indptr[k * G + g], indptr[k * G + g + 1]):
                        if indices[e] == j:
                            entry = e
                    top, counts = -np.inf, not sight
                    for r in range(most):
                        value = 0.0 if entry < 0 else data[entry, r]
                        worth = value - prices[k, m + members[g, r]]
                        if not keeps and not (most > 1 and shared[j]):
                            worth -= charge(value, cost, forfeit, idle_free)
                        if worth > top:
                            top = worth
                            plan[k, n + i] = m + members[g, r]
                        counts = counts or value > 0.0
                    s = real[j] if counts else R


@njit(cache=True, nogil=True)
def path(agent, g, groups, prices, out):
    """The longest path of one copy: its tasks fill ``out`` (T,), its value is returned."""
    size, members, indptr, indices, data, real, R, shared, cost, forfeit, idle_free, sight, start = groups
    T, m, G = prices.shape[0], len(real), len(size)
    gains = np.zeros((3, m))
    best = np.zeros((T + 1, R + 2))
    move = np.zeros(T, np.int64)
    stay = np.full((T, R + 2), -1, np.int64)
    _to_go(g, np.int64(0), groups, prices, gains, best, move, stay)
    s = start[agent]
    for k in range(T):
        j = stay[k, s] if stay[k, s] >= 0 else move[k]
        out[k] = j
        if j < 0:
            continue
        counts = not sight
        for e in range(indptr[k * G + g], indptr[k * G + g + 1]):
            if indices[e] == j:
                for r in range(size[g]):
                    counts = counts or data[e, r] > 0.0
        s = real[j] if counts else R
    return best[0, start[agent]]


@njit(cache=True, nogil=True)
def second_values(begin, end, groups, prices, out):
    """Value to go before the second step, from every state: fills ``out`` (G, R + 2)."""
    T, m, R = prices.shape[0], len(groups.real), groups.real_count
    gains = np.zeros((3, m))
    best = np.zeros((T + 1, R + 2))
    move = np.zeros(T, np.int64)
    stay = np.full((T, R + 2), -1, np.int64)
    for g in range(begin, end):
        _to_go(g, np.int64(1), groups, prices, gains, best, move, stay)
        out[g] = best[1]
