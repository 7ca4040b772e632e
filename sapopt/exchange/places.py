"""Agents that stay where they are: antennas, depots, wards. Their plans go on maps as satellites' plans do."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any, Protocol, runtime_checkable

from sapopt.data.types import FloatArray


@runtime_checkable
class Located(Protocol):
    """Places on the ground with names, such as `sapopt.domains.constellation.GroundTasks`."""

    @property
    def latitude_deg(self) -> FloatArray:
        """Degrees north."""

    @property
    def longitude_deg(self) -> FloatArray:
        """Degrees east."""

    @property
    def priority(self) -> FloatArray:
        """Places of priority 0 are not drawn."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names, or none."""


@dataclass(frozen=True, eq=False)
class Places:
    """Where agents and tasks of a problem are, for `write_czml` and `write_geojson`, if none of them moves.

    Parameters
    ----------
    agents, tasks : GroundTasks
        A place for each agent and each task; names that are missing are taken from the problem.
    start : datetime, optional
        Date of the first step, UTC if it has no time zone; needed only if the problem's steps have no dates of their
        own. Without any date it is 2000-01-01 12:00 UTC.
    step_s : float
        Seconds from one step to the next, where the problem's steps have no dates.

    Raises
    ------
    ValueError
        If a place is missing, or `step_s` is no positive number.

    Examples
    --------
    >>> from sapopt.domains.constellation import GroundTasks
    >>> antennas = GroundTasks([35.4, -35.4], [-116.9, 149.0], [1.0, 1.0], ("Goldstone", "Canberra"))
    >>> sites = GroundTasks([60.0, 0.0], [10.0, 20.0], [1.0, 1.0])
    >>> Places(antennas, sites, step_s=3600.0).step_s
    3600.0
    """

    agents: Located
    tasks: Located
    start: datetime | None = None
    step_s: float = 60.0

    def __post_init__(self) -> None:
        given: Any
        for name, given in (("agents", self.agents), ("tasks", self.tasks)):
            if not isinstance(given, Located):
                raise ValueError(f"{name} must be places, such as GroundTasks, got {type(given).__name__}")
        if self.start is not None and not isinstance(self.start, datetime):
            raise ValueError(f"start must be a datetime, got {self.start!r}")
        if not 0.0 < float(self.step_s) < float("inf"):
            raise ValueError(f"step_s must be a positive number of seconds, got {self.step_s!r}")
