"""The list of built-in instances, to which the builders add themselves."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sapopt.domains.scenario import Scenario


@dataclass(frozen=True)
class Instance:
    """A built-in instance.

    Attributes
    ----------
    name : str
    summary : str
        One line: what it is, its size, its source.
    shape : tuple of int
        Steps T, agents n and tasks m with the default options.
    cost : float
        Cost of a handover that is used unless another is asked for.
    build : callable
        ``build(seed, **options)`` returns the scenario; its keyword arguments are the options.
    """

    name: str
    summary: str
    shape: tuple[int, int, int]
    cost: float
    build: Callable[..., Scenario]

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options of `build`."""
        return tuple(name for name in inspect.signature(self.build).parameters if name != "seed")


_REGISTRY: dict[str, Instance] = {}


def register(
    name: str, summary: str, shape: tuple[int, int, int], cost: float = 0.5
) -> Callable[[Callable[..., Scenario]], Callable[..., Scenario]]:
    """Decorator that adds ``build(seed, **options) -> scenario`` to the built-in instances.

    A builder imports its domain inside, so that listing the instances stays cheap.
    """

    if name in _REGISTRY:
        raise ValueError(f"name: there already is an instance called {name!r}; choose another")

    def add(build: Callable[..., Scenario]) -> Callable[..., Scenario]:
        _REGISTRY[name] = Instance(name, summary, shape, cost, build)
        return build

    return add


def instances() -> list[Instance]:
    """Descriptions of all built-in instances, sorted by name."""
    return [_REGISTRY[name] for name in sorted(_REGISTRY)]


def find_instance(name: str) -> Instance:
    """Description of one instance.

    Raises
    ------
    ValueError
        If there is no such instance; the message suggests the nearest name.
    """
    if name in _REGISTRY:
        return _REGISTRY[name]
    raise ValueError(f"unknown instance {name!r}; {nearest(name, sorted(_REGISTRY))}")


def nearest(word: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(str(word).lower(), known, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}"
