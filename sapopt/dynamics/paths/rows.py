"""What the compiled recursions of several dynamics share: the layout of the benefits, and the cheapest tasks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray


class Smoothing(NamedTuple):
    """Prices under log-sum-exp smoothing.

    Attributes
    ----------
    temperature : float
        eps > 0.
    move : float
        ``exp(-cost / eps)``, the weight of paying for a move.
    prices : (T, m) float64
        Finite.
    weight : (T, m) float64
        ``exp(-prices / eps)``, the weight of holding a task for a step.
    """

    temperature: float
    move: float
    prices: FloatArray
    weight: FloatArray


class Cheapest(NamedTuple):
    """Tasks by price, for agents that may idle on any task that they have no benefit for.

    Attributes
    ----------
    tasks : (T, count) int32
        The cheapest tasks of every step, in order.
    rest : (T,) float64
        Sum of the weights of all other tasks.
    rank : (T, m) int32
        Place of every task in the order of its step.
    """

    tasks: NDArray[np.int32]
    rest: FloatArray
    rank: NDArray[np.int32]


def cheapest_tasks(prices: FloatArray, count: int) -> NDArray[np.int32]:
    """The `count` cheapest tasks of every step (T, count), in order of price, equal ones by their number."""
    return np.argsort(prices, axis=1, kind="stable")[:, :count].astype(np.int32)


def cheapest_and_rest(prices: FloatArray, weight: FloatArray, count: int) -> Cheapest:
    """The `count` cheapest tasks of every step, and the sum of `weight` (T, m) over the others, summed by itself.

    The weight of what an agent does *not* have a benefit for is a small difference of large sums where its own tasks
    are the cheap ones; adding up the cheapest one by one keeps the digits.
    """
    order = np.argsort(prices, axis=1, kind="stable").astype(np.int32)
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, np.arange(order.shape[1], dtype=np.int32)[None, :], axis=1)
    rest = np.take_along_axis(weight, order[:, count:], axis=1).sum(axis=1)
    return Cheapest(np.ascontiguousarray(order[:, :count]), rest, rank)


def widest_row(indptr: IntArray) -> int:
    """Most entries of one agent at one step."""
    return int(np.diff(indptr).max(initial=0))


def most_entries(indptr: IntArray, n: int) -> int:
    """Most entries of one agent over all steps, at least 1."""
    return int(np.diff(indptr).reshape(-1, n).sum(axis=0).max(initial=1)) if n else 1
