"""States that are equal, and states that only look it."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest

from sapopt.data.frozen import frozen


@dataclass(frozen=True, eq=False)
class Charged:
    """Arrays in a dataclass that compares by identity, as `BatteryState`."""

    held: Any
    level: Any


class Pair(NamedTuple):
    """A tuple with names."""

    a: int
    b: int


class Free:
    """Any object, equal to itself alone."""


@pytest.mark.parametrize(
    "make",
    [
        lambda: np.arange(3), lambda: [1, [2, 3]], lambda: {"a": np.ones(2)}, lambda: {1, 2}, lambda: Pair(1, 2),
        lambda: Charged(np.arange(2), [0.5]), lambda: None, lambda: "text", lambda: np.array([[1], "a"], dtype=object),
    ],
)  # fmt: skip
def test_equal_contents_are_equal(make: Any) -> None:
    """Two values of equal contents are one state, and can be looked up."""
    assert frozen(make()) == frozen(make())
    assert {frozen(make()): 1}[frozen(make())] == 1


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (np.arange(3), np.arange(3.0)), (np.zeros(2), np.zeros((2, 1))), ([1], (1,)), (Pair(1, 2), (1, 2)),
        (Charged(np.arange(2), 1), Charged(np.arange(2), 2)), ({"a": 1}, {"a": 2}), (Free(), Free()),
        (np.ma.masked_array([1, 2], [True, False]), np.ma.masked_array([1, 2], [False, False])),
    ],
)  # fmt: skip
def test_different_contents_differ(one: Any, other: Any) -> None:
    """Nothing is taken for what it is not."""
    assert frozen(one) != frozen(other)
    assert frozen(one) == frozen(one)


def test_attributes_beyond_the_fields_count() -> None:
    """A dataclass with something more in it is equal to itself alone."""

    @dataclass(eq=False)
    class Open:
        a: int

    one, other = Open(1), Open(1)
    assert frozen(one) == frozen(other)
    one.more = 2  # type: ignore[attr-defined]
    assert frozen(one) != frozen(other)
