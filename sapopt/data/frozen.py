"""A hashable stand-in for any value, so that equal states are found again."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable
from typing import Any

import numpy as np


class Itself:
    """Equal to nothing but the same object, which it keeps alive so that no other one takes its place in memory."""

    def __init__(self, value: Any) -> None:
        self._value = value

    def __hash__(self) -> int:
        return id(self._value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Itself) and self._value is other._value


def frozen(value: Any) -> Hashable:
    """What makes two values equal: their contents where these are plain, the object itself elsewhere.

    Arrays, lists, tuples, sets, dictionaries and dataclasses are equal if their types and parts are; an object that can
    be hashed speaks for itself; any other one is equal to itself alone, so that nothing is taken for what it is not.
    """
    if type(value) is np.ndarray:
        if value.dtype.hasobject:
            return ("ndarray", value.shape, frozen(value.tolist()))
        return (value.shape, value.dtype.str, value.tobytes())
    if isinstance(value, (list, tuple)):
        return (type(value), *(frozen(part) for part in value))
    if type(value) is dict:
        return (dict, frozenset((frozen(key), frozen(part)) for key, part in value.items()))
    if type(value) in (set, frozenset):
        return (set, frozenset(frozen(part) for part in value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and _has_fields_only(value):
        parts = (getattr(value, item.name) for item in dataclasses.fields(value))
        return (type(value), *(frozen(part) for part in parts))
    try:
        hash(value)
    except TypeError:
        return Itself(value)
    return value


def _has_fields_only(value: Any) -> bool:
    """Whether a dataclass has no equality and no attributes of its own, so that its fields say everything."""
    kind = type(value)
    if any("__eq__" in vars(cls) for cls in kind.__mro__[:-1]) and not kind.__dataclass_params__.eq:
        return False
    try:
        return set(vars(value)) <= {item.name for item in dataclasses.fields(value)}
    except TypeError:  # slots
        return True
