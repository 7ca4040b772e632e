"""Sparse maximum-weight matching by shortest augmenting paths, and the parking of idle agents.

The problem: every agent has a few tasks of known gain, one of them (the task it holds) perhaps with a gain of its own,
and a private option of gain zero, idling. Choose at most one task for an agent and one agent for a task so that the
total gain is greatest. This is the assignment problem alpha(beta_hat) after the value that all other tasks have alike
was subtracted.

Rows are sorted by decreasing gain, so a search stops as soon as the rest of a row cannot matter. The duals are
utilities ``u[i] >= 0`` and prices ``p[j] >= 0`` with ``u[i] + p[j] >= gain[i, j]``, tight on matched pairs, zero for idle
agents and free tasks (Jonker and Volgenant, 1987; Bertsekas, 1998, chapter 7).
"""

from __future__ import annotations

import numpy as np
from numba import njit

_ROUNDS = 2  # passes of row reduction before the searches; more of them bring nothing on constellations


@njit(cache=True, nogil=True)
def match(row_start, tasks, gains, held, held_gain, m):
    """Find the matching of greatest total gain.

    Parameters
    ----------
    row_start, tasks, gains : arrays
        CSR rows, each sorted by decreasing gain.
    held : ndarray of int64, shape (n,)
        Task whose gain is `held_gain` rather than the listed one; -1 for none.
    held_gain : ndarray of float64, shape (n,)
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
    """
    n = len(row_start) - 1
    chosen = np.full(n, -1, np.int64)
    owner = np.full(m, -1, np.int64)
    u = np.zeros(n)
    p = np.zeros(m)

    # Row reduction: an agent takes its best task and prices it up to its own second choice; who held it tries again.
    queue = np.arange(n)
    waiting = n
    for _ in range(_ROUNDS):
        if waiting == 0:
            break
        again = 0
        for q in range(waiting):
            i = queue[q]
            best, second, task = 0.0, 0.0, -1
            if held[i] >= 0 and held_gain[i] - p[held[i]] > 0.0:
                best = held_gain[i] - p[held[i]]
                task = held[i]
            for e in range(row_start[i], row_start[i + 1]):
                g = gains[e]
                if g <= second:
                    break
                j = tasks[e]
                if j == held[i]:
                    continue
                net = g - p[j]
                if net > best:
                    second = best
                    best = net
                    task = j
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
        waiting = again

    if waiting > 0:
        width = 0
        for i in range(n):
            width = max(width, row_start[i + 1] - row_start[i])
        dist = np.full(m, np.inf)
        via = np.empty(m, np.int64)
        done = np.zeros(m, np.bool_)
        touched = np.empty(m, np.int64)
        heap_key = np.empty(row_start[n] + n + 1)
        heap_task = np.empty(row_start[n] + n + 1, np.int64)
        for q in range(waiting):
            _augment(
                queue[q], row_start, tasks, gains, held, held_gain, chosen, owner, u, p,
                dist, via, done, touched, heap_key, heap_task,
            )  # fmt: skip
    return chosen, owner, u, p


@njit(cache=True, nogil=True)
def _augment(
    start, row_start, tasks, gains, held, held_gain, chosen, owner, u, p,
    dist, via, done, touched, heap_key, heap_task,
):  # fmt: skip
    """Insert one unassigned agent by a shortest augmenting path (Dijkstra on reduced costs)."""
    utility = 0.0
    if held[start] >= 0:
        utility = max(0.0, held_gain[start] - p[held[start]])
    for e in range(row_start[start], row_start[start + 1]):
        g = gains[e]
        if g <= utility:
            break
        if tasks[e] != held[start]:
            utility = max(utility, g - p[tasks[e]])
    u[start] = utility

    end_length = utility  # the agent itself may idle
    end_agent = start
    end_task = -1
    size = 0
    n_touched = 0
    i = start
    length = 0.0
    while True:
        # The held task first (its gain is out of order), then the row.
        for e in range(row_start[i] - 1, row_start[i + 1]):
            if e < row_start[i]:
                j = held[i]
                if j < 0:
                    continue
                g = held_gain[i]
                if g <= 0.0 or length + u[i] - g >= end_length:
                    continue
            else:
                g = gains[e]
                if g <= 0.0 or length + u[i] - g >= end_length:
                    break
                j = tasks[e]
                if j == held[i]:
                    continue
            if done[j] or owner[j] == i:
                continue
            reach = length + max(0.0, u[i] + p[j] - g)
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
                size = _push(heap_key, heap_task, size, reach, j)
        # Next nearest task.
        task = -1
        while size > 0:
            key = heap_key[0]
            j = heap_task[0]
            size = _pop(heap_key, heap_task, size)
            if not done[j] and key <= dist[j]:
                task = j
                break
        if task < 0 or dist[task] >= end_length:
            break
        done[task] = True
        i = owner[task]
        length = dist[task]
        if length + u[i] < end_length:
            end_length = length + u[i]
            end_agent = i
            end_task = -1

    u[start] -= end_length
    for t in range(n_touched):
        j = touched[t]
        if done[j]:
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
        done[touched[t]] = False


