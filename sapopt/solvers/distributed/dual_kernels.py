# mypy: allow-untyped-defs, allow-incomplete-defs
"""Compiled recursions of the distributed dual lookahead: every agent has prices of its own for the tasks it may want.

The tasks that agent i sees in the window, and the one it holds, are its *slots* ``slot_ptr[i]:slot_ptr[i + 1]``. All
other tasks are one place, *elsewhere*, where it waits for nothing; it comes last in the tables of an agent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit


@njit(cache=True, nogil=True)
def find_slots(indptr, indices, data, held, n, m, steps):
    """Slots of the agents and their benefits.

    Returns slot_ptr (n + 1,), slot_task (slots,), benefit (slots, steps), place (n, m): slot of a task, -1 for none.
    """
    place = np.full((n, m), -1, np.int32)
    slot_ptr = np.zeros(n + 1, np.int64)
    tasks = np.empty(len(indices) + n, np.int32)
    total = 0
    for i in range(n):
        if held[i] >= 0:
            place[i, held[i]] = total
            tasks[total] = held[i]
            total += 1
        for t in range(steps):
            for e in range(indptr[t * n + i], indptr[t * n + i + 1]):
                j = indices[e]
                if place[i, j] < 0:
                    place[i, j] = total
                    tasks[total] = j
                    total += 1
        slot_ptr[i + 1] = total
    benefit = np.zeros((total, steps))
    for i in range(n):
        for t in range(steps):
            for e in range(indptr[t * n + i], indptr[t * n + i + 1]):
                benefit[place[i, indices[e]], t] = data[e]
    return slot_ptr, tasks[:total].copy(), benefit, place


@njit(cache=True, borrows=True, nogil=True)
def value_to_go(benefit, price, cost, idle_is_free, first, out):
    """out[t, s] = best value over the steps t.. of an agent that held slot s (last: elsewhere) before t, t >= first."""
    slots, steps = benefit.shape
    out[steps, : slots + 1] = 0.0
    for t in range(steps - 1, first - 1, -1):
        top = out[t + 1, slots]
        if not idle_is_free:
            top -= cost
        for s in range(slots):
            arrive = benefit[s, t] - price[s, t] + out[t + 1, s]
            if not idle_is_free or benefit[s, t] > 0.0:
                arrive -= cost
            top = max(top, arrive)
        for s in range(slots):
            out[t, s] = max(top, benefit[s, t] - price[s, t] + out[t + 1, s])
        out[t, slots] = max(top, out[t + 1, slots])


@njit(cache=True, borrows=True, nogil=True)
def follow(benefit, price, cost, idle_is_free, to_go, start, path):
    """A best path as slots (their number: elsewhere), from slot `start` (-1: nothing held, the first is free)."""
    slots, steps = benefit.shape
    at = start
    for t in range(steps):
        best, where = -np.inf, slots
        if at >= 0:  # staying first: of equal moves none is better than none
            best = to_go[t + 1, at]
            if at < slots:
                best += benefit[at, t] - price[at, t]
            where = at
        for s in range(slots + 1):
            if s == at:
                continue
            arrive = to_go[t + 1, s]
            if s < slots:
                arrive += benefit[s, t] - price[s, t]
            if at >= 0 and (not idle_is_free or (s < slots and benefit[s, t] > 0.0)):
                arrive -= cost
            if arrive > best and (best == -np.inf or arrive - best > 1e-12 * abs(best)):
                best, where = arrive, s
        path[t] = where
        at = where


class Near(NamedTuple):
    """Agents within a few hops: those of agent i are ``agents[ptr[i]:ptr[i + 1]]``, ``hops`` their distance; int64."""

    ptr: IntArray
    agents: IntArray
    hops: IntArray


class Places(NamedTuple):
    """Slots of the agents, as from `find_slots`.

    Attributes
    ----------
    ptr : (n + 1,) int64
    task : (slots,) int32
    benefit : (slots, steps) float64
    place : (n, m) int32
        Slot of a task, -1 for none.
    """

    ptr: IntArray
    task: NDArray[np.int32]
    benefit: FloatArray
    place: NDArray[np.int32]


class Rounds(NamedTuple):
    """Price rounds: their number, the first price step and its decay, and the hops that a plan is passed on."""

    number: int
    step: float
    decay: float
    hops: int


@njit(cache=True, nogil=True)
def iterate(near, slots, held, cost, idle_is_free, price, price_mean, rounds):
    """Play the price rounds: every agent plans its path at its own prices, hears plans, and moves its prices.

        price[s, t] = max(0, price[s, t] + step / (1 + decay r) * (agents heard to want the task at t - 1))

    A plan is heard as many rounds late as it has hops to go. `price` is changed in place; `price_mean` becomes its mean
    over the second half of the rounds. Returns bool (rounds, n): who sent a new plan in each round.
    """
    slot_ptr, slot_task, benefit, place = slots
    iterations, step, decay, hops = rounds
    n = len(slot_ptr) - 1
    steps = benefit.shape[1]
    plans = np.full((hops + 1, n, steps), -1, np.int32)  # tasks, -1 elsewhere; ring over rounds
    sent = np.zeros((iterations, n), np.bool_)
    widest = 0
    for i in range(n):
        widest = max(widest, slot_ptr[i + 1] - slot_ptr[i])
    averaged = iterations - iterations // 2
    for r in range(iterations):
        now = r % (hops + 1)
        size = step / (1.0 + decay * r)
        for i in range(n):
            a, b = slot_ptr[i], slot_ptr[i + 1]
            to_go = np.empty((steps + 1, widest + 1))
            path = np.empty(steps, np.int64)
            value_to_go(benefit[a:b], price[a:b], cost, idle_is_free, np.int64(0), to_go)
            start = np.int64(-1)
            if held[i] >= 0:
                start = place[i, held[i]] - a
            follow(benefit[a:b], price[a:b], cost, idle_is_free, to_go, start, path)
            before = (r - 1) % (hops + 1)
            for t in range(steps):
                task = slot_task[a + path[t]] if path[t] < b - a else -1
                plans[now, i, t] = task
                if r == 0 or plans[before, i, t] != task:
                    sent[r, i] = True
        for i in range(n):
            a, b = slot_ptr[i], slot_ptr[i + 1]
            excess = np.full((b - a, steps), -1.0)
            for q in range(near.ptr[i], near.ptr[i + 1]):
                late = near.hops[q]
                if late > r:
                    continue
                for t in range(steps):
                    task = plans[(r - late) % (hops + 1), near.agents[q], t]
                    if task >= 0 and place[i, task] >= 0:
                        excess[place[i, task] - a, t] += 1.0
            for s in range(a, b):
                for t in range(steps):
                    price[s, t] = max(0.0, price[s, t] + size * excess[s - a, t])
                    if r >= iterations - averaged:
                        price_mean[s, t] += price[s, t] / averaged
    return sent


@njit(cache=True, nogil=True)
def first_gains(slot_ptr, slot_task, benefit, price, held, cost, idle_is_free):
    """Gain of every slot at the first step over waiting elsewhere, the later steps at their prices.

    Returns tasks (slots,) and gains (slots,), rows of the same offsets as the slots, sorted by decreasing gain.
    """
    n = len(slot_ptr) - 1
    steps = benefit.shape[1]
    tasks, gains = slot_task.copy(), np.empty(len(slot_task))
    for i in range(n):
        a, b = slot_ptr[i], slot_ptr[i + 1]
        to_go = np.empty((steps + 1, b - a + 1))
        value_to_go(benefit[a:b], price[a:b], cost, idle_is_free, np.int64(1), to_go)
        wait = to_go[1, b - a]
        if held[i] >= 0 and not idle_is_free:
            wait -= cost
        for s in range(a, b):
            gain = benefit[s, 0] + to_go[1, s - a] - wait
            if held[i] >= 0 and slot_task[s] != held[i] and (not idle_is_free or benefit[s, 0] > 0.0):
                gain -= cost
            q = s
            while q > a and gains[q - 1] < gain:
                gains[q] = gains[q - 1]
                tasks[q] = tasks[q - 1]
                q -= 1
            gains[q] = gain
            tasks[q] = slot_task[s]
    return tasks, gains


@njit(cache=True, borrows=True, nogil=True)
def carry_prices(
    link_start, links, old_price, old_place, shift, slot_ptr, slot_task, price
):  # fmt: skip
    """Prices of the new window: an agent's own, or for a task new to it the mean of the neighbours that have one."""
    n = len(slot_ptr) - 1
    steps = price.shape[1]
    width = old_price.shape[1]
    for i in range(n):
        for s in range(slot_ptr[i], slot_ptr[i + 1]):
            j = slot_task[s]
            mine = old_place[i, j]
            for t in range(steps):
                if t + shift >= width:
                    continue
                if mine >= 0:
                    price[s, t] = old_price[mine, t + shift]
                    continue
                total, count = 0.0, 0
                for e in range(link_start[i], link_start[i + 1]):
                    theirs = old_place[links[e], j]
                    if theirs >= 0:
                        total += old_price[theirs, t + shift]
                        count += 1
                if count:
                    price[s, t] = total / count
