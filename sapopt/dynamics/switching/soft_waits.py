"""Waiting under the strict rule, smoothed: what it weighs over intervals of steps, and which tasks the waiting hold.

Agents that wait on tasks out of their sight are all alike, so what they weigh is summed up once for all of them, by
interval a .. b - 1, and who waits over an interval is spread over the tasks once for all. Where weights would leave
the range of floats, logarithms take their place.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray
from sapopt.dynamics.paths.rows import Smoothing
from sapopt.kernels.blocks import in_blocks, work_array
from sapopt.kernels.jit import njit

_FAST = {"nnan", "nsz", "reassoc", "contract"}

# Shares below exp(_TINY) are left out.
_TINY = -30.0

LEAST = 1e-140
"""Least weight with which `SoftWaiting.linear` is safe: over the least weight of a move it stays within floats."""

# What is set to zero in time, before it becomes a number that processors are slow with.
_NOTHING = 1e-200

_NOBODY = 1e-6
"""Expected number of waiting agents that is not worth spreading over the tasks."""


class SoftWaiting(NamedTuple):
    """What waiting weighs, the same for all agents.

    Attributes
    ----------
    shared : bool
        Whether there are tasks to wait on; else every task is a slot and the arrays have size 1.
    linear : bool
        Whether the table holds weights, relative to `best`; else, as these would leave the range of floats, logarithms
        of weights.
    best : (T,) float64
        Greatest weight of one task that may be waited on.
    table : (T, T + 1) float64
        At [a, b] the sum over these tasks of the product of their weights over the steps a .. b - 1, each divided by
        `best` where `linear`.
    by_end : (T + 1, T) float64
        The same at [b, a].
    """

    shared: bool
    linear: bool
    best: FloatArray
    table: FloatArray
    by_end: FloatArray


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def soft_waiting(begin, end, weight, best, excluded, table, lowest, held):
    """Fill the rows of a block of `table` (T, T + 1) as `SoftWaiting.linear`, and the least of each in `lowest` (T,).

    `held` (m,) is scratch.
    """
    T, m = weight.shape
    for a in range(begin, end):
        for j in range(m):
            held[j] = 0.0 if excluded[j] else 1.0
        lowest[a] = np.inf
        for b in range(a + 1, T + 1):
            row = weight[b - 1]
            inverse = 1.0 / best[b - 1]
            total = 0.0
            for j in range(m):
                v = held[j] * (row[j] * inverse)
                if v < _NOTHING:
                    v = 0.0
                held[j] = v
                total += v
            table[a, b] = total
            lowest[a] = min(lowest[a], total)


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def soft_waiting_logs(begin, end, weight, excluded, table, held):
    """Fill the rows of a block of `table` (T, T + 1) with logarithms; it holds a number close to -inf on entry.

    `held` (m,) is scratch.
    """
    T, m = weight.shape
    for a in range(begin, end):
        for j in range(m):
            held[j] = 0.0 if excluded[j] else 1.0
        level = 0.0
        factor = 1.0
        for b in range(a + 1, T + 1):
            row = weight[b - 1]
            total = 0.0
            for j in range(m):
                v = held[j] * row[j] * factor
                held[j] = v
                total += v
            if not total > 0.0:
                break
            table[a, b] = level + np.log(total)
            factor = 1.0
            if total < 1e-100:  # rescale before anything that matters underflows
                factor = 1.0 / total
                level += np.log(total)


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def spread_waiting(begin, end, weight, waiting, excluded, mass, usage, ratio, product, onward, crowd):
    """Add to the columns of a block of tasks of `usage` (T, m) who waits, spread over the tasks by their weight.

    Of the agents that wait over the steps a .. b - 1, task j gets the share ``ratio_a[j] ... ratio_{b-1}[j] / table``.
    Those that began at a and are on task j at step k are, by one recursion forward and one backward,

        product_k[j] = product_{k-1}[j] ratio_k[j]
        onward_k[j]  = crowd[k + 1] + ratio_{k+1}[j] onward_{k+1}[j]
        usage_k[j]  += product_k[j] onward_k[j]

    Parameters
    ----------
    weight : (T, m) float64
    waiting : SoftWaiting
        With weights, not with logarithms.
    excluded : (m,) bool
    mass : (T, T + 1) float64
        Expected number of agents that wait over the steps a .. b - 1, at [a, b]; next to nobody is left out.
    ratio : (T, m) float64
        Scratch: weights of the tasks that may be waited on, each divided by the best of its step; 0 for the others.
    product, onward : (T, m) and (m,) float64
        Scratch.
    crowd : (T + 1,) float64
        Scratch: the numbers of one a, divided by the table.
    """
    T = weight.shape[0]
    # Counting from 0 on, the compiler sees that no index is negative, and takes several tasks at a time.
    count = end - begin
    is_out, onward_k = excluded[begin:end], onward[begin:end]
    for k in range(T):
        best = waiting.best[k]
        weight_k, ratio_k = weight[k, begin:end], ratio[k, begin:end]
        for j in range(count):
            ratio_k[j] = 0.0 if is_out[j] else weight_k[j] / best
    for a in range(T):
        last = a
        for b in range(a + 1, T + 1):
            crowd[b] = 0.0
            if mass[a, b] > _NOBODY:
                crowd[b] = mass[a, b] / waiting.table[a, b]
                last = b
        for j in range(count):
            onward_k[j] = 1.0
        for k in range(a, last):
            ratio_k, product_k = ratio[k, begin:end], product[k, begin:end]
            for j in range(count):
                v = onward_k[j] * ratio_k[j]
                v = v if v > _NOTHING else 0.0
                onward_k[j] = v
                product_k[j] = v
        for j in range(count):
            onward_k[j] = 0.0
        for k in range(last - 1, a - 1, -1):
            leaving = crowd[k + 1]
            ratio_k, product_k, usage_k = ratio[k, begin:end], product[k, begin:end], usage[k, begin:end]
            for j in range(count):
                v = onward_k[j] + leaving
                usage_k[j] += product_k[j] * v
                onward_k[j] = v * ratio_k[j]


@njit(cache=True, borrows=True, nogil=True, fastmath=_FAST)
def spread_waiting_logs(begin, end, smoothing, excluded, table, mass, usage, held):
    """The same from logarithms of weights, with the expected numbers `mass` (T, T + 1) and scratch `held` (T + 1,)."""
    eps, prices = smoothing.temperature, smoothing.prices
    least = np.exp(_TINY)
    T = prices.shape[0]
    for j in range(begin, end):
        if excluded[j]:
            continue
        for a in range(T):
            price = 0.0
            last = T
            while last > a and not mass[a, last] > _NOBODY:
                last -= 1
            for b in range(a + 1, last + 1):
                held[b] = 0.0
                price += prices[b - 1, j]
                if mass[a, b] > _NOBODY:
                    share = np.exp(-price / eps - table[a, b])
                    if share > least:
                        held[b] = share * mass[a, b]
            # Whoever leaves at b was there at every step since a.
            total = 0.0
            for k in range(last - 1, a - 1, -1):
                total += held[k + 1]
                usage[k, j] += total


def waits(smoothing: Smoothing, best: FloatArray, excluded: NDArray[np.bool_]) -> SoftWaiting:
    """What waiting weighs under some prices; `best` (T,) is the greatest weight of a task that is not excluded."""
    T, m = smoothing.weight.shape
    table, linear = np.zeros((T, T + 1)), False
    if best.min() > LEAST:
        lowest = np.empty(T)
        in_blocks(
            soft_waiting, T, smoothing.weight, best, excluded, table, lowest,
            scratch=lambda: (work_array(m),), turns=0.1 * T * T * m,
        )  # fmt: skip
        linear = bool(lowest.min() > LEAST)
    if not linear:
        table.fill(-1e300)
        in_blocks(
            soft_waiting_logs, T, smoothing.weight, excluded, table,
            scratch=lambda: (work_array(m),), turns=0.5 * T * T * m,
        )  # fmt: skip
    return SoftWaiting(True, linear, best, table, np.ascontiguousarray(table.T))


def spread(
    smoothing: Smoothing,
    waiting: SoftWaiting,
    excluded: NDArray[np.bool_],
    mass: FloatArray,
    usage: FloatArray,
) -> None:
    """Add to `usage` (T, m) the agents that wait, from their numbers by interval, `mass` (T, T + 1)."""
    T, m = usage.shape
    if waiting.linear:
        in_blocks(
            spread_waiting, m, smoothing.weight, waiting, excluded, mass, usage,
            scratch=lambda: (work_array((T, m)), work_array((T, m)), work_array(m), work_array(T + 1)),
            turns=0.3 * T * T * m,
        )  # fmt: skip
    else:
        in_blocks(
            spread_waiting_logs, m, smoothing, excluded, waiting.table, mass, usage,
            scratch=lambda: (work_array(T + 1),), turns=2.0 * T * T * m,
        )  # fmt: skip