@njit(cache=True, nogil=True)
def _push(key, item, size, value, what):
    q = size
    while q > 0:
        parent = (q - 1) >> 1
        if key[parent] <= value:
            break
        key[q] = key[parent]
        item[q] = item[parent]
        q = parent
    key[q] = value
    item[q] = what
    return size + 1


@njit(cache=True, nogil=True)
def _pop(key, item, size):
    size -= 1
    value = key[size]
    what = item[size]
    q = 0
    while True:
        child = 2 * q + 1
        if child >= size:
            break
        if child + 1 < size and key[child + 1] < key[child]:
            child += 1
        if key[child] >= value:
            break
        key[q] = key[child]
        item[q] = item[child]
        q = child
    key[q] = value
    item[q] = what
    return size


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def assign_and_park(row_start, tasks, gains, held, held_gain, order, careful):
    """Matching, canonical choice among ties, parking.

    Returns
    -------
    chosen : ndarray of int64, shape (n,)
    gain : float
        Total gain over everybody idling.
    parked : bool
        See `park`.
    """
    chosen, owner, u, p = match(row_start, tasks, gains, held, held_gain, len(order))
    settle_ties(row_start, tasks, gains, held, held_gain, chosen, owner, u, p)
    parked = park(row_start, tasks, gains, held, held_gain, chosen, owner, order, careful)
    return chosen, total_gain(row_start, tasks, gains, held, held_gain, chosen), parked


@njit(cache=True, nogil=True)
def duals(row_start, tasks, gains, held, held_gain, chosen, owner):
    """Smallest prices that support an optimal matching found elsewhere, by label correction (Bellman-Ford).

    Returns
    -------
    u, p : ndarray of float64
        As in `match`.
    """
    n, m = len(chosen), len(owner)
    own = np.zeros(n)
    top = 0.0
    for i in range(n):
        if chosen[i] == held[i] and chosen[i] >= 0:
            own[i] = held_gain[i]
        for e in range(row_start[i], row_start[i + 1]):
            top = max(top, gains[e])
            if tasks[e] == chosen[i] and tasks[e] != held[i]:
                own[i] = gains[e]
        if held[i] >= 0:
            top = max(top, held_gain[i])
    p = np.zeros(m)
    slack = 1e-14 * top  # below rounding: a cycle of gain zero must not be chased
    for _ in range(n + 1):
        moved = False
        for i in range(n):
            c = chosen[i]
            utility = own[i] - p[c] if c >= 0 else 0.0
            j = held[i]
            if j >= 0 and j != c and held_gain[i] - utility > p[j] + slack:
                p[j] = held_gain[i] - utility
                moved = True
            for e in range(row_start[i], row_start[i + 1]):
                j = tasks[e]
                if gains[e] - utility <= slack:
                    break
                if j != c and j != held[i] and gains[e] - utility > p[j] + slack:
                    p[j] = gains[e] - utility
                    moved = True
        if not moved:
            break
    u = np.zeros(n)
    for i in range(n):
        if chosen[i] >= 0:
            u[i] = max(0.0, own[i] - p[chosen[i]])
    return u, p


@njit(cache=True, nogil=True)
def settle_ties(row_start, tasks, gains, held, held_gain, chosen, owner, u, p):
    """Turn an optimal matching into the lexicographically smallest optimal one (an idle agent counts as task m).

    Every optimal matching uses tight pairs only (complementary slackness), so the others are reached through
    alternating paths of tight pairs. Where those form no cycle the matching is the only one, which is the usual case
    and costs one pass over the tight pairs.
    """
    n = len(chosen)
    m = len(owner)
    top = 0.0
    for i in range(n):
        if row_start[i] < row_start[i + 1]:
            top = max(top, gains[row_start[i]])
        if held[i] >= 0:
            top = max(top, held_gain[i])
    tol = 1e-11 * top
    if top <= 0.0:
        return

    # Tight pairs outside the matching. Agent n is the pool: of free tasks and of private idle options.
    head = np.empty(row_start[n] + 3 * n + 1, np.int64)
    start = np.zeros(n + 2, np.int64)
    count = 0
    for i in range(n):
        start[i] = count
        if chosen[i] >= 0 and u[i] <= tol:
            head[count] = n
            count += 1
        j = held[i]
        if j >= 0 and j != chosen[i] and held_gain[i] > 0.0 and held_gain[i] - p[j] >= u[i] - tol:
            head[count] = owner[j] if owner[j] >= 0 else n
            count += 1
        for e in range(row_start[i], row_start[i + 1]):
            g = gains[e]
            if g <= 0.0 or g < u[i] - tol:
                break
            j = tasks[e]
            if j == held[i] or j == chosen[i] or g - p[j] < u[i] - tol:
                continue
            head[count] = owner[j] if owner[j] >= 0 else n
            count += 1
    start[n] = count
    if count == 0:
        return
    for i in range(
        n
    ):  # what the pool may take back: an idle option, or a task that is worth nothing to leave free
        if chosen[i] < 0 or p[chosen[i]] <= tol:
            head[count] = i
            count += 1
    start[n + 1] = count

    # No cycle: nothing to choose (Kahn's topological order).
    into = np.zeros(n + 1, np.int64)
    for e in range(count):
        into[head[e]] += 1
    stack = np.empty(n + 1, np.int64)
    size = 0
    for v in range(n + 1):
        if into[v] == 0:
            stack[size] = v
            size += 1
    removed = 0
    while size > 0:
        size -= 1
        v = stack[size]
        removed += 1
        for e in range(start[v], start[v + 1]):
            into[head[e]] -= 1
            if into[head[e]] == 0:
                stack[size] = head[e]
                size += 1
    if removed < n + 1:
        _smallest(row_start, tasks, gains, held, held_gain, chosen, owner, u, p, tol, m)


