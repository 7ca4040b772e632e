"""What a domain builds, as the rest of the library sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    from sapopt.data.types import FloatArray
    from sapopt.problem.sap import SAP


class Scenario(Protocol):
    """Data of a domain's own, and the problem made of it. One with a map is `sapopt.plotting.aboard.OnEarth` too."""

    def problem(self, cost: Any = ..., *, idle_is_free: bool = ...) -> SAP:
        """The sequential assignment problem.

        `cost` is the cost of a handover, `idle_is_free` says whether only moves to tasks of positive benefit pay. A
        domain whose rule has no such choice refuses it with a ValueError.
        """


@runtime_checkable
class Moving(Protocol):
    """A scenario whose agents move through space, and hear each other over a distance."""

    @property
    def positions_km(self) -> FloatArray:
        """Positions (T, n, 3) of the agents."""


def refuse_idle_rule(idle_is_free: bool | None, rule: str) -> None:
    """Raise a ValueError if the choice is made where `rule` leaves none."""
    if idle_is_free is not None:
        raise ValueError(f"idle_is_free: there is nothing to choose here, {rule}; leave it out")
