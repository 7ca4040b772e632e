"""From a user's object to a `Model`: the only module that looks at objects by name.

What a class says beyond its rule (a *capability*: sparse intervals, path oracles, limits) is believed only if it is
said of the very rule that is played. A subclass that overrides a part of what a capability of its base may rest on, be
it a method, a property or a private helper, has another rule, and the base knows nothing of it. The generic way is
taken instead, or the refusal says what to define.

A capability that class C defines counts for an object if nothing that its subclasses (or the object itself) define
replaces an attribute of C. These may be replaced nevertheless: other capabilities, fields' default values, special
methods, and what C names in ``extended_by`` because all that C says is derived by calling it.
"""

from __future__ import annotations

import difflib
import numbers
import types
import warnings
from collections.abc import Mapping
from functools import cached_property
from typing import Any

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Dynamics, Model, Setting, checked_handover

RULE = ("initial_state", "handover", "transition", "interaction")
"""What decides the value of a plan."""

PATHS = ("path_oracle", "window_oracle", "local_model")
"""Said by any class: the paths of agents who do not see each other."""
KINDS = ("switching", "entering", "batteries", "plain", "disturbed", "is_agent_local", "has_places", "copies")
"""Said by subclasses of `Model` alone; elsewhere such names mean something else."""
NUMBERS = ("handover_limit", "handover_floor", "capacity")
CAPABILITIES = (
    "handover_at",
    "interval",
    "key",
    "marginal",
    "serves",
    "charge_of",
    "features",
    "agent_columns",
    "of_columns",
    *NUMBERS,
    *PATHS,
    *KINDS,
)
"""What a class may say of its rule."""

_FREE = frozenset(
    (
        *CAPABILITIES, "bind", "validate", "fingerprint", "extended_by", "agents_alike",
        "_abc_impl", "_is_protocol", "_is_runtime_protocol",
    )
)  # fmt: skip
"""May be replaced in a subclass: no capability rests on them."""
_ASKED = (*CAPABILITIES, "fingerprint", "validate", "interaction")
_NEAR = 0.9
"""From this likeness on a name is taken for a misspelt one (`difflib`): ``handover_limits``, not ``handover_cost``."""

Layers = list[tuple[type | None, Mapping[str, Any]]]
"""What an object defines, then its classes from the lowest up; None stands for the object itself."""


def offers(dynamics: Any, name: str) -> bool:
    """Whether an object says something under a name, and says it of its own rule (see the module's documentation)."""
    return _offers(_layers(dynamics), name)


def _offers(layers: Layers, name: str) -> bool:
    place = _place(layers, name)
    if place is None or layers[place][0] is Model:
        return False
    said = layers[place][1][name]
    if said is None or (name not in NUMBERS and not (_is_code(said) or name == "agents_alike")):
        return False
    owner = _author(name, layers) if layers[place][0] is None else place
    known = {own for _, names in layers[owner:] for own in names}
    hooks = layers[owner][1].get("extended_by", frozenset())
    return not any(
        own not in hooks and _replaces(own, value, layers[owner:], known)
        for _, names in layers[:owner]
        for own, value in names.items()
    )


def _layers(dynamics: Any) -> Layers:
    kind = type(dynamics)
    classes: Layers = [(cls, vars(cls)) for cls in kind.__mro__ if cls is not object]
    own = {}
    for name, value in _values(dynamics).items():
        place = _place(classes, name)
        # A value where the class has a value, or computes one when first asked, is a parameter and no new rule.
        if name in CAPABILITIES or (place is not None and _is_code(classes[place][1][name])):
            own[name] = value
    return [(None, own), *classes]


def _values(dynamics: Any) -> Mapping[str, Any]:
    try:
        return vars(dynamics)
    except TypeError:  # slots
        return {}


def _place(layers: Layers, name: str) -> int | None:
    return next((place for place, (_, names) in enumerate(layers) if name in names), None)


def _is_code(value: Any) -> bool:
    """Whether an attribute is a method or a property, and not a plain value."""
    if isinstance(value, (cached_property, types.MemberDescriptorType)):
        return False
    return callable(value) or isinstance(value, (property, staticmethod, classmethod)) or _is_data(value)


