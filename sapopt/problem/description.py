"""What decides a problem's values, in plain words: for its fingerprint, and for files."""

from __future__ import annotations

import dataclasses
import hashlib
import numbers
from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Flat
from sapopt.data.types import IntArray
from sapopt.dynamics.capabilities import offers
from sapopt.dynamics.registry import BUILT_IN, is_own

_VERSION = "sapopt-fingerprint-2"


def fingerprint(
    shape: tuple[int, int, int],
    flat: Flat,
    initial: IntArray | None,
    dynamics: Any,
    more: tuple[dict[str, Any], dict[str, Any]] = ({}, {}),
) -> str:
    """SHA-256 of everything that decides the value of a plan.

    Every array goes in with its name and shape, so that no two problems share their bytes; numbers go in by value, so
    that a numpy scalar, a whole number and a negative zero count like the Python number that a file gives back.

    Raises
    ------
    ValueError
        If the dynamics is user-defined and does not tell what decides its values.
    """
    meta, arrays = told(dynamics) if is_own(dynamics) else described(dynamics)
    arrays = {"indptr": flat.indptr, "indices": flat.indices, "data": flat.data} | arrays
    if initial is not None:
        arrays["initial_assignment"] = initial
    meta, arrays = meta | more[0], arrays | more[1]
    digest = hashlib.sha256(_VERSION.encode())
    digest.update(repr((shape, sorted((key, plain(value)) for key, value in meta.items()))).encode())
    for name, array in arrays.items():
        wide = np.asarray(array)
        wide = wide.astype(np.float64) + 0.0 if wide.dtype.kind == "f" else wide.astype(np.int64)
        digest.update(repr((name, wide.shape, wide.dtype.kind)).encode())
        digest.update(np.ascontiguousarray(wide).tobytes())
    return digest.hexdigest()


def plain(value: Any) -> Any:
    """A parameter as Python's own values: equal ones look alike, whatever library made them."""
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        number = float(value)
        return int(number) if number.is_integer() else number
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return value


def told(dynamics: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a user's dynamics tells of itself by ``fingerprint()``, with its class name."""
    name = type(dynamics).__name__
    if not offers(dynamics, "fingerprint"):
        raise ValueError(
            f"dynamics: {name} is user-defined and has no fingerprint; give it a method fingerprint() that returns "
            "everything that decides its values, such as ['version 1', self.loss]"
        )
    told = dynamics.fingerprint()
    parts = [told] if isinstance(told, (str, numbers.Real, np.ndarray)) else told
    meta: dict[str, Any] = {"own dynamics": name}
    arrays: dict[str, Any] = {}
    if not isinstance(parts, (list, tuple)) or not parts:
        raise ValueError(f"dynamics: {name}.fingerprint() must return a text or a list, got {told!r}")
    for place, part in enumerate(parts):
        if isinstance(part, np.ndarray) and part.dtype.kind in "biuf":
            arrays[f"part {place}"] = part
        elif isinstance(part, (str, bool, np.bool_, numbers.Real)):
            meta[f"part {place}"] = part
        else:
            raise ValueError(
                f"dynamics: {name}.fingerprint() may hold text, numbers and arrays of numbers, got {part!r}"
            )
    return meta, arrays


def described(dynamics: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """A built-in dynamics as plain values and arrays; private state (the bound benefits) is left out."""
    name = type(dynamics).__name__
    if is_own(dynamics):
        raise ValueError(
            f"dynamics: {name} is user-defined; only problems with dynamics of sapopt can be written"
        )
    meta: dict[str, Any] = {"dynamics": name}
    arrays: dict[str, Any] = {}
    for item in dataclasses.fields(dynamics):
        value = getattr(dynamics, item.name)
        if item.name == "benefits":
            continue
        if isinstance(value, np.ndarray) or sp.issparse(value):
            arrays[f"dynamics.{item.name}"] = np.asarray(value)
        else:
            meta[f"dynamics.{item.name}"] = value
    return meta, arrays


def described_own(dynamics: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """A user's dynamics as plain values and arrays: where its class is, what it tells of itself, and its parameters.

    Raises
    ------
    ValueError
        If it does not tell what decides its values.
    """
    kind = type(dynamics)
    own: dict[str, Any] = {"class": f"{kind.__module__}:{kind.__qualname__}", "print": _print(dynamics)}
    meta: dict[str, Any] = {"dynamics": "own", "own": own}
    if not dataclasses.is_dataclass(dynamics):
        return meta, {}
    arrays: dict[str, Any] = {}
    for item in dataclasses.fields(dynamics):
        value = getattr(dynamics, item.name)
        if not item.init or item.name == "benefits":
            continue
        if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            arrays[f"dynamics.{item.name}"] = value
        elif value is None or isinstance(value, (str, bool, np.bool_, numbers.Real)):
            meta[f"dynamics.{item.name}"] = value
        else:  # whoever reads it has to bring an object
            return {"dynamics": "own", "own": own}, {}
    own["fields"] = True
    return meta, arrays


def rebuilt_own(
    meta: dict[str, Any], arrays: dict[str, Any], given: Any, path: Any, reader: str = "SAP.load"
) -> Any:
    """A user's dynamics of the class, or the object, that the caller hands over to `reader`.

    Raises
    ------
    ValueError
        If nothing is handed over, or something that is not what was written.
    """
    where = meta["own"]["class"]
    name = str(where).rpartition(":")[2]
    if given is None:
        shell = f", on the command line --dynamics {where}" if reader == "SAP.load" else ""
        raise ValueError(
            f"{path}: its dynamics is {where}, a class of its user's, and a file brings no code; hand the class over: "
            f"{reader}(path, dynamics={name}){shell}"
        )
    model = given
    if isinstance(given, type):
        if not meta["own"].get("fields"):
            raise ValueError(
                f"dynamics: {path} does not hold all that makes a {name}; hand over an object instead of the class"
            )
        try:
            model = given(**_options(meta, arrays))
        except TypeError as error:
            raise ValueError(
                f"dynamics: {given.__name__} does not take what {path} holds ({error})"
            ) from None
    if not is_own(model) or _print(model) != meta["own"]["print"]:
        raise ValueError(
            f"dynamics: {type(model).__name__} is not the {where} of {path}: it tells another fingerprint"
        )
    return model


def _print(dynamics: Any) -> str:
    """What a user's dynamics tells of itself, as one text."""
    none = np.zeros(0)
    return fingerprint((0, 0, 0), Flat(none.astype(np.int64), none.astype(np.int64), none), None, dynamics)


def _options(meta: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
    """The parameters of a dynamics in a file."""
    prefix = "dynamics."
    return {key[len(prefix) :]: v for key, v in (meta | arrays).items() if key.startswith(prefix)}


def rebuilt(meta: dict[str, Any], arrays: dict[str, Any]) -> Any:
    name = meta["dynamics"]
    if name not in BUILT_IN:
        raise ValueError(f"unknown dynamics {name!r}; the file was written by another version")
    return BUILT_IN[name](**_options(meta, arrays))
