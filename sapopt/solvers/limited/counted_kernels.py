"""Compiled sweeps of paths with at most so many take-ups: agents one after another take the best one that is free."""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit

_FAST = {"nnan", "nsz"}  # infinities only meet with equal sign, as in `sapopt.dynamics.switching.hard`


class CountedScratch(NamedTuple):
    """Work arrays of `counted_sweep`, for at most H take-ups.

    Attributes
    ----------
    value : (H + 1, m) float64
        Of the best way that ends on a task with at most so many take-ups.
    best : (T, H + 1) int64
        The task on which the best way of so many take-ups ends before a step.
    moved : (T, H + 1, m) bool
        Whether the agent took the task up at that step.
    """

    value: FloatArray
    best: IntArray
    moved: np.ndarray


def counted_scratch(T: int, most: int, m: int) -> CountedScratch:
    """Work arrays for at most `most` take-ups."""
    return CountedScratch(
        np.empty((most + 1, m)), np.empty((T, most + 1), dtype=np.int64), np.empty((T, most + 1, m), dtype=np.bool_)
    )  # fmt: skip


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def counted_sweep(order, window, most, closed, prices, plan, scratch):
    """Let the agents of `order` give up their cells, one by one, and take their best path of at most `most` take-ups.

    With h the take-ups there may be so far, for the tasks j that are free (a price of +inf in `closed` closes one):

        value_k[h, j] = max(value_{k-1}[h, j], max_a value_{k-1}[h - 1, a] - cost) + benefit_k[j] - price_k[j]

    Where an agent may take up a task at every step, one layer does, which is entered from itself.

    Parameters
    ----------
    window : Window
        See `sapopt.dynamics.switching.layout`.
    most : (n,) int64
    closed, prices : (T, m) float64
        Prices with +inf where a cell is held, kept so; prices of free cells.
    plan : (T, n) int64
        Changed in place. An agent that finds no path keeps its own.
    """
    n, indptr, indices, data, cost = window.n, window.indptr, window.indices, window.data, window.cost
    value, best, moved = scratch.value, scratch.best, scratch.moved
    T, m = prices.shape
    for i in order:
        held = window.held[i]
        layers, down = most[i] + 1, 1
        if most[i] >= T:
            layers, down = most[i] - most[i] + 1, 0  # a layer, as a number of the same type
        for k in range(T):
            closed[k, plan[k, i]] = prices[k, plan[k, i]]
        for h in range(layers):
            first = 0.0
            if held >= 0:
                first = -cost if h >= down else -np.inf
            for j in range(m):
                value[h, j] = first - closed[0, j]
            if held >= 0:
                value[h, held] = -closed[0, held]
        for k in range(T):
            if k > 0:
                for h in range(layers):
                    top = -np.inf
                    for j in range(m):
                        top = max(top, value[h, j])
                    best[k, h] = 0
                    for j in range(m):
                        if value[h, j] == top:
                            best[k, h] = j
                            break
                for h in range(layers - 1, -1, -1):
                    enter = value[h - down, best[k, h - down]] - cost if h >= down else -np.inf
                    for j in range(m):
                        v = value[h, j]
                        moved[k, h, j] = enter > v
                        value[h, j] = max(v, enter) - closed[k, j]
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                for h in range(layers):
                    value[h, indices[e]] += data[e]
        h = layers - 1
        task = 0
        for j in range(m):
            if value[h, j] > value[h, task]:
                task = j
        if value[h, task] > -np.inf:
            for k in range(T - 1, -1, -1):
                plan[k, i] = task
                if k > 0 and moved[k, h, task]:
                    h -= down
                    task = best[k, h]
        for k in range(T):
            closed[k, plan[k, i]] = np.inf


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def priced_moves(begin, end, window, costs, prices, moves, value):
    """What the steps from k on are worth to the agents of a block if they begin with a move: fills `moves` (n, T + 1).

    Backward in time, where nothing follows the last step; `value` (m,) is scratch:

        future_k[j] = benefit_k[j] - price_k[j] + max(future_{k+1}[j], moves[k + 1])
        moves[k]    = max_j future_k[j] - cost
    """
    n, indptr, indices, data = window.n, window.indptr, window.indices, window.data
    T, m = prices.shape
    for i in range(begin, end):
        moves[i, T] = 0.0
        for j in range(m):
            value[j] = 0.0
        for k in range(T - 1, -1, -1):
            after = moves[i, k + 1]
            for j in range(m):
                value[j] = max(value[j], after) - prices[k, j]
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                value[indices[e]] += data[e]
            top = -np.inf
            for j in range(m):
                top = max(top, value[j])
            moves[i, k] = top - costs[i]


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def priced_firsts(begin, end, window, costs, k, held, prices, moves, out):
    """Value (n, m) of every agent's best way on from step k by its first task; the step's own prices do not count.

    `held` (n,) is the task before the step, -1 where a move is free; `moves` is that of `priced_moves`.
    """
    n, indptr, indices, data = window.n, window.indptr, window.indices, window.data
    T, m = prices.shape
    for i in range(begin, end):
        row = out[i]
        for j in range(m):
            row[j] = 0.0
        for t in range(T - 1, k - 1, -1):
            after = moves[i, t + 1]
            for j in range(m):
                row[j] = max(row[j], after)
            if t > k:
                for j in range(m):
                    row[j] -= prices[t, j]
            r = t * n + i
            for e in range(indptr[r], indptr[r + 1]):
                row[indices[e]] += data[e]
        if held[i] >= 0:
            stay = row[held[i]]
            for j in range(m):
                row[j] -= costs[i]
            row[held[i]] = stay
