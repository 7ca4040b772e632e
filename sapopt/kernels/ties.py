"""The canonical choice among equally good matchings, and duals of a matching found elsewhere.

Rows list positive gains only, sorted by decreasing gain (`sapopt.kernels.matching.positive_rows`).
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from sapopt.kernels.jit import njit

_TIGHT = 1e-11  # relative to the greatest gain of the agent: a pair with less slack counts as tight

Rows = namedtuple("Rows", "row_start tasks gains")
"""CSR rows of positive gains, each sorted by decreasing gain: row i is ``row_start[i] .. row_start[i + 1] - 1``."""

Matching = namedtuple("Matching", "chosen owner u p")
"""A matching and its duals: the task ``chosen`` by every agent and the ``owner`` of every task, -1 for none; the
utilities ``u`` of the agents and the prices ``p`` of the tasks, as in `sapopt.kernels.matching`."""

Walk = namedtuple("Walk", "tied seen parent taken queue option")
"""Arrays of a breadth-first walk. Of every agent, and the pool as node n: whether it is ``tied``, that is, may be on
a walk that succeeds; the stamp of the last walk that has ``seen`` it, its ``parent``, from which it was reached, and
the task ``taken`` from it there; the ``queue``; and the tasks that an agent may have (``option``)."""


@njit(cache=True, nogil=True)
def settle(row_start, tasks, gains, chosen, owner, u, p):
    """Turn an optimal matching into the lexicographically smallest optimal one (an idle agent counts as task m).

    Every optimal matching uses tight pairs only (complementary slackness), so the others are reached through
    alternating paths of tight pairs. Where those form no cycle the matching is the only one, which is the usual case
    and costs one pass over the tight pairs.
    """
    n = len(chosen)
    # Each agent has a tolerance of its own: where one gains 1e9, thousandths of the others are no ties.
    tol = np.zeros(n)
    for i in range(n):
        if row_start[i] < row_start[i + 1]:
            tol[i] = _TIGHT * gains[row_start[i]]
    rows, matching = Rows(row_start, tasks, gains), Matching(chosen, owner, u, p)
    if row_start[n] > 0:
        count, tied = _with_choice(rows, matching, tol)
        if count > 0:
            _smallest(rows, matching, tol, tied)


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _with_choice(rows, matching, tol):
    """Find who may lie on a cycle of tight pairs outside the matching: nobody else can ever move.

    The nodes are agents that could move on, to the agent that holds the task they would take; node n is the pool of
    free tasks and private idle options, which any agent may enter that holds a task of price zero or nothing. Nodes
    that nobody leads to, and then nodes that lead to nobody, are taken away again and again (Kahn's topological
    order). Moving along a cycle changes no strongly connected part of such a graph, so what is taken away need not be
    looked at afterwards either.

    Returns
    -------
    count : int
        Nodes that are left.
    tied : ndarray of bool, shape (n + 1,)
        Which they are.
    """
    row_start, tasks, gains = rows
    chosen, owner, u, p = matching
    n = len(chosen)
    head = np.empty(row_start[n] + n, np.int32)  # where the moves lead to
    first = np.empty(n + 1, np.int64)
    last = np.zeros(n + 1, np.int64)
    movers = np.empty(n, np.int64)
    gives = np.zeros(n, np.bool_)  # whether the pool leads to the agent
    into = np.zeros(n + 1, np.int32)
    count = 0
    size = 0
    for i in range(n):
        begin = count
        if chosen[i] >= 0 and u[i] <= tol[i]:
            head[count] = n
            count += 1
        least = u[i] - tol[i]
        for e in range(row_start[i], row_start[i + 1]):
            if gains[e] < least:
                break
            j = tasks[e]
            if j != chosen[i] and gains[e] - p[j] >= least:
                head[count] = owner[j] if owner[j] >= 0 else n
                count += 1
        if count > begin:
            first[i] = begin
            last[i] = count
            movers[size] = i
            size += 1
            gives[i] = chosen[i] < 0 or p[chosen[i]] <= tol[i]
            if gives[i]:
                into[i] += 1
    for e in range(count):
        into[head[e]] += 1

    tied = np.zeros(n + 1, np.bool_)
    tied[n] = True
    left = size + 1
    stack = np.empty(size + 1, np.int64)
    waiting = 0
    for q in range(size):
        tied[movers[q]] = True
        if into[movers[q]] == 0:
            stack[waiting] = movers[q]
            waiting += 1
    if into[n] == 0:
        stack[waiting] = n
        waiting += 1
    while waiting > 0:
        waiting -= 1
        v = stack[waiting]
        tied[v] = False
        left -= 1
        if v == n:
            for q in range(size):
                i = movers[q]
                if gives[i]:
                    into[i] -= 1
                    if into[i] == 0:
                        stack[waiting] = i
                        waiting += 1
            continue
        for e in range(first[v], last[v]):
            w = head[e]
            into[w] -= 1
            if into[w] == 0 and tied[w]:
                stack[waiting] = w
                waiting += 1
    if left == 0:
        return left, tied

    # The other way round, among those that are left: the moves into a node are a chained list.
    onward = np.zeros(n + 1, np.int64)
    entry = np.full(n + 1, -1, np.int64)
    earlier = np.empty(count, np.int64)
    tail = np.empty(count, np.int64)
    for q in range(size):
        v = movers[q]
        if not tied[v]:
            continue
        for e in range(first[v], last[v]):
            w = head[e]
            if tied[w]:
                onward[v] += 1
                earlier[e] = entry[w]
                entry[w] = e
                tail[e] = v
        if gives[v] and tied[n]:
            onward[n] += 1
    for q in range(size):
        if tied[movers[q]] and onward[movers[q]] == 0:
            stack[waiting] = movers[q]
            waiting += 1
    if tied[n] and onward[n] == 0:
        stack[waiting] = n
        waiting += 1
    while waiting > 0:
        waiting -= 1
        v = stack[waiting]
        tied[v] = False
        left -= 1
        e = entry[v]
        while e >= 0:
            w = tail[e]
            onward[w] -= 1
            if onward[w] == 0:
                stack[waiting] = w
                waiting += 1
            e = earlier[e]
        if v < n and gives[v] and tied[n]:
            onward[n] -= 1
            if onward[n] == 0:
                stack[waiting] = n
                waiting += 1
    return left, tied


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _smallest(rows, matching, tol, tied):
    """Agent by agent, switch to the smallest tight task that leaves an optimal matching of the agents after it.

    An agent gets a task for good before the next one is asked, so `_redirect` may only move agents after it; wishes are
    tried in ascending order and the first one that can be granted is the smallest.
    """
    chosen, owner = matching.chosen, matching.owner
    n = len(chosen)
    m = len(owner)
    option = np.empty(m + 1, np.int64)
    wanted = np.empty(m + 1, np.int64)
    seen = np.full(n + 1, -1, np.int64)
    parent = np.empty(n + 1, np.int64)
    taken = np.empty(n + 1, np.int64)
    queue = np.empty(n + 1, np.int64)
    walk = Walk(tied, seen, parent, taken, queue, option)
    stamp = np.int64(0)
    for i in range(n):
        if not tied[i]:
            continue
        current = chosen[i] if chosen[i] >= 0 else m
        size = _tight(i, rows, matching, tol, option)
        for w in range(size):
            wanted[w] = option[w]
        last = -1
        while True:
            j = current  # the next smallest wish
            for w in range(size):
                if last < wanted[w] < j:
                    j = wanted[w]
            if j == current:
                break
            stamp += 1
            if _redirect(i, j, rows, matching, tol, stamp, walk):
                break
            last = j


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _tight(i, rows, matching, tol, option):
    """List the tasks that agent i may have in an optimal matching as far as its own duals tell."""
    row_start, tasks, gains = rows
    u, p = matching.u, matching.p
    size = 0
    for e in range(row_start[i], row_start[i + 1]):
        if gains[e] < u[i] - tol[i]:
            break
        if gains[e] - p[tasks[e]] >= u[i] - tol[i]:
            option[size] = tasks[e]
            size += 1
    return size


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _redirect(i, wish, rows, matching, tol, stamp, walk):
    """Move agent i to task `wish` along an alternating path of tight pairs through agents after i, if there is one.

    Who loses a task moves on to another tight one. The pool (node n) gives free tasks and private idle options, and
    takes back an idle option or a task of price zero from any agent. The path ends at the option that i leaves.

    By complementary slackness an optimal matching is any that uses tight pairs only, leaves no agent of positive
    utility idle and no task of positive price free; moving along such a path keeps all three.

    Parameters
    ----------
    i, wish : int
    rows : Rows
    matching : Matching
        Changed in place where the wish can be granted.
    tol : ndarray of float64, shape (n,)
        Slack up to which a pair of that agent counts as tight.
    stamp : int
        Number of this walk, which marks what it has seen.
    walk : Walk
    """
    chosen, owner, u, p = matching
    tied, seen, parent, taken, queue, option = walk
    n = len(chosen)
    left = chosen[i]
    left_may_stay_free = left < 0 or p[left] <= tol[i]
    node = owner[wish] if owner[wish] >= 0 else n
    if node < i or not tied[node]:
        return False  # it has its task for good
    seen[node] = stamp
    parent[node] = i
    taken[node] = wish
    queue[0] = node
    head, tail = 0, 1
    end = -1  # the agent, or the pool, that takes the option which i leaves
    while head < tail and end < 0:
        r = queue[head]
        head += 1
        if r == n:
            if left_may_stay_free:
                end = n
                break
            for other in range(i + 1, n):
                if (
                    tied[other]
                    and seen[other] != stamp
                    and (chosen[other] < 0 or p[chosen[other]] <= tol[other])
                ):
                    seen[other] = stamp
                    parent[other] = n
                    taken[other] = -2
                    queue[tail] = other
                    tail += 1
            continue
        if chosen[r] >= 0 and u[r] <= tol[r] and tied[n] and seen[n] != stamp:
            seen[n] = stamp
            parent[n] = r
            taken[n] = -1
            queue[tail] = n
            tail += 1
        size = _tight(r, rows, matching, tol, option)
        for q in range(size):
            j = option[q]
            if j == chosen[r]:
                continue
            if j == left:
                end = r
                break
            node = owner[j] if owner[j] >= 0 else n
            if node <= i or not tied[node] or seen[node] == stamp:
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


@njit(cache=True, nogil=True)
def duals(row_start, tasks, gains, chosen, owner):
    """Smallest prices that support an optimal matching, by label correction (Bellman-Ford).

    Returns
    -------
    u, p : ndarray of float64
        As in `sapopt.kernels.matching.match`.
    """
    n, m = len(chosen), len(owner)
    own = np.zeros(n)
    for i in range(n):
        for e in range(row_start[i], row_start[i + 1]):
            if tasks[e] == chosen[i]:
                own[i] = gains[e]
    p = np.zeros(m)
    for _ in range(n + 1):
        moved = False
        for i in range(n):
            c = chosen[i]
            utility = own[i] - p[c] if c >= 0 else 0.0
            slack = 1e-14 * gains[row_start[i]] if row_start[i] < row_start[i + 1] else 0.0  # below rounding
            for e in range(row_start[i], row_start[i + 1]):
                j = tasks[e]
                if gains[e] - utility <= slack:
                    break
                if j != c and gains[e] - utility > p[j] + slack:
                    p[j] = gains[e] - utility
                    moved = True
        if not moved:
            break
    u = np.zeros(n)
    for i in range(n):
        if chosen[i] >= 0:
            u[i] = max(0.0, own[i] - p[chosen[i]])
    return u, p
