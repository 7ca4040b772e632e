# mypy: allow-untyped-defs, allow-incomplete-defs
"""The distributed auction of one assignment problem, all agents at once.

Every agent has its own table of prices and bidders, all tasks, and merges its neighbours' tables into it: of two
entries the higher price wins, at equal prices the higher number of the bidder. Since tables only grow, it is enough to
send the entries that changed; the agents then know what they would know from whole tables.

What an agent knows is thus the highest of all bids that were made long enough ago for its distance. So the kernel need
not pass packets from link to link: a bid changes the tables one ring of agents around the bidder after the other, and
fades out where a whole ring knows better. The tables, and the entries that change in every round, are the same
(`tests/solvers/distributed/test_auction.py` plays the packets).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit


class Wishes(NamedTuple):
    """What the tasks are worth to the bidders.

    Attributes
    ----------
    row_start, tasks, gains, held, held_gain : arrays
        Rows of the n agents, as in `sapopt.data.matrices.GainMatrix`. A gain of -inf forbids a task.
    spread : (bidders,) int64
        Where a bidder begins to look for a task among those that are all worth zero to it, so that idle agents do not
        all bid for the same place. Bidder n + q is a virtual one that values all tasks alike, and lives at agent q
        modulo n.
    """

    row_start: IntArray
    tasks: NDArray[np.int32]
    gains: FloatArray
    held: IntArray
    held_gain: FloatArray
    spread: IntArray


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def best_bid(agent, wishes, price, epsilon, widest, mark, stamp):
    """Task and bid of an agent under the prices it knows; task -1 if no task is open to it.

    Tasks outside the row have gain zero. A price of +inf closes a task. `mark` (m,) holds numbers below `stamp`.
    """
    row_start, tasks, gains, held, held_gain, spread = wishes
    m = len(price)
    best, second, task = -np.inf, -np.inf, -1
    mine = -1
    if agent < len(held):
        mine = held[agent]
        if mine >= 0:
            best = held_gain[agent] - price[mine]
            if best > -np.inf:
                task = mine
        for e in range(row_start[agent], row_start[agent + 1]):
            gain = gains[e]
            if gain <= second:
                break
            j = tasks[e]
            if j == mine:
                continue
            net = gain - price[j]
            if net > best:
                second = best
                best = net
                task = j
            elif net > second:
                second = net
    # No price is below zero, so two options at or above zero are never beaten by an unlisted task.
    if second < 0.0:
        if agent < len(held):
            for e in range(row_start[agent], row_start[agent + 1]):
                mark[tasks[e]] = stamp
            if mine >= 0:
                mark[mine] = stamp
        j = spread[agent]
        for _ in range(m):
            if mark[j] != stamp:
                net = -price[j]
                if net > best:
                    second = best
                    best = net
                    task = j
                elif net > second:
                    second = net
                if second >= 0.0:
                    break
            j += 1
            if j == m:
                j = 0
    if task < 0:
        return -1, 0.0
    raised = best - second if second > -np.inf else widest
    bid = price[task] + raised + epsilon
    if bid <= price[task]:  # epsilon is below the resolution of the price: the smallest step there is
        bid = np.nextafter(price[task], np.inf)
    return task, bid


@njit(cache=True, nogil=True)
def auction(ring_start, ring_agents, wishes, price, bidder, epsilon, widest, max_rounds, stop):
    """Play one auction until nothing changes or the round limit is reached.

    Parameters
    ----------
    ring_start, ring_agents : arrays
        Agents by their distance from each of the n agents, see `Network.rings`.
    wishes : Wishes
    price, bidder : ndarray, shape (m, n)
        What every agent knows of every task; changed in place. A price of +inf closes a task to the agent.
    epsilon, widest : float
        Least raise of a bid; raise (before epsilon) by an agent that has only one task to choose from.
    max_rounds : int
    stop : ndarray of bool, shape (1,)
        Set by another thread to end the auction; what it returns then is of no use.

    Returns
    -------
    mine : ndarray of int64, shape (bidders,)
        Task on which each bidder's last bid stands, -1 if it has none.
    entries : ndarray of int32, shape (rounds, n)
        Changed entries that every agent sends in every round.
    bids : ndarray of int32, shape (rounds + 1, n)
        Bids made by every agent after round r (row 0: before the first).
    stuck : int
        An agent to whom no task is open, or -1.
    """
    m, n = price.shape
    bidders = wishes.spread.size
    widths = ring_start.shape[1] - 1
    mine = np.full(bidders, -1, np.int64)
    listed_at = np.full((m, n), -1, np.int32)  # round in which an entry last changed
    mark = np.full(m, -1, np.int64)
    stamp = np.int64(0)
    room = 64
    entries = np.zeros((room, n), np.int32)
    bids = np.zeros((room + 1, n), np.int32)
    made = 4 * bidders
    bid_agent, bid_task = np.empty(made, np.int64), np.empty(made, np.int64)
    bid_owner, bid_round = np.empty(made, np.int64), np.empty(made, np.int64)
    bid_price = np.empty(made)
    active = 0  # bids that still spread
    stuck = -1
    r = 0
    while True:
        any_news = False
        kept = 0
        for q in range(active):
            a, j, b, p = bid_agent[q], bid_task[q], bid_owner[q], bid_price[q]
            d = r - bid_round[q]
            fresh = False
            for e in range(ring_start[a, d], ring_start[a, d + 1]):
                i = ring_agents[a, e]
                if p > price[j, i] or (p == price[j, i] and b > bidder[j, i]):
                    price[j, i] = p
                    bidder[j, i] = b
                    fresh = True
                    if listed_at[j, i] != r:
                        listed_at[j, i] = r
                        entries[r, i] += 1
            any_news |= fresh
            if fresh and d + 1 < widths:
                bid_agent[kept], bid_task[kept], bid_owner[kept] = a, j, b
                bid_price[kept], bid_round[kept] = p, bid_round[q]
                kept += 1
        active = kept
        for v in range(bidders):
            i = v % n
            if mine[v] >= 0 and bidder[mine[v], i] == v:
                continue
            stamp += 1
            task, bid = best_bid(v, wishes, price[:, i], epsilon, widest, mark, stamp)
            if task < 0:
                stuck = v
                continue
            mine[v] = task
            price[task, i] = bid
            bidder[task, i] = v
            bids[r, i] += 1
            any_news = True
            if listed_at[task, i] != r:
                listed_at[task, i] = r
                entries[r, i] += 1
            if active == made:
                bid_agent, bid_task = _longer(bid_agent), _longer(bid_task)
                bid_owner, bid_round = _longer(bid_owner), _longer(bid_round)
                bid_price = _longer(bid_price)
                made *= 2
            if widths > 1:
                bid_agent[active], bid_task[active], bid_owner[active] = i, task, v
                bid_price[active], bid_round[active] = bid, r
                active += 1
        if stuck >= 0 or not any_news or r == max_rounds or stop[0]:
            break
        r += 1
        if r == room:
            entries = np.concatenate((entries, np.zeros((room, n), np.int32)))
            bids = np.concatenate((bids, np.zeros((room, n), np.int32)))
            room *= 2
    return mine, entries[:r].copy(), bids[: r + 1].copy(), stuck


@njit(cache=True, nogil=True)
def _longer(array):
    return np.concatenate((array, array))


@njit(cache=True, nogil=True)
def stamp_news(link_start, links, bids, rounds):
    """Which agents hear of a later last bid in each round: these must pass it on even if no entry changed.

    `bids` (R, n) tells who bid after round r; returns bool (rounds, n), row r for the packets sent in round r + 1.
    """
    n = len(link_start) - 1
    out = np.zeros((rounds, n), np.bool_)
    stamp = np.full(n, -1, np.int64)
    before = stamp.copy()
    for r in range(rounds):
        for i in range(n):
            before[i] = stamp[i]
        for i in range(n):
            latest = stamp[i]
            for e in range(link_start[i], link_start[i + 1]):
                latest = max(latest, before[links[e]])
            if r < len(bids) and bids[r, i] > 0:
                latest = r
            out[r, i] = latest > stamp[i]
            stamp[i] = latest
    return out


@njit(cache=True, nogil=True)
def entries_at(row_start, tasks, gains, held, held_gain, chosen):
    """Gain of every agent's chosen task, shape ``(n,)``."""
    out = np.zeros(len(chosen))
    for i in range(len(chosen)):
        if chosen[i] == held[i]:
            out[i] = held_gain[i]
            continue
        for e in range(row_start[i], row_start[i + 1]):
            if tasks[e] == chosen[i]:
                out[i] = gains[e]
                break
    return out