def _is_data(value: Any) -> bool:
    """Whether a class attribute is asked even where the object has a value of its own."""
    return hasattr(type(value), "__set__") and not isinstance(value, types.MemberDescriptorType)


def _author(name: str, layers: Layers) -> int:
    """The layer of the class that put a value into the object: whose field it is, or whose constructor names it."""
    tables = [(place, names["__dataclass_fields__"]) for place, (_, names) in enumerate(layers)
              if name in names.get("__dataclass_fields__", {})]  # fmt: skip
    if tables:  # subclasses that do not declare the field anew share it
        return max(place for place, table in tables if table[name] is tables[0][1][name])
    for place, (cls, names) in enumerate(layers):
        for method in ("__init__", "__post_init__"):
            code = getattr(names.get(method), "__code__", None) if cls is not None else None
            if code is not None and name in (*code.co_names, *code.co_consts):
                return place
    return 0


def _replaces(name: str, value: Any, above: Layers, known: set[str]) -> bool:
    """Whether a definition changes something that the classes above may rest on."""
    if name in RULE:
        return True
    if name not in known or name in _FREE:
        return False
    if name.startswith("__") and name.endswith("__"):
        return name in ("__getattribute__", "__getattr__")
    is_field = any(name in names.get("__dataclass_fields__", {}) for _, names in above)
    return not is_field or _is_data(value)


class Adapted(Model):
    """A user's dynamics as a `Model`: its rule, checked, and those of its capabilities that are of this rule.

    Attributes
    ----------
    dynamics : Dynamics
        The user's object, bound to the problem's benefits.
    """

    def __init__(self, dynamics: Any, n: int, m: int) -> None:
        self.dynamics: Dynamics = dynamics
        self._shape = n, m
        layers = _layers(dynamics)
        names = (
            CAPABILITIES if isinstance(dynamics, Model) else tuple(x for x in CAPABILITIES if x not in KINDS)
        )
        said = {name for name in names if _offers(layers, name)}
        self._changed = _changed(layers)
        self._interacts = _interacts(layers)
        if self._interacts:  # the agents do see each other
            said -= {*PATHS, *KINDS}
            self.interaction = dynamics.interaction  # type: ignore[method-assign]  # the object's own rule
        if "charge_of" not in said:
            said -= {"capacity"}
        self._is_local = not said.isdisjoint(PATHS)
        if "is_agent_local" in said:
            self._is_local = self._is_local and dynamics.is_agent_local
        self._has_places = {"has_places", "path_oracle"} <= said and dynamics.has_places
        for name in said - {"is_agent_local", "has_places"}:
            value = getattr(dynamics, name)
            if name in NUMBERS and not isinstance(value, numbers.Real):
                raise ValueError(
                    f"dynamics: {name} of {type(dynamics).__name__} must be a number, got {value!r}"
                )
            setattr(self, name, value)

    def __repr__(self) -> str:
        return repr(self.dynamics)

    @property
    def called(self) -> str:
        """Such as ``"Half changes handover of SwitchingCost, which speaks of its own rule alone; Half"``."""
        name = type(self.dynamics).__name__
        return name if self._changed is None else f"{name} changes {self._changed}; {name}"

    @property
    def interacts(self) -> bool:
        """Whether the class has an ``interaction``."""
        return self._interacts

    @property
    def is_agent_local(self) -> bool:
        """Whether the class tells of its agents' paths."""
        return self._is_local

    @property
    def has_places(self) -> bool:
        """Whether the class tells of the paths of groups."""
        return self._has_places

    def initial_state(self, problem: Setting) -> Any:
        """The user's."""
        return self.dynamics.initial_state(problem)

    def handover(self, k: int, state: Any) -> FloatArray:
        """The user's, checked."""
        return checked_handover(self.dynamics.handover(k, state), k, *self._shape)

    def transition(self, k: int, state: Any, assignment: IntArray) -> Any:
        """The user's."""
        return self.dynamics.transition(k, state, assignment)


