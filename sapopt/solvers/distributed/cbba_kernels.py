# mypy: allow-untyped-defs, allow-incomplete-defs
"""Compiled phases of CBBA for all agents at once.

A *slot* is a task at a step of the window, number ``t * m + j``. Agent i knows of every slot the winning bid ``y[i]``
and the winner ``z[i]`` (-1: nobody), and of every agent the round ``s[i]`` of its latest news.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

LEAVE, UPDATE, RESET = 0, 1, 2


@njit(cache=True, nogil=True)
def beats(bid, agent, other_bid, other):
    """Whether a bid wins over another; equal bids go to the lower number."""
    return bid > other_bid or (bid == other_bid and agent < other)


@njit(cache=True, nogil=True)
def decide(i, k, yi, zi, yk, zk, si, sk):
    """What receiver i does about a slot on hearing sender k (Choi, Brunet and How, 2009, Table I).

    `yi`, `zi`: bid and winner as i knows them; `yk`, `zk`: as k does; `si`, `sk`: their time stamps.
    """
    if zk == k:
        if zi == i:
            return UPDATE if beats(yk, zk, yi, zi) else LEAVE
        if zi == k or zi < 0:
            return UPDATE
        return UPDATE if sk[zi] > si[zi] or beats(yk, zk, yi, zi) else LEAVE
    if zk == i:
        if zi == i or zi < 0:
            return LEAVE
        if zi == k:
            return RESET
        return RESET if sk[zi] > si[zi] else LEAVE
    if zk >= 0:
        newer = sk[zk] > si[zk]
        if zi == i:
            return UPDATE if newer and beats(yk, zk, yi, zi) else LEAVE
        if zi == k:
            return UPDATE if newer else RESET
        if zi == zk or zi < 0:
            return UPDATE if newer else LEAVE
        if newer and (sk[zi] > si[zi] or beats(yk, zk, yi, zi)):
            return UPDATE
        if sk[zi] > si[zi] and si[zk] > sk[zk]:
            return RESET
        return LEAVE
    if zi == i or zi < 0:
        return LEAVE
    if zi == k:
        return UPDATE
    return UPDATE if sk[zi] > si[zi] else LEAVE


@njit(cache=True, nogil=True)
def disputed(y, z):
    """Slots on which the tables of the agents differ; on all others every rule changes nothing."""
    n, slots = z.shape
    differs = np.zeros(slots, np.bool_)
    for i in range(1, n):
        for c in range(slots):
            differs[c] |= (z[i, c] != z[0, c]) | (y[i, c] != y[0, c])
    return np.flatnonzero(differs)


@njit(cache=True, nogil=True)
def charge(cost, a, b):
    """Cost of moving from task a to task b; `cost` is 1 by 1 if uniform, and nothing is paid from or to no task."""
    if a < 0 or b < 0 or a == b:
        return 0.0
    return cost[0, 0] if len(cost) == 1 else cost[a, b]


@njit(cache=True, nogil=True)
def build(i, n, m, steps, indptr, indices, data, held, cost, open_task, y, z, path, order, bids, count):
    """Add slots to agent i's bundle while it gains by one and wins it; returns the new length of the bundle.

    The gain of a slot is its benefit less the handovers that it adds to the path: from the task before it and to the
    task after it. Idle steps change nothing. What is announced is never more than the bid before it in the bundle.
    """
    while count < steps:
        best, best_slot, best_bid = 0.0, -1, 0.0
        for t in range(steps):
            if path[t] >= 0:
                continue
            before = held
            for q in range(t):
                if path[q] >= 0:
                    before = path[q]
            after = -1
            for q in range(steps - 1, t, -1):
                if path[q] >= 0:
                    after = path[q]
            saved = charge(cost, before, after)
            for e in range(indptr[t * n + i], indptr[t * n + i + 1]):
                j = indices[e]
                if not open_task[j] or not data[e] > 0.0:
                    continue
                gain = data[e] - charge(cost, before, j) - charge(cost, j, after) + saved
                if gain <= best:
                    continue
                bid = min(gain, bids[count - 1]) if count else gain
                c = t * m + j
                if z[c] < 0 or beats(bid, i, y[c], z[c]):
                    best, best_slot, best_bid = gain, c, bid
        if best_slot < 0:
            break
        order[count] = best_slot
        bids[count] = best_bid
        path[best_slot // m] = best_slot % m
        y[best_slot] = best_bid
        z[best_slot] = i
        count += 1
    return count


@njit(cache=True, nogil=True)
def release(i, m, y, z, path, order, count):
    """Give up the first slot of the bundle that was lost and all after it: their scores rested on it."""
    for q in range(count):
        if z[order[q]] != i:
            path[order[q] // m] = -1
            for later in range(q + 1, count):
                c = order[later]
                path[c // m] = -1
                if z[c] == i:
                    z[c] = -1
                    y[c] = 0.0
            return q
    return count


@njit(cache=True, nogil=True)
def bundle_phase(
    n, m, steps, indptr, indices, data, held, cost, open_task, y, z, path, order, bids, count, changed
):
    """Release what was lost and build on, every agent."""
    for i in range(n):
        kept = release(i, m, y[i], z[i], path[i], order[i], count[i])
        if kept < count[i]:
            changed[i] = True
        grown = build(
            i, n, m, steps, indptr, indices, data, held[i], cost, open_task[i], y[i], z[i], path[i], order[i],
            bids[i], kept,
        )  # fmt: skip
        if grown > kept:
            changed[i] = True
        count[i] = grown


@njit(cache=True, parallel=True, nogil=True)
def consensus_phase(link_start, links, r, slots, y, z, s, y_sent, z_sent, s_sent, changed):
    """Hear the tables that all neighbours sent, in ascending order of the neighbours; `slots` are those in dispute."""
    n = len(link_start) - 1
    for i in prange(n):
        for e in range(link_start[i], link_start[i + 1]):
            k = links[e]
            for c in slots:
                if z[i, c] == z_sent[k, c] and y[i, c] == y_sent[k, c]:
                    continue
                action = decide(i, k, y[i, c], z[i, c], y_sent[k, c], z_sent[k, c], s[i], s_sent[k])
                if action == UPDATE:
                    y[i, c] = y_sent[k, c]
                    z[i, c] = z_sent[k, c]
                    changed[i] = True
                elif action == RESET:
                    y[i, c] = 0.0
                    z[i, c] = -1
                    changed[i] = True
            for a in range(n):
                if s_sent[k, a] > s[i, a]:
                    s[i, a] = s_sent[k, a]
            s[i, k] = r
        s[i, i] = r
