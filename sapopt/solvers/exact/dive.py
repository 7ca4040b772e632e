"""Dives: plans from a relaxation by making up one's mind on one stay after the other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sapopt.data.types import IntArray
from sapopt.formulations.stays import Stays
from sapopt.solvers.exact.master import Master

_SURE = 0.9
"""Share from which stays are settled together."""


def dive(
    master: Master,
    closed: np.ndarray,
    floor: Callable[[], float],
    rng: np.random.Generator,
    noise: float = 0.0,
    stop: Callable[[], bool] = lambda: False,
) -> IntArray | None:
    """Settle the stays of greatest share, solve what is left, and so on until they make up a plan.

    Parameters
    ----------
    master : Master
    closed : ndarray of bool
        Stays that are closed from the start.
    floor : callable
        ``floor() -> value``: a dive that cannot get above is broken off.
    rng : Generator
    noise : float
        Spread of the noise on the shares; 0 for a dive by the shares alone.
    stop : callable
        Asked before every step.

    Returns
    -------
    ndarray of int64, shape (T, n), or None
    """
    stays = master.stays
    closed = closed.copy()
    settled: set[int] = set()
    while not stop():
        relaxed = master.solve(closed, floor())
        if relaxed.bound <= floor() or not relaxed.complete:
            return None
        if relaxed.whole:
            return stays.plan_of(relaxed.stays[relaxed.x > 0.5])
        open_ones = [
            (share + noise * rng.standard_normal(), share, int(c))
            for c, share in zip(relaxed.stays, relaxed.x, strict=True)
            if share > 1e-4 and int(c) not in settled
        ]
        if not open_ones:
            return None
        top = max(open_ones)[2]
        for c in {top, *(c for _, share, c in open_ones if share > _SURE)}:
            closed |= _rivals(stays, c)
            settled.add(c)
    return None


def _rivals(stays: Stays, c: int) -> np.ndarray:
    """Stays that fill a row of this one, itself left out."""
    overlap = (stays.first < stays.stop[c]) & (stays.stop > stays.first[c])
    mask: np.ndarray = overlap & ((stays.agent == stays.agent[c]) | (stays.task == stays.task[c]))
    mask[c] = False
    return mask