def adapt(dynamics: Any, problem: Setting) -> Model:
    """The model of a problem: the dynamics itself where all that it says is of its own rule, or an `Adapted` one.

    Raises
    ------
    ValueError
        If the object is no dynamics, does not fit the problem, or says two things of one rule.

    Warns
    -----
    UserWarning
        If an attribute looks like a misspelt capability.
    """
    if isinstance(dynamics, type):
        raise ValueError(f"dynamics: pass an instance, such as {dynamics.__name__}(...), not the class")
    if not isinstance(dynamics, Dynamics):
        raise ValueError(
            f"dynamics: {type(dynamics).__name__} needs the methods initial_state, handover and transition"
        )
    given: Any = dynamics
    layers = _layers(given)
    _check_one_rule(given, layers)
    _warn_of_misspelling(given, layers)
    if _place(layers, "validate") is not None:
        given.validate(problem)
    bound = given if _place(layers, "bind") is None else given.bind(problem.benefits)
    if type(bound) is not type(given):
        giver = layers[_place(layers, "bind") or 0][0]
        if giver is not None and giver is not type(given):
            raise ValueError(
                f"dynamics: bind of {giver.__name__} makes a {type(bound).__name__} of a {type(given).__name__}, whose "
                "own rule is lost; let it return dataclasses.replace(self, benefits=benefits)"
            )
    if isinstance(bound, Model) and not _is_stale(bound):
        return bound
    return Adapted(bound, problem.n, problem.m)


def _interacts(layers: Layers) -> bool:
    place = _place(layers, "interaction")
    return place is not None and layers[place][0] is not Model and layers[place][1]["interaction"] is not None


def _changed(layers: Layers) -> str | None:
    """What is replaced of the first class that says something of its rule, None if nothing is."""
    for name in CAPABILITIES:
        place = _place(layers, name)
        if place is None or layers[place][0] in (None, Model) or _offers(layers, name):
            continue
        known = {own for _, names in layers[place:] for own in names}
        parts = [own for _, names in layers[:place] for own, value in names.items()
                 if _replaces(own, value, layers[place:], known)]  # fmt: skip
        base = layers[place][0]
        if parts and base is not None:
            return (
                f"{' and '.join(dict.fromkeys(parts))} of {base.__name__}, which speaks of its own rule alone"
            )
    return None


def _is_stale(model: Model) -> bool:
    """Whether something that the classes of a `Model` say is not of its rule."""
    layers = _layers(model)
    says = {name for name in CAPABILITIES if layers[_place(layers, name) or 0][0] is not Model}
    return any(not _offers(layers, name) for name in says) or _interacts(layers) != model.interacts


def _check_one_rule(dynamics: Any, layers: Layers) -> None:
    """Refuse a class that says the entries of its base's handover matrix, and leaves the matrix as it is.

    Also where the base has the matrix alone: `SAP.evaluate` would score by the entries, solvers assign by the matrix.
    """
    entries = [
        place for place, (cls, names) in enumerate(layers) if "handover_at" in names and cls is not Model
    ]
    matrix = _place(layers, "handover")
    if entries and matrix is not None and entries[0] < matrix:
        base = layers[matrix][0]
        raise ValueError(
            f"dynamics: {type(dynamics).__name__} defines handover_at, but its handover is that of "
            f"{base.__name__ if base else 'its class'}: two rules in one problem. Define handover, the matrix, as "
            "well, or alone: the entries are then read from it"
        )


def _warn_of_misspelling(dynamics: Any, layers: Layers) -> None:
    """Name what looks like a capability and is none."""
    for cls, names in layers:
        if cls is Model:
            return
        if cls is not None and cls.__module__.split(".")[0] == "sapopt":
            continue
        mine, known = (names, _ASKED) if cls is not None else (_values(dynamics), NUMBERS[:2])
        for name in mine:
            if name.startswith("_") or name in (*RULE, *_FREE) or len(name) < 5:
                continue
            for near in difflib.get_close_matches(name, known, 1, _NEAR):
                place = _place(layers, near)
                if place is None or layers[place][0] is Model:
                    warnings.warn(
                        f"dynamics: sapopt never asks for {type(dynamics).__name__}.{name}; if it is meant to be "
                        f"{near}, rename it",
                        stacklevel=4,
                    )
