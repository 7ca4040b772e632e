"""Assignment by shortest augmenting paths where the unlisted pairs have a value of low rank.

The value of agent i on task j is listed (a sparse row), or else ``max_b leave[i, b] - dues[b, j]``: the agent waits on
a task that it does not see, for the price of waiting, and leaves it at one of a few dates b. In the search a date is a
*hub* between all agents and all tasks, so nothing of size (n, m) is ever built and a search costs O(B m) at most.

Duals are utilities ``u[i]`` and prices ``p[j] >= 0`` with ``u[i] + p[j] >= value[i, j]``, tight on assigned pairs.
A hub's potential is ``least[b] = min_j dues[b, j] + p[j]``; with it every arc of the search has a length >= 0.
"""

from __future__ import annotations

import numpy as np

from sapopt.kernels.heap import pop, push
from sapopt.kernels.jit import njit

_BATCH = 256  # searches between two looks at the clock

_ROUNDS = 10  # passes of row reduction, as in `sapopt.kernels.matching`


def assign_rows(row_start, tasks, values, leave, dues, prices, check=None):
    """Return the task of every agent (n,) in an assignment of greatest value, or an empty array if there is none.

    Parameters
    ----------
    row_start, tasks, values : arrays
        CSR rows, each sorted by decreasing value; a listed value is never below the pair's unlisted one.
    leave : ndarray of float64, shape (n, B)
    dues : ndarray of float64, shape (B, m)
        Not negative; +inf where waiting is impossible.
    prices : ndarray of float64, shape (m,)
        Not negative prices to start from. With n == m the result is optimal whatever they are; with n < m a task that
        stays free is worth its price, so that prices of zero give the optimum.
    check : callable, optional
        Called between batches of searches, a good part of a second; what it raises ends the work.
    """
    problem = row_start, tasks, values, leave, dues
    queue, state = _begin(problem, prices)
    for first in range(0, len(queue), _BATCH):
        if check is not None:
            check()
        if not _insert(queue[first : first + _BATCH], problem, state):
            return np.empty(0, np.int64)
    return state[0]


@njit(cache=True, nogil=True)
def _begin(problem, prices):
    """Reduce the rows: the agents that are still without a task, and the state of the searches."""
    row_start, tasks, values, leave, dues = problem
    n, hubs = leave.shape
    m = dues.shape[1]
    chosen, owner = np.full(n, -1, np.int64), np.full(m, -1, np.int64)
    u, p = np.full(n, -np.inf), prices.copy()
    least, lowest = np.full(hubs, np.inf), np.full(hubs, -1, np.int64)
    for b in range(hubs):
        _lowest(b, dues, p, owner, least, lowest)
    queue = np.arange(n)
    waiting, later = n, 0
    late = np.empty(n, np.int64)
    for _ in range(_ROUNDS):
        if waiting == 0:
            break
        waiting, later = _reduce_rows(
            row_start, tasks, values, leave, least, chosen, owner, u, p, queue, waiting, late, later
        )
    return np.concatenate((queue[:waiting], late[:later])), (chosen, owner, u, p, least, lowest)


@njit(cache=True, nogil=True)
def _insert(agents, problem, state):
    """Give each of the agents a task by a shortest augmenting path; False if there is none."""
    row_start, tasks, values, leave, dues = problem
    chosen, owner, u, p, least, lowest = state
    n, hubs = leave.shape
    m = dues.shape[1]
    dist, via = np.full(m, np.inf), np.empty(m, np.int64)
    done, touched = np.zeros(m, np.bool_), np.empty(m, np.int64)
    hub_dist, hub_from, hub_done = np.empty(hubs), np.empty(hubs, np.int64), np.empty(hubs, np.bool_)
    room = row_start[n] + hubs * (n + m) + 1
    heap_key, heap_item = np.empty(room), np.empty(room, np.int64)
    for root in agents:
        for b in range(hubs):
            if least[b] != dues[b, lowest[b]] + p[lowest[b]]:  # prices only rise
                _lowest(b, dues, p, owner, least, lowest)
        if not _augment(
            root, row_start, tasks, values, leave, dues, least, lowest, chosen, owner, u, p,
            dist, via, done, touched, hub_dist, hub_from, hub_done, heap_key, heap_item,
        ):  # fmt: skip
            return False
    return True


@njit(cache=True, nogil=True)
def _lowest(b, dues, p, owner, least, lowest):
    """Find the potential of a hub and the task that attains it, a free one if possible."""
    best, where = np.inf, np.int64(0)
    for j in range(len(p)):
        total = dues[b, j] + p[j]
        if total < best or (total == best and owner[where] >= 0 and owner[j] < 0):
            best, where = total, np.int64(j)
    least[b], lowest[b] = best, where


