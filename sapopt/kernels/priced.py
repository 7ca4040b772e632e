"""Assignment by shortest augmenting paths where the unlisted pairs have a value of low rank.

The value of agent i on task j is listed (a sparse row), or else ``max_b leave[i, b] - dues[b, j]``: the agent waits on
a task that it does not see, for the price of waiting, and leaves it at one of a few dates b. In the search a date is a
*hub* between all agents and all tasks, so nothing of size (n, m) is ever built and a search costs O(B m) at most.

Duals are utilities ``u[i]`` and prices ``p[j] >= 0`` with ``u[i] + p[j] >= value[i, j]``, tight on assigned pairs.
A hub's potential is ``least[b] = min_j dues[b, j] + p[j]``; with it every arc of the search has a length >= 0:

    agent i -> task j      u[i] + p[j] - value[i, j]              (listed pairs)
    agent i -> hub b       u[i] + least[b] - leave[i, b]
    hub b   -> task j      dues[b, j] + p[j] - least[b]
    task j  -> its owner   0                                      (who has to find another task)

A search is Dijkstra's from the agent to be inserted to the nearest free task. With ``dist`` the distances and ``end``
that of the free task, the new duals are ``p[j] + end - dist[j]`` and ``u[owner[j]] - (end - dist[j])`` for the tasks
reached for good, which keeps every arc at a length >= 0 and makes those of the path tight.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from sapopt.kernels.heap import pop, push
from sapopt.kernels.jit import njit

_BATCH = 256  # searches between two looks at the clock

_ROUNDS = 10  # passes of row reduction, as in `sapopt.kernels.matching`

Values = namedtuple("Values", "row_start tasks values leave dues")
"""What pairs are worth: CSR rows of the listed ones, each sorted by decreasing value; ``leave`` of shape (n, B) and
``dues`` of shape (B, m) for the others."""

Found = namedtuple("Found", "chosen owner u p least lowest")
"""An assignment in the making: the task ``chosen`` by every agent and the ``owner`` of every task, -1 for none; the
duals ``u`` and ``p``; of every hub the potential ``least`` and the task ``lowest`` that attains it."""

Search = namedtuple("Search", "dist via done touched hub_dist hub_from hub_done heap_key heap_item")
"""Work arrays of a search. Of every task: distance (infinite between searches), the agent it was reached ``via``, and
whether that is final (``done``); the tasks ``touched``. Of every hub: the same. A heap of tasks j and hubs m + b."""


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
    worth = Values(row_start, tasks, values, leave, dues)
    queue, found = _begin(worth, prices)
    for first in range(0, len(queue), _BATCH):
        if check is not None:
            check()
        if not _insert(queue[first : first + _BATCH], worth, found):
            return np.empty(0, np.int64)
    return found.chosen


@njit(cache=True, nogil=True)
def _begin(worth, prices):
    """Reduce the rows: the agents that are still without a task, and what the searches go on from."""
    n, hubs = worth.leave.shape
    m = worth.dues.shape[1]
    chosen, owner = np.full(n, -1, np.int64), np.full(m, -1, np.int64)
    u, p = np.full(n, -np.inf), prices.copy()
    found = Found(chosen, owner, u, p, np.full(hubs, np.inf), np.full(hubs, -1, np.int64))
    for b in range(hubs):
        _lowest(b, worth, found)
    queue = np.arange(n)
    late = np.empty(n, np.int64)
    waiting, later = n, np.int64(0)  # a plain 0 would be a type of its own to the compiler
    for _ in range(_ROUNDS):
        if waiting == 0:
            break
        waiting, later = _reduce_rows(worth, found, queue, waiting, late, later)
    for q in range(later):
        queue[waiting + q] = late[q]  # those who wait for a hub come last: they find most tasks priced
    return queue[: waiting + later], found


@njit(cache=True, nogil=True)
def _insert(agents, worth, found):
    """Give each of the agents a task by a shortest augmenting path; False if there is none."""
    n, hubs = worth.leave.shape
    m = worth.dues.shape[1]
    room = worth.row_start[n] + hubs * (n + m) + 1
    search = Search(
        np.full(m, np.inf), np.empty(m, np.int64), np.zeros(m, np.bool_), np.empty(m, np.int64),
        np.empty(hubs), np.empty(hubs, np.int64), np.empty(hubs, np.bool_), np.empty(room), np.empty(room, np.int64),
    )  # fmt: skip
    least, lowest = found.least, found.lowest
    for root in agents:
        for b in range(hubs):
            if least[b] != worth.dues[b, lowest[b]] + found.p[lowest[b]]:  # prices only rise
                _lowest(b, worth, found)
        if not _augment(root, worth, found, search):
            return False
    return True


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _lowest(b, worth, found):
    """Find the potential of a hub and the task that attains it, a free one if possible."""
    dues, p, owner = worth.dues, found.p, found.owner
    best, where = np.inf, np.int64(0)
    for j in range(len(p)):
        total = dues[b, j] + p[j]
        if total < best or (total == best and owner[where] >= 0 and owner[j] < 0):
            best, where = total, np.int64(j)
    found.least[b], found.lowest[b] = best, where


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _reduce_rows(worth, found, queue, waiting, late, later):
    """One pass of row reduction over the queue, see `sapopt.kernels.matching`; agents who would wait go to `late`.

    The potentials of the hubs may be out of date, which only makes the price rises smaller.
    """
    row_start, tasks, values, leave, _ = worth
    chosen, owner, u, p, least, _ = found
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


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _touch(j, reach, agent, search, n_touched):
    """Note a shorter way to task j, through `agent`; returns how many tasks are touched now."""
    if search.dist[j] == np.inf:
        search.touched[n_touched] = j
        n_touched += 1
    search.dist[j] = reach
    search.via[j] = agent
    return n_touched


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _utility(agent, worth, found):
    """The most that an agent can have at the present prices, -inf if it can have no task at all."""
    utility = -np.inf
    for e in range(worth.row_start[agent], worth.row_start[agent + 1]):
        if worth.values[e] <= utility:  # sorted, and prices are not negative
            break
        utility = max(utility, worth.values[e] - found.p[worth.tasks[e]])
    for b in range(len(found.least)):
        utility = max(utility, worth.leave[agent, b] - found.least[b])
    return utility


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _augment(root, worth, found, search):
    """Insert one unassigned agent by a shortest augmenting path; False if there is none."""
    row_start, tasks, values, leave, dues = worth
    chosen, owner, u, p, least, lowest = found
    dist, via, done, touched, hub_dist, hub_from, hub_done, heap_key, heap_item = search
    m, hubs = len(p), len(least)
    u[root] = _utility(root, worth, found)
    if u[root] == -np.inf:
        return False
    for b in range(hubs):
        hub_dist[b] = np.inf
        hub_done[b] = False
    end, end_task = np.inf, np.int64(-1)  # the nearest free task so far
    size = np.int64(0)  # a plain 0 would be a type of its own to the compiler
    n_touched = np.int64(0)
    i, length = root, 0.0
    while True:
        # Out of agent i, at distance `length`: along its row, and to the hubs.
        base = length + u[i]
        for e in range(row_start[i], row_start[i + 1]):
            if base - values[e] >= end:  # prices are not negative, so no later entry is nearer
                break
            j = np.int64(tasks[e])
            if done[j] or owner[j] == i:
                continue
            reach = length + max(0.0, u[i] + p[j] - values[e])
            if reach >= end or reach >= dist[j]:
                continue
            n_touched = _touch(j, reach, i, search, n_touched)
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
        # The next nearest task that somebody owns; hubs on the way are passed through.
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
                # The hub's nearest task is free, at no further length: the search is over.
                n_touched = _touch(j, key, hub_from[b], search, n_touched)
                end, end_task = key, j
                break
            offset = key - least[b]
            # The free tasks first: the nearest one lowers `end`, which spares the heap most of the others.
            for free in (True, False):
                for t in range(m):
                    j = np.int64(t)
                    reach = max(key, offset + dues[b, j] + p[j])
                    if reach < end and (owner[j] < 0) == free and reach < dist[j] and not done[j]:
                        n_touched = _touch(j, reach, hub_from[b], search, n_touched)
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
        while True:  # back along the path: everybody on it moves on to the next task
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
