"""Compiled search for instances on which Algorithm 2 does badly: integers only, every assignment enumerated.

An instance is an integer array (T, n, m) with the cost of a move; a state is the number of the last assignment.
Adding a constant to all benefits changes neither the decisions nor the loss D = optimum - HAAL, only c: the theorem
is violated at some c exactly where D > T |H| and c is large enough. So the search maximises D.
"""

# ruff: noqa: NPY002 - compiled code has numpy's old generator only
from __future__ import annotations

from itertools import permutations

import numpy as np
from numba import njit


def assignments(n: int, m: int) -> np.ndarray:
    """All assignments, shape (count, n)."""
    return np.array(list(permutations(range(m), n)), dtype=np.int64)


def moves(rows: np.ndarray, cost: int) -> np.ndarray:
    """Handover between all pairs of assignments, shape (count, count)."""
    return -cost * (rows[:, None] != rows[None]).sum(axis=2)


@njit(cache=True)
def static(benefits, rows):
    """Running sums over the steps of the benefit of every assignment, shape (T + 1, count)."""
    T, n, _ = benefits.shape
    out = np.zeros((T + 1, len(rows)), np.int64)
    for k in range(T):
        for x in range(len(rows)):
            total = 0
            for i in range(n):
                total += benefits[k, i, rows[x, i]]
            out[k + 1, x] = out[k, x] + total
    return out


@njit(cache=True)
def optimum(sums, eta, start):
    """Greatest value of any plan from assignment `start` (-1: the first step is free)."""
    T = len(sums) - 1
    count = sums.shape[1]
    value = np.zeros(count, np.int64)
    for x in range(count):
        value[x] = sums[1, x] + (eta[start, x] if start >= 0 else 0)
    for k in range(1, T):
        new = np.empty(count, np.int64)
        for x in range(count):
            best = value[0] + eta[0, x]
            for s in range(1, count):
                best = max(best, value[s] + eta[s, x])
            new[x] = best + sums[k + 1, x] - sums[k, x]
        value = new
    return value.max()


@njit(cache=True)
def _interval(sums, eta, a, b, s):
    """Best assignment held over a..b-1 from s, the first of equal ones, and its value."""
    best, arg = np.int64(-(2**62)), 0
    for x in range(sums.shape[1]):
        v = sums[b, x] - sums[a, x] + (eta[s, x] if s >= 0 else 0)
        if v > best:
            best, arg = v, x
    return best, arg


@njit(cache=True)
def _best(sums, eta, k, stop, s, known, first, rest):
    """Value of the best sequence over k..stop-1 from s; fills first and the length of its first interval."""
    if k == stop:
        return np.int64(0)
    if known[k, s] != -(2**62):
        return known[k, s]
    top = np.int64(-(2**62))
    for cut in range(k + 1, stop + 1):
        v, x = _interval(sums, eta, k, cut, s)
        v += _best(sums, eta, cut, stop, x, known, first, rest)
        if v > top:
            top = v
            first[k, s] = x
            rest[k, s] = cut
    known[k, s] = top
    return top


@njit(cache=True)
def haal(sums, eta, start, lookahead, keep_plan):
    """Value of Algorithm 2, or of HAAL+ with `keep_plan`; the first of equal choices is taken throughout."""
    T = len(sums) - 1
    count = sums.shape[1]
    s = start
    total = np.int64(0)
    known = np.empty((T + 1, count + 1), np.int64)
    first = np.zeros((T + 1, count + 1), np.int64)
    rest = np.zeros((T + 1, count + 1), np.int64)
    kept = np.full(T + 1, -1, np.int64)
    fresh = np.empty(T + 1, np.int64)
    for k in range(T):
        stop = min(k + lookahead, T)
        known[:] = -(2**62)  # s = -1 (nothing held yet) uses the last column
        new = _best(sums, eta, k, stop, s, known, first, rest)
        a, inner = k, s
        while a < stop:
            x, b = first[a, inner], rest[a, inner]
            for q in range(a, b):
                fresh[q] = x
            a, inner = b, x
        if keep_plan and k > 0:
            if kept[stop - 1] < 0:
                before = kept[stop - 2] if stop - 2 >= k else s
                kept[stop - 1] = _interval(sums, eta, stop - 1, stop, before)[1]
            old, inner = np.int64(0), s
            for q in range(k, stop):
                old += sums[q + 1, kept[q]] - sums[q, kept[q]] + eta[inner, kept[q]]
                inner = kept[q]
            if old <= new:
                kept[k:stop] = fresh[k:stop]
        else:
            kept[k:stop] = fresh[k:stop]
        x = kept[k]
        total += sums[k + 1, x] - sums[k, x] + (eta[s, x] if s >= 0 else 0)
        s = x
    return total


@njit(cache=True)
def loss(benefits, rows, eta, start, lookahead, keep_plan):
    """Optimum less Algorithm 2."""
    sums = static(benefits, rows)
    return optimum(sums, eta, start) - haal(sums, eta, start, lookahead, keep_plan)


@njit(cache=True)
def anneal(benefits, rows, eta, start, lookahead, keep_plan, palette, cost, rounds, seed):
    """Simulated annealing over the entries; returns the worst instance found (a copy) and its loss."""
    np.random.seed(seed)
    T, n, m = benefits.shape
    here = benefits.copy()
    now = loss(here, rows, eta, start, lookahead, keep_plan)
    best, worst = now, here.copy()
    for r in range(rounds):
        heat = 0.6 * cost * (1.0 - r / rounds) + 1e-9
        changes = 1 + np.random.randint(3)
        saved = np.empty((3, 4), np.int64)
        for c in range(changes):
            k, i, j = np.random.randint(T), np.random.randint(n), np.random.randint(m)
            saved[c, 0], saved[c, 1], saved[c, 2], saved[c, 3] = k, i, j, here[k, i, j]
            kind = np.random.randint(4)
            if kind == 0:
                here[k, i, j] = palette[np.random.randint(len(palette))]
            elif kind == 1:
                here[k, i, j] = max(0, here[k, i, j] + np.random.randint(-2, 3))
            elif kind == 2:
                here[k, i, j] = max(0, here[k, i, j] + cost * np.random.randint(-1, 2))
            else:
                here[k, i, j] = here[np.random.randint(T), np.random.randint(n), np.random.randint(m)]
        then = loss(here, rows, eta, start, lookahead, keep_plan)
        if then >= now or np.random.random() < np.exp((then - now) / heat):
            now = then
            if now > best:
                best, worst = now, here.copy()
        else:
            for c in range(changes - 1, -1, -1):
                here[saved[c, 0], saved[c, 1], saved[c, 2]] = saved[c, 3]
    return worst, best