@njit(cache=True, nogil=True)
def _smallest(row_start, tasks, gains, held, held_gain, chosen, owner, u, p, tol, m):
    """Agent by agent, switch to the smallest tight task that leaves an optimal matching of the agents after it."""
    n = len(chosen)
    option = np.empty(m + 1, np.int64)
    seen = np.full(n + 1, -1, np.int64)
    parent = np.empty(n + 1, np.int64)
    taken = np.empty(n + 1, np.int64)
    queue = np.empty(n + 1, np.int64)
    stamp = 0
    for i in range(n):
        current = chosen[i] if chosen[i] >= 0 else m
        size = _tight(i, row_start, tasks, gains, held, held_gain, u, p, tol, option)
        wanted = np.sort(option[:size])
        for w in range(size):
            j = wanted[w]
            if j >= current:
                break
            stamp += 1
            if _redirect(
                i, j, stamp, row_start, tasks, gains, held, held_gain, chosen, owner, u, p, tol,
                seen, parent, taken, queue, option,
            ):  # fmt: skip
                break


@njit(cache=True, nogil=True)
def _tight(i, row_start, tasks, gains, held, held_gain, u, p, tol, option):
    """List the tasks that agent i may have in an optimal matching as far as its own duals tell."""
    size = 0
    j = held[i]
    if j >= 0 and held_gain[i] > 0.0 and held_gain[i] - p[j] >= u[i] - tol:
        option[size] = j
        size += 1
    for e in range(row_start[i], row_start[i + 1]):
        g = gains[e]
        if g <= 0.0 or g < u[i] - tol:
            break
        if tasks[e] != held[i] and g - p[tasks[e]] >= u[i] - tol:
            option[size] = tasks[e]
            size += 1
    return size


@njit(cache=True, nogil=True)
def _redirect(
    i, wish, stamp, row_start, tasks, gains, held, held_gain, chosen, owner, u, p, tol,
    seen, parent, taken, queue, option,
):  # fmt: skip
    """Move agent i to task `wish` along an alternating path of tight pairs through agents after i, if there is one.

    Who loses a task moves on to another tight one. The pool (node n) gives free tasks and private idle options, and
    takes back an idle option or a task of price zero from any agent. The path ends at the option that i leaves.
    """
    n = len(chosen)
    left = chosen[i]
    left_may_stay_free = left < 0 or p[left] <= tol
    node = owner[wish] if owner[wish] >= 0 else n
    if node < i:
        return False
    seen[node] = stamp
    parent[node] = i
    taken[node] = wish
    queue[0] = node
    head, tail = 0, 1
    end = -1
    while head < tail and end < 0:
        r = queue[head]
        head += 1
        if r == n:
            if left_may_stay_free:
                end = n
                break
            for other in range(i + 1, n):
                if seen[other] != stamp and (chosen[other] < 0 or p[chosen[other]] <= tol):
                    seen[other] = stamp
                    parent[other] = n
                    taken[other] = -2
                    queue[tail] = other
                    tail += 1
            continue
        if chosen[r] >= 0 and u[r] <= tol and seen[n] != stamp:
            seen[n] = stamp
            parent[n] = r
            taken[n] = -1
            queue[tail] = n
            tail += 1
        size = _tight(r, row_start, tasks, gains, held, held_gain, u, p, tol, option)
        for q in range(size):
            j = option[q]
            if j == chosen[r]:
                continue
            if j == left:
                end = r
                break
            node = owner[j] if owner[j] >= 0 else n
            if node <= i or seen[node] == stamp:
                continue
            seen[node] = stamp
            parent[node] = r
            taken[node] = j
            queue[tail] = node
            tail += 1
    if end < 0:
        return False
    r = end
    take = left if end < n else np.int64(-1)
    while True:  # free what the agents on the path hold, then hand out what they take
        if r < n and chosen[r] >= 0:
            owner[chosen[r]] = -1
        if r == i:
            break
        r = parent[r]
    r = end
    while True:
        if r < n:
            chosen[r] = take
            if take >= 0:
                owner[take] = r
        if r == i:
            break
        take = taken[r]
        r = parent[r]
    return True
