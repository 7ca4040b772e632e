"""Greedy choices where tasks hold several agents, agents may hold nothing, and limits stand in the way.

The choices are made by capacities alone, agent by agent; then as many of them as the limits allow are kept.
"""

from __future__ import annotations

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.matrices import GainMatrix, Matrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.running.outlook import Outlook

_WAITS = 0.1
"""Worth of waiting on the task held before, where a choice is worth 1."""


def greedily_held(outlook: Outlook, held: IntArray | None) -> IntArray:
    """Keep what is in view; the others choose the best free task in ascending index."""
    benefit = dense_step(outlook.benefits(1).step(0))
    n, room = len(benefit), _room(outlook)
    chosen = np.full(n, -1)
    if held is not None:
        for i in np.flatnonzero((benefit[np.arange(n), held] > 0) & (held >= 0)):
            if room[held[i]] > 0:
                chosen[i] = held[i]
                room[held[i]] -= 1
    for i in np.flatnonzero(chosen < 0):
        _take(benefit[i], 0.0, int(i), chosen, room)
    return kept_choices(outlook, chosen, np.where(chosen >= 0, benefit[np.arange(n), chosen], 0.0), held)


def greedily_chosen(outlook: Outlook, matrix: Matrix) -> IntArray:
    """Choose in ascending index by beta_hat, whatever is worth more than holding nothing."""
    hat = matrix.toarray() if isinstance(matrix, GainMatrix) else matrix
    room = _room(outlook)
    chosen = np.full(len(hat), -1)
    for i, row in enumerate(hat):
        _take(row, -np.inf, i, chosen, room)
    return kept_choices(outlook, chosen, hat[np.arange(len(hat)), chosen], None)


def kept_choices(outlook: Outlook, chosen: IntArray, worth: FloatArray, held: IntArray | None) -> IntArray:
    """The assignment within capacities and limits that keeps as many choices as possible.

    Parameters
    ----------
    outlook : Outlook
        Of a problem with limits or capacities.
    chosen : ndarray of int64, shape (n,)
        Task that every agent chose, -1 for none.
    worth : ndarray, shape (n,)
        What the choices are worth; of two that cannot both be kept, the dearer one is.
    held : ndarray of int64, shape (n,), or None
        Task that every agent waits on if it chose none.
    """
    kept = _worth(outlook, chosen, worth)
    if held is not None:
        waits = np.flatnonzero((chosen < 0) & (held >= 0))
        kept[waits, held[waits]] += _WAITS
    # A choice counts as much as the dearest one, to be weighed against what limits cost.
    return outlook.assign(kept * (float(worth[chosen >= 0].max(initial=0.0)) or 1.0))


def _room(outlook: Outlook) -> IntArray:
    capacity = outlook.problem.capacity
    assert capacity is not None
    return capacity[outlook.k].copy()


def _take(row: FloatArray, more_than: float, i: int, chosen: IntArray, room: IntArray) -> None:
    values = np.where(room > 0, row, -np.inf)
    best = int(np.argmax(values))
    if values[best] > more_than:
        chosen[i] = best
        room[best] -= 1


def _worth(outlook: Outlook, chosen: IntArray, worth: FloatArray) -> FloatArray:
    """A matrix (n, m) under which the best assignment keeps as many choices as possible, the dearest ones first."""
    hat = outlook.beta_hat()
    allowed = np.isfinite(hat.toarray() if isinstance(hat, GainMatrix) else hat)
    kept = np.where(allowed, 0.0, -np.inf)
    picked = np.flatnonzero(chosen >= 0)
    picked = picked[allowed[picked, chosen[picked]]]
    kept[picked, chosen[picked]] = 1.0 + dearest_first(worth[picked])
    return kept


def dearest_first(worth: FloatArray) -> FloatArray:
    """Numbers in the order of what choices are worth, 0 for what is worth nothing; all together less than 1."""
    size = np.maximum(worth, 0.0)
    most = float(size.max(initial=0.0))
    return size / most / (2.0 * len(size)) if most > 0 else size
