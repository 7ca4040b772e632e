# mypy: allow-untyped-defs, allow-incomplete-defs
"""Compiled phases of CBBA for all agents at once.

A *slot* is a task at a step of the window, number ``t * m + j``. Agent i knows of every slot the winning bid ``y[i]``
and the winner ``z[i]`` (-1: nobody), and of every agent the round ``s[i]`` of its latest news.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit

LEAVE, UPDATE, RESET = 0, 1, 2


class Offers(NamedTuple):
    """What the agents bid for: the benefits of a window of L steps, and what a handover costs.

    Attributes
    ----------
    steps, n, m : int
    indptr, indices, data : arrays
        CSR rows; row ``t * n + i`` is agent i at step t.
    cost : (1, 1) or (m, m) float64
    held : (n,) int64
        Task before the window, -1 for none.
    open_task : (n, m) bool
        Tasks that an agent may have.
    """

    steps: int
    n: int
    m: int
    indptr: IntArray
    indices: NDArray[np.int32]
    data: FloatArray
    cost: FloatArray
    held: IntArray
    open_task: NDArray[np.bool_]


class Tables(NamedTuple):
    """What every agent knows, a row each.

    Attributes
    ----------
    bid : (n, L * m) float64
        The winning bid on every slot.
    winner : (n, L * m) int32
        Its bidder, -1 for none.
    stamp : (n, n) int32
        Round of the latest news of every agent.
    """

    bid: FloatArray
    winner: NDArray[np.int32]
    stamp: NDArray[np.int32]


class Bundles(NamedTuple):
    """What every agent wants, a row each.

    Attributes
    ----------
    path : (n, L) int64
        Task at every step, -1 for none.
    order : (n, L) int64
        The slots of the path in the order in which they were added.
    announced : (n, L) float64
        The bids on these.
    length : (n,) int64
        Length of the bundle.
    """

    path: IntArray
    order: IntArray
    announced: FloatArray
    length: IntArray


@njit(cache=True, borrows=True, nogil=True)
def beats(bid, agent, other_bid, other):
    """Whether a bid wins over another; equal bids go to the lower number."""
    return bid > other_bid or (bid == other_bid and agent < other)


@njit(cache=True, borrows=True, nogil=True)
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


@njit(cache=True, borrows=True, nogil=True)
def mark_disputed(tables, differs):
    """Mark the slots (L * m,) on which the tables of the agents differ; on all others every rule changes nothing."""
    y, z = tables.bid, tables.winner
    for i in range(1, len(y)):
        for c in range(len(differs)):
            differs[c] |= (z[i, c] != z[0, c]) | (y[i, c] != y[0, c])


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def charge(cost, a, b):
    """Cost of moving from task a to task b; `cost` is 1 by 1 if uniform, and nothing is paid from or to no task."""
    if a < 0 or b < 0 or a == b:
        return 0.0
    return cost[0, 0] if len(cost) == 1 else cost[a, b]


@njit(cache=True, borrows=True, nogil=True)
def bundle_phase(begin, end, offers, tables, bundles, changed):
    """Release what was lost and build on, every agent of a block."""
    for i in range(begin, end):
        kept = _release(i, offers.m, tables, bundles)
        if kept < bundles.length[i]:
            changed[i] = True
        grown = _build(i, offers, tables, bundles, kept)
        if grown > kept:
            changed[i] = True
        bundles.length[i] = grown


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _release(i, m, tables, bundles):
    """Give up the first slot of the bundle that was lost and all after it: their scores rested on it."""
    y, z = tables.bid[i], tables.winner[i]
    path, order = bundles.path[i], bundles.order[i]
    for q in range(bundles.length[i]):
        if z[order[q]] != i:
            path[order[q] // m] = -1
            for later in range(q + 1, bundles.length[i]):
                c = order[later]
                path[c // m] = -1
                if z[c] == i:
                    z[c] = -1
                    y[c] = 0.0
            return q
    return bundles.length[i]


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _build(i, offers, tables, bundles, count):
    """Add slots to agent i's bundle while it gains by one and wins it; returns the new length of the bundle.

    The gain of a slot is its benefit less the handovers that it adds to the path: from the task before it and to the
    task after it. Idle steps change nothing. What is announced is never more than the bid before it in the bundle.
    """
    n, m, steps, cost = offers.n, offers.m, offers.steps, offers.cost
    indptr, indices, data = offers.indptr, offers.indices, offers.data
    open_task = offers.open_task[i]
    y, z = tables.bid[i], tables.winner[i]
    path, order, announced = bundles.path[i], bundles.order[i], bundles.announced[i]
    while count < steps:
        best, best_slot, best_bid = 0.0, -1, 0.0
        for t in range(steps):
            if path[t] >= 0:
                continue
            before = offers.held[i]
            for q in range(t):
                if path[q] >= 0:
                    before = path[q]
            after = np.int64(-1)
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
                bid = min(gain, announced[count - 1]) if count else gain
                c = t * m + j
                if z[c] < 0 or beats(bid, i, y[c], z[c]):
                    best, best_slot, best_bid = gain, c, bid
        if best_slot < 0:
            break
        order[count] = best_slot
        announced[count] = best_bid
        path[best_slot // m] = best_slot % m
        y[best_slot] = best_bid
        z[best_slot] = i
        count += 1
    return count


@njit(cache=True, borrows=True, nogil=True)
def consensus_phase(begin, end, link_start, links, r, slots, tables, sent, changed):
    """Hear the tables that all neighbours sent, in ascending order of the neighbours; `slots` are those in dispute.

    The agents of a block, in round r: `tables` are theirs and change, `sent` is a copy from before the round.
    """
    n = len(link_start) - 1
    # Rows are taken out of the loops: a view that is made anew at every entry counts a reference, and two threads that
    # count references of one array slow each other down.
    for i in range(begin, end):
        y, z, s = tables.bid[i], tables.winner[i], tables.stamp[i]
        for e in range(link_start[i], link_start[i + 1]):
            k = links[e]
            y_sent, z_sent, s_sent = sent.bid[k], sent.winner[k], sent.stamp[k]
            for c in slots:
                if z[c] == z_sent[c] and y[c] == y_sent[c]:
                    continue
                action = decide(i, k, y[c], z[c], y_sent[c], z_sent[c], s, s_sent)
                if action == UPDATE:
                    y[c] = y_sent[c]
                    z[c] = z_sent[c]
                    changed[i] = True
                elif action == RESET:
                    y[c] = 0.0
                    z[c] = -1
                    changed[i] = True
            for a in range(n):
                if s_sent[a] > s[a]:
                    s[a] = s_sent[a]
            s[k] = r
        s[i] = r