@njit(cache=True, nogil=True)
def _reduce_rows(row_start, tasks, values, leave, least, chosen, owner, u, p, queue, waiting, late, later):
    """One pass of row reduction over the queue, see `sapopt.kernels.matching`; agents who would wait go to `late`.

    The potentials of the hubs may be out of date, which only makes the price rises smaller.
    """
    again = 0
    for q in range(waiting):
        i = queue[q]
        wait = -np.inf
        for b in range(len(least)):
            wait = max(wait, leave[i, b] - least[b])
        best, second, task = -np.inf, wait, np.int64(-1)
        for e in range(row_start[i], row_start[i + 1]):
            if values[e] <= second:
                break
            net = values[e] - p[tasks[e]]
            if net > best:
                second = max(second, best)
                best = net
                task = np.int64(tasks[e])
            elif net > second:
                second = net
        if best < wait or task < 0:
            late[later] = i
            later += 1
            continue
        loser = owner[task]
        if loser >= 0:
            if best <= second or second == -np.inf:  # a tie moves nothing; leave it to the searches
                queue[again] = i
                again += 1
                continue
            p[task] += best - second
            u[i] = second
            chosen[loser] = -1
            queue[again] = loser
            again += 1
        else:
            u[i] = best
        owner[task] = i
        chosen[i] = task
    return again, later


@njit(cache=True, nogil=True)
def _augment(
    root, row_start, tasks, values, leave, dues, least, lowest, chosen, owner, u, p,
    dist, via, done, touched, hub_dist, hub_from, hub_done, heap_key, heap_item,
):  # fmt: skip
    """Insert one unassigned agent by a shortest augmenting path; False if there is none."""
    m, hubs = len(p), len(least)
    utility = -np.inf
    for e in range(row_start[root], row_start[root + 1]):
        if values[e] <= utility:
            break
        utility = max(utility, values[e] - p[tasks[e]])
    for b in range(hubs):
        hub_dist[b] = np.inf
        hub_done[b] = False
        utility = max(utility, leave[root, b] - least[b])
    if utility == -np.inf:
        return False
    u[root] = utility
    end, end_task = np.inf, np.int64(-1)
    size = 0
    n_touched = 0
    i, length = root, 0.0
    while True:
        base = length + u[i]
        for e in range(row_start[i], row_start[i + 1]):
            if base - values[e] >= end:
                break
            j = np.int64(tasks[e])
            if done[j] or owner[j] == i:
                continue
            reach = length + max(0.0, u[i] + p[j] - values[e])
            if reach >= end or reach >= dist[j]:
                continue
            if dist[j] == np.inf:
                touched[n_touched] = j
                n_touched += 1
            dist[j] = reach
            via[j] = i
            if owner[j] < 0:
                end, end_task = reach, j
            else:
                size = push(heap_key, heap_item, size, reach, j)
        for b in range(hubs):
            reach = length + max(0.0, u[i] - leave[i, b] + least[b])
            if reach < hub_dist[b] and reach < end and not hub_done[b]:
                hub_dist[b] = reach
                hub_from[b] = i
                size = push(heap_key, heap_item, size, reach, m + b)
        task = np.int64(-1)
        while size > 0:
            key, item = heap_key[0], heap_item[0]
            size = pop(heap_key, heap_item, size)
            if key >= end:
                break
            if item < m:
                if not done[item] and key <= dist[item]:
                    task = item
                    break
                continue
            b = item - m
            if hub_done[b] or key > hub_dist[b]:
                continue
            hub_done[b] = True
            j = lowest[b]
            if owner[j] < 0 and not done[j] and key < dist[j]:
                if dist[j] == np.inf:
                    touched[n_touched] = j
                    n_touched += 1
                dist[j] = key
                via[j] = hub_from[b]
                end, end_task = key, j
                break
            offset = key - least[b]
            for free in (True, False):
                for t in range(m):
                    j = np.int64(t)
                    reach = max(key, offset + dues[b, j] + p[j])
                    if reach < end and (owner[j] < 0) == free and reach < dist[j] and not done[j]:
                        if dist[j] == np.inf:
                            touched[n_touched] = j
                            n_touched += 1
                        dist[j] = reach
                        via[j] = hub_from[b]
                        if free:
                            end, end_task = reach, j
                            if reach == key:
                                lowest[b] = j
                        else:
                            size = push(heap_key, heap_item, size, reach, j)
        if task < 0:
            break
        done[task] = True
        i = owner[task]
        length = dist[task]
    if end_task >= 0:
        u[root] -= end
        for t in range(n_touched):
            j = touched[t]
            if done[j]:
                p[j] += end - dist[j]
                u[owner[j]] -= end - dist[j]
        task = end_task
        while True:
            i = via[task]
            previous = chosen[i]
            chosen[i] = task
            owner[task] = i
            if i == root:
                break
            task = previous
    for t in range(n_touched):
        dist[touched[t]] = np.inf
        done[touched[t]] = False
    return end_task >= 0
