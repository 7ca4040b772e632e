"""Sparse maximum-weight matching by shortest augmenting paths, and the parking of idle agents.

The problem: every agent has a few tasks of known gain, one of them (the task it holds) perhaps with a gain of its own,
and a private option of gain zero, idling. Choose at most one task for an agent and one agent for a task so that the
total gain is greatest. This is the assignment problem alpha(beta_hat) after the value that all other tasks have alike
was subtracted.

Rows are sorted by decreasing gain, so a search stops as soon as the rest of a row cannot matter. The duals are
utilities ``u[i] >= 0`` and prices ``p[j] >= 0`` with ``u[i] + p[j] >= gain[i, j]``, tight on matched pairs, zero for
idle agents and free tasks (Jonker and Volgenant, 1987; Bertsekas, 1998, chapter 7).
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from sapopt.kernels import ties
from sapopt.kernels.heap import pop, push
from sapopt.kernels.jit import SMALL, njit
from sapopt.kernels.ties import Matching, Rows

_ROUNDS = 20  # passes of row reduction; a search costs more than a pass over the few agents that still wait

Search = namedtuple("Search", "dist via touched heap_key heap_task")
"""Work arrays of a search: of every task its distance (infinite between searches) and the agent it was reached ``via``;
the tasks ``touched``; a heap of tasks."""


@njit(cache=True, nogil=True, small=SMALL)
def assign_and_park(row_start, tasks, gains, held, held_gain, order, careful):
    """`solve_rows` without the prices."""
    chosen, gain, parked, _ = solve_rows(row_start, tasks, gains, held, held_gain, order, careful)
    return chosen, gain, parked


@njit(cache=True, nogil=True, small=SMALL)
def solve_rows(row_start, tasks, gains, held, held_gain, order, careful):
    """Matching, canonical choice among ties, parking.

    Parameters
    ----------
    row_start, tasks, gains : arrays
        CSR rows, each sorted by decreasing gain.
    held : ndarray of int64, shape (n,)
        Task whose gain is `held_gain` rather than the listed one; -1 for none.
    held_gain : ndarray of float64, shape (n,)
    order, careful
        See `park`.

    Returns
    -------
    chosen : ndarray of int64, shape (n,)
    gain : float
        Total gain over everybody idling.
    parked : bool
        See `park`.
    p : ndarray of float64, shape (m,)
        Optimal prices of the tasks.
    """
    starts, choices, worth = positive_rows(row_start, tasks, gains, held, held_gain)
    chosen, owner, u, p, _, _ = match(starts, choices, worth, len(order))
    ties.settle(starts, choices, worth, chosen, owner, u, p)
    gain = 0.0
    for i in range(len(chosen)):
        if chosen[i] >= 0:
            e = starts[i]
            while choices[e] != chosen[i]:
                e += 1
            gain += worth[e]
    parked = park(row_start, tasks, gains, held, held_gain, chosen, owner, order, careful)
    return chosen, gain, parked, p


@njit(cache=True, nogil=True, small=SMALL)
def positive_rows(row_start, tasks, gains, held, held_gain):
    """Rows that list positive gains only, the held task among them in its place; sorted by decreasing gain.

    Copying the rows costs less than asking at every entry whether it is the held task.
    """
    n = len(held)
    starts = np.empty(n + 1, np.int64)
    choices = np.empty(row_start[n] + n, np.int32)
    worth = np.empty(row_start[n] + n)
    filled = 0
    starts[0] = 0
    for i in range(n):
        mine = held[i]
        own = held_gain[i] if mine >= 0 else 0.0
        for e in range(row_start[i], row_start[i + 1]):
            g = gains[e]
            if g <= 0.0:
                break
            if tasks[e] == mine:
                continue
            if own > g:
                choices[filled] = mine
                worth[filled] = own
                filled += 1
                own = 0.0
            choices[filled] = tasks[e]
            worth[filled] = g
            filled += 1
        if own > 0.0:
            choices[filled] = mine
            worth[filled] = own
            filled += 1
        starts[i + 1] = filled
    return starts, choices[:filled], worth[:filled]


@njit(cache=True, nogil=True, small=SMALL)
def match(row_start, tasks, gains, m):
    """Find the matching of greatest total gain.

    Parameters
    ----------
    row_start, tasks, gains : arrays
        CSR rows of positive gains, each sorted by decreasing gain.
    m : int
        Number of tasks.

    Returns
    -------
    chosen : ndarray of int64, shape (n,)
        Task of every agent, -1 if idle.
    owner : ndarray of int64, shape (m,)
        Agent of every task, -1 if free.
    u, p : ndarray of float64
        Utilities of the agents and prices of the tasks, a proof of optimality.
    augmentations, scanned : int
        Agents that needed a search, and entries of rows looked at: the work, whatever the machine.
    """
    n = len(row_start) - 1
    chosen = np.full(n, -1, np.int64)
    owner = np.full(m, -1, np.int64)
    u = np.zeros(n)
    p = np.zeros(m)
    rows, found = Rows(row_start, tasks, gains), Matching(chosen, owner, u, p)
    queue = np.arange(n)
    waiting = n
    scanned = 0
    for _ in range(_ROUNDS):
        if waiting == 0:
            break
        waiting, seen = _reduce_rows(rows, found, queue, waiting)
        scanned += seen
    if waiting > 0:
        dist = np.full(m, np.inf)
        via = np.empty(m, np.int64)
        touched = np.empty(m, np.int64)
        heap_key = np.empty(row_start[n] + 1)
        heap_task = np.empty(row_start[n] + 1, np.int64)
        search = Search(dist, via, touched, heap_key, heap_task)
        for q in range(waiting):
            scanned += _augment(queue[q], rows, found, search)
    return chosen, owner, u, p, waiting, scanned


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _reduce_rows(rows, found, queue, waiting):
    """One pass of row reduction over the queue; who is left without a task is queued again.

    An agent takes its best task and prices it up to its own second choice; who held it tries again. Returns how many
    are queued, and how many entries were looked at.
    """
    row_start, tasks, gains = rows
    chosen, owner, u, p = found
    again = 0
    scanned = 0
    for q in range(waiting):
        i = queue[q]
        best, second, task = 0.0, 0.0, np.int64(-1)
        for e in range(row_start[i], row_start[i + 1]):
            g = gains[e]
            scanned += 1
            if g <= second:
                break
            net = g - p[tasks[e]]
            if net > best:
                second = best
                best = net
                task = np.int64(tasks[e])
            elif net > second:
                second = net
        if task < 0:
            u[i] = 0.0
            continue
        loser = owner[task]
        if loser >= 0:
            if best <= second:  # a tie moves nothing; leave it to the searches
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
    return again, scanned


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _augment(start, rows, found, search):
    """Insert one unassigned agent by a shortest augmenting path (Dijkstra on reduced costs).

    A path leads from the agent to a task at the length ``u + p - gain >= 0``, from a task to its owner at no length,
    and ends at a free task or at an agent that goes idle, whose utility is the last length. With ``dist`` the distances
    and ``end`` that of the nearest end, the new duals are ``u - end`` of the agent, and ``p[j] + end - dist[j]`` and
    ``u[owner[j]] - (end - dist[j])`` for the tasks reached for good: no length gets negative, and those of the path
    get zero.

    Parameters
    ----------
    start : int
        The agent.
    rows : Rows
    found : Matching
        Changed in place.
    search : Search

    Returns
    -------
    int
        How many entries of rows were looked at.
    """
    row_start, tasks, gains = rows
    chosen, owner, u, p = found
    dist, via, touched, heap_key, heap_task = search
    utility = 0.0
    scanned = 0
    for e in range(row_start[start], row_start[start + 1]):
        if gains[e] <= utility:
            break
        utility = max(utility, gains[e] - p[tasks[e]])
    u[start] = utility

    end_length = utility  # the agent itself may idle
    end_agent = start
    end_task = np.int64(-1)
    size = np.int64(0)  # a plain 0 would be a type of its own to the compiler
    n_touched = np.int64(0)
    i = start
    length = 0.0
    while True:
        utility = u[i]
        base = length + utility
        for e in range(row_start[i], row_start[i + 1]):
            scanned += 1
            g = gains[e]
            if base - g >= end_length:  # prices are not negative, so no later entry is nearer
                break
            j = np.int64(tasks[e])
            reach = length + max(0.0, utility + p[j] - g)
            # A distance that is final, that of the agent's own task among them, is not greater than `length`.
            if reach >= end_length or reach >= dist[j]:
                continue
            if dist[j] == np.inf:
                touched[n_touched] = j
                n_touched += 1
            dist[j] = reach
            via[j] = i
            if owner[j] < 0:
                end_length = reach
                end_task = j
            else:
                size = push(heap_key, heap_task, size, reach, j)
        # The next nearest task that somebody owns. Entries of tasks that were reached again on a shorter way are stale.
        task = np.int64(-1)
        while size > 0:
            key = heap_key[0]
            j = heap_task[0]
            size = pop(heap_key, heap_task, size)
            if key <= dist[j]:
                task = j
                break
        if task < 0 or dist[task] >= end_length:
            break
        i = owner[task]
        length = dist[task]
        if length + u[i] < end_length:
            end_length = length + u[i]
            end_agent = i
            end_task = np.int64(-1)

    # The new duals; then back along the path: everybody on it moves on to the next task.
    u[start] -= end_length
    for t in range(n_touched):
        j = touched[t]
        if dist[j] < end_length:  # reached for good
            p[j] += end_length - dist[j]
            u[owner[j]] -= end_length - dist[j]
    task = end_task
    if task < 0 and end_agent != start:
        task = chosen[end_agent]
        chosen[end_agent] = -1
        u[end_agent] = 0.0
    while task >= 0:
        i = via[task]
        previous = chosen[i]
        chosen[i] = task
        owner[task] = i
        if i == start:
            break
        task = previous
    for t in range(n_touched):
        dist[touched[t]] = np.inf
    return scanned


@njit(cache=True, nogil=True, small=SMALL)
def park(row_start, tasks, gains, held, held_gain, chosen, owner, order, careful):
    """Give every idle agent, in ascending index, the first free task of `order`; in place.

    Parameters
    ----------
    order : ndarray of int64, shape (m,)
        Tasks in the order in which they are tried.
    careful : bool
        Skip pairs of negative gain (listed below the common value, or forbidden). Without negative gains the check
        would only cost time.

    Returns
    -------
    bool
        False if an agent found no task; then idling is not free here and the matching must be found another way.
    """
    n = len(chosen)
    m = len(order)
    first = 0
    bad = np.zeros(m if careful else 0, np.int64)
    for i in range(n):
        if chosen[i] >= 0:
            continue
        while first < m and owner[order[first]] >= 0:
            first += 1
        if careful:
            for e in range(row_start[i], row_start[i + 1]):
                if gains[e] < 0.0 and tasks[e] != held[i]:
                    bad[tasks[e]] = i + 1
            if held[i] >= 0 and held_gain[i] < 0.0:
                bad[held[i]] = i + 1
        spot = first
        while spot < m and (owner[order[spot]] >= 0 or (careful and bad[order[spot]] == i + 1)):
            spot += 1
        if spot == m:
            return False
        j = order[spot]
        owner[j] = i
        chosen[i] = j
    return True


@njit(cache=True, nogil=True, small=SMALL)
def greedy(row_start, tasks, gains, held, held_gain, m):
    """Agents in ascending index take their best free task of positive gain; owners as in `match`."""
    n = len(row_start) - 1
    chosen = np.full(n, -1, np.int64)
    owner = np.full(m, -1, np.int64)
    for i in range(n):
        best = 0.0
        if held[i] >= 0 and owner[held[i]] < 0 and held_gain[i] > best:
            best = held_gain[i]
            chosen[i] = held[i]
        for e in range(row_start[i], row_start[i + 1]):
            if gains[e] <= best:
                break
            if tasks[e] != held[i] and owner[tasks[e]] < 0:
                chosen[i] = tasks[e]
                break
        if chosen[i] >= 0:
            owner[chosen[i]] = i
    return chosen, owner


@njit(cache=True, nogil=True, small=SMALL)
def total_gain(row_start, tasks, gains, held, held_gain, chosen):
    """Total gain of an assignment; pairs that are not listed count 0."""
    total = 0.0
    for i in range(len(chosen)):
        j = chosen[i]
        if j == held[i]:
            if j >= 0:
                total += held_gain[i]
            continue
        for e in range(row_start[i], row_start[i + 1]):
            if tasks[e] == j:
                total += gains[e]
                break
    return total


@njit(cache=True, nogil=True, small=SMALL)
def duals(row_start, tasks, gains, held, held_gain, chosen, owner):
    """`sapopt.kernels.ties.duals` for rows with a held task."""
    rows = positive_rows(row_start, tasks, gains, held, held_gain)
    return ties.duals(rows[0], rows[1], rows[2], chosen, owner)


@njit(cache=True, nogil=True, small=SMALL)
def settle_ties(row_start, tasks, gains, held, held_gain, chosen, owner, u, p):
    """`sapopt.kernels.ties.settle` for rows with a held task."""
    rows = positive_rows(row_start, tasks, gains, held, held_gain)
    ties.settle(rows[0], rows[1], rows[2], chosen, owner, u, p)
