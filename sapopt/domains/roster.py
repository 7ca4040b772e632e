"""Nurse rosters: who works on which ward on which day.

A ward takes one to three nurses a day and needs one at least. Nurses have preferences among the wards, asked for days
off, work at most so many days in a row, and share the work fairly: each works about as many days as the others. What
is not met is paid for: a ward without a nurse dearly, a day of work too many or too few by a nurse cheaply. So any
policy can be used, and a planner shows whether everything can be met.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.scenario import refuse_idle_rule

if TYPE_CHECKING:
    from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class Roster:
    """Nurses, wards, and what they want.

    Attributes
    ----------
    preference : ndarray, shape (nurses, wards)
        Worth of a day of a nurse on a ward, positive.
    day_off : ndarray of bool, shape (days, nurses)
        Days off that were asked for, and are granted.
    places : ndarray of int64, shape (wards,)
        Most nurses on a ward a day.
    least : int
        Nurses that every ward needs.
    in_a_row : int
        Most days of work on end.
    fair : (int, int)
        Least and most days that a nurse should work.
    short : float
        Cost of a nurse that a ward is short of, a day.
    unfair : float
        Cost of a day beyond `fair`.
    """

    preference: FloatArray
    day_off: np.ndarray
    places: IntArray
    least: int = 1
    in_a_row: int = 5
    fair: tuple[int, int] = (0, 28)
    short: float = 5.0
    unfair: float = 1.0

    def __post_init__(self) -> None:
        nurses, wards = self.preference.shape
        if not (self.preference > 0).all():
            raise ValueError(
                "preference must be positive; a nurse who may not work on a ward has a day off there"
            )
        if self.day_off.ndim != 2 or self.day_off.shape[1] != nurses or self.day_off.dtype != bool:
            raise ValueError(f"day_off must be a mask of shape (days, {nurses}), got {self.day_off.shape}")
        if self.places.shape != (wards,) or (self.places < self.least).any():
            raise ValueError(f"places must be whole numbers of at least {self.least} for {wards} wards")

    def problem(self, cost: Any = 0.1, *, idle_is_free: bool | None = None) -> SAP:
        """The sequential assignment problem: a step is a day, an agent a nurse, a task a ward.

        Parameters
        ----------
        cost : float
            Cost of beginning to work after a day off.
        idle_is_free : bool, optional
            Refused: a day off is free.
        """
        from sapopt.dynamics import AtMostInARow
        from sapopt.problem.limit import Limit
        from sapopt.problem.sap import SAP

        refuse_idle_rule(idle_is_free, "a day off is free")
        days, nurses = self.day_off.shape
        wards = len(self.places)
        benefits = np.broadcast_to(self.preference, (days, nurses, wards)).copy()
        benefits[self.day_off] = -np.inf
        limits = [Limit.cover(j, self.least, name=f"ward {j}", penalty=self.short) for j in range(wards)]
        limits.append(Limit.work(None, self.fair[1], self.fair[0], name="fair", penalty=self.unfair))
        return SAP(
            benefits, AtMostInARow(self.in_a_row, cost), idle=True, capacity=self.places, limits=limits,
            agents=[f"nurse {i}" for i in range(nurses)], tasks=[f"ward {j}" for j in range(wards)],
        )  # fmt: skip

    def short_of(self, plan: IntArray) -> int:
        """Nurses that wards are short of, over all days of a plan (T, n)."""
        wards = len(self.places)
        held = np.stack([np.bincount(row[row >= 0], minlength=wards) for row in plan])
        return int(np.maximum(self.least - held, 0).sum())


def random_roster(
    nurses: int = 20, wards: int = 15, days: int = 28, seed: int = 0, *, in_a_row: int = 5
) -> Roster:
    """A made-up roster: preferences between 0.5 and 1.5, every twelfth day off on request.

    Parameters
    ----------
    nurses, wards, days : int
    seed : int
    in_a_row : int
        Most days of work on end.

    Raises
    ------
    ValueError
        If a number is too small.
    """
    for name, value in (("nurses", nurses), ("wards", wards), ("days", days), ("in_a_row", in_a_row)):
        if int(value) != value or value < 1:
            raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")
    rng = np.random.default_rng(seed)
    preference = rng.uniform(0.5, 1.5, (nurses, wards)).round(2)
    day_off = rng.random((days, nurses)) < 1 / 12
    places = rng.integers(1, 4, wards)
    share = min(wards / nurses, in_a_row / (in_a_row + 1)) * days
    fair = (max(0, int(share) - 2), min(days, int(np.ceil(share)) + 1))
    return Roster(preference, day_off, places, in_a_row=int(in_a_row), fair=fair)
