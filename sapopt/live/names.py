"""Ids of agents and tasks that come and go, and the order in which they are counted inside.

Whoever came first comes first, so an order that changes from call to call changes no decision. Users see ids alone.
"""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sapopt.data.types import IntArray

Name = str | int
"""An id: a text or a whole number."""


@dataclass(frozen=True, eq=False)
class Roster:
    """The ids of one call.

    Attributes
    ----------
    names : tuple of str or int
        In the order in which they came.
    """

    names: tuple[Name, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def index(self) -> dict[Name, int]:
        """Place of every id."""
        return {name: place for place, name in enumerate(self.names)}

    def updated(self, given: tuple[Name, ...]) -> Roster:
        """Who is still there, in the old order, then who is new, in the order given."""
        now = set(given)
        if len(self.names) == len(now) and now == self.index.keys():
            return self
        stayed = [name for name in self.names if name in now]
        return Roster((*stayed, *(name for name in given if name not in self.index)))

    def places(self, other: Roster) -> IntArray:
        """Place of each of these ids in another roster, -1 for none."""
        if other is self:
            return np.arange(len(self.names))
        index = other.index
        return np.array([index.get(name, -1) for name in self.names], dtype=np.int64)


def checked_names(values: Any, count: int, what: str) -> tuple[Name, ...]:
    """The ids of a call.

    Parameters
    ----------
    values : sequence of str or int, or None
        None: numbers from 0 on.
    count : int
        How many there have to be.
    what : str
        The argument to blame: "agents" or "tasks".

    Raises
    ------
    ValueError
        If they are too few or too many, of another kind, or one of them is there twice.
    """
    if values is None:
        return tuple(range(count))
    if isinstance(values, (str, bytes)) or not isinstance(values, (Sequence, np.ndarray)):
        raise ValueError(f"{what} must be a list of ids, got {type(values).__name__}")
    names = tuple(values.tolist() if isinstance(values, np.ndarray) else values)
    if len(names) != count:
        raise ValueError(f"{what}: {len(names)} ids, but the benefits have {count} {what}")
    if not all(type(name) is str or type(name) is int for name in names):
        names = tuple(checked_name(name, what) for name in names)
    if len(set(names)) < count:
        seen: set[Name] = set()
        for name in names:
            if name in seen:
                raise ValueError(f"{what}: the id {name!r} is there twice")
            seen.add(name)
    return names


def checked_name(name: Any, what: str) -> Name:
    """One id, or a ValueError if it is neither a text nor a whole number."""
    if isinstance(name, str):
        return str(name)
    if isinstance(name, numbers.Integral) and not isinstance(name, (bool, np.bool_)):
        return int(name)
    raise ValueError(f"{what}: ids are texts or whole numbers, got {name!r}")
