"""Proven upper bounds."""

from __future__ import annotations

from dataclasses import dataclass, field

from sapopt.types import FloatArray


@dataclass(frozen=True, eq=False)
class Bound:
    """A proven upper bound of the optimal value of a problem.

    Attributes
    ----------
    value : float
        No plan is worth more.
    prices : ndarray, shape (T, m), or None
        Task prices mu >= 0 that prove it; None for a bound that needs none.
    method : str
        How it was proven.
    """

    value: float
    prices: FloatArray | None = field(default=None, repr=False)
    method: str = ""
