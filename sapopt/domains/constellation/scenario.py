"""A constellation over time with its tasks: everything a problem is made of, kept together."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.constellation.earth import EARTH_RATE_RAD_S, sidereal_rad
from sapopt.domains.constellation.elements import ElementSets, element_positions_km
from sapopt.domains.constellation.graphs import links
from sapopt.domains.constellation.orbits import Earth, WalkerShell, walker_positions_km
from sapopt.domains.constellation.tasks import GroundTasks
from sapopt.domains.constellation.view import FieldOfView, checked_positions, visible_benefits
from sapopt.domains.constellation.windows import within

if TYPE_CHECKING:
    import networkx as nx

    from sapopt.data.benefits import Benefits
    from sapopt.problem.limit import Limit, Team
    from sapopt.problem.sap import SAP

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, repr=False)
class Constellation:
    """Satellites, tasks on the ground, and what each satellite gains from each task at each step.

    Made by `walker_constellation`, `element_constellation` or `constellation`.

    Attributes
    ----------
    positions_km : ndarray of float64, shape (T, n, 3)
        Earth-fixed positions of the satellites.
    tasks : GroundTasks
        The m tasks.
    benefits : Benefits
        Sparse, shape (T, n, m): priority times proximity (eq. 4.1), within the tasks' windows.
    step_s : float
        Seconds from one step to the next.
    field_of_view : FieldOfView
    satellite_names : tuple of str, length n
    start : datetime or None
        Time of the first step, with a time zone; None if it is not known.
    """

    positions_km: FloatArray
    tasks: GroundTasks
    benefits: Benefits
    step_s: float
    field_of_view: FieldOfView = field(default_factory=FieldOfView)
    satellite_names: tuple[str, ...] = ()
    start: datetime | None = None

    def __repr__(self) -> str:
        return f"Constellation(T={self.T}, n={self.n}, m={self.m}, step_s={self.step_s:g})"

    def __str__(self) -> str:
        """Two lines: what there is, and how much of it is in view."""
        when = "" if self.start is None else f" from {self.start.isoformat()}"
        flat, wanted = self.benefits.flat(), int((self.tasks.priority > 0).sum())
        unseen = _unseen(self.tasks, self.benefits)
        views = len(flat.indices) / (self.T * self.n)
        lost = "every task is seen at some step"
        if len(unseen):
            lost = f"never seen: {len(unseen)}, such as {self.tasks.called(int(unseen[0]))}"
        return (
            f"{self.n} satellites, {wanted} tasks, {self.T} steps of {self.step_s:g} s{when}\n"
            f"a satellite sees {views:.2g} tasks at a step on average; {lost}"
        )

    @property
    def T(self) -> int:
        """Number of steps."""
        return self.positions_km.shape[0]

    @property
    def n(self) -> int:
        """Number of satellites."""
        return self.positions_km.shape[1]

    @property
    def m(self) -> int:
        """Number of tasks."""
        return self.tasks.m

    @property
    def times(self) -> tuple[datetime, ...] | None:
        """When every step begins, in the time zone of `start`; None if that is not known."""
        if self.start is None:
            return None
        first = self.start.astimezone(UTC)
        moments = (first + timedelta(seconds=self.step_s * k) for k in range(self.T))
        return tuple(moment.astimezone(self.start.tzinfo) for moment in moments)

    def problem(
        self,
        cost: Any = 0.5,
        *,
        idle_is_free: bool = False,
        initial_assignment: Any = None,
        dynamics: Any = None,
        idle: bool = False,
        capacity: Any = 1,
        limits: Iterable[Limit | Team] = (),
        only_seen: bool = False,
    ) -> SAP:
        """The sequential assignment problem of this constellation.

        Parameters
        ----------
        cost : float or ndarray of shape (m, m)
            Cost of a handover, as in `SwitchingCost`; 0.5 in the thesis.
        idle_is_free : bool
            Charge only a move to a task that the satellite sees (section 6.3).
        initial_assignment : array_like of int, shape (n,), optional
            Tasks held before the first step; without it the first step pays no handover.
        dynamics : object, optional
            A model of the state, as `Battery`, in place of the switching cost.
        idle, capacity, limits
            As in `SAP`: satellites may hold nothing, a task may take several, and limits on the whole plan.
        only_seen : bool
            Forbid tasks that a satellite does not see at a step; it needs ``idle=True``. Otherwise a satellite may
            hold a task before and after it sees it, for nothing.

        Raises
        ------
        ValueError
            If there are more satellites than tasks and they may not idle, or `only_seen` is asked for without `idle`.
        """
        from sapopt.dynamics import SwitchingCost
        from sapopt.problem.sap import SAP

        if only_seen and not idle:
            raise ValueError("only_seen: a satellite that sees no task must hold nothing; pass idle=True")
        if self.n > self.m and not idle and np.ndim(capacity) == 0 and capacity == 1:
            raise ValueError(
                f"{self.n} satellites cannot share {self.m} tasks: each needs a task of its own; pass idle=True, or "
                f"add tasks of zero benefit with .with_idle_tasks() (or tasks.with_idle_tasks({self.n - self.m}))"
            )
        if dynamics is None:
            dynamics = SwitchingCost(cost, idle_is_free=idle_is_free)
        benefits: Any = self.benefits
        if only_seen:
            benefits = self.benefits.dense()
            benefits = np.where(benefits > 0, benefits, -np.inf)
        return SAP(
            benefits, dynamics, initial_assignment, agents=self.satellite_names or None,
            tasks=self.tasks.names or None, times=self.times, idle=idle, capacity=capacity, limits=limits,
        )  # fmt: skip

    def graphs(self, range_km: float = 2500.0, steps: Sequence[int] | None = None) -> list[nx.Graph]:
        """Communication graphs, one per step (or per step of `steps`): see `links`."""
        return links(self.positions_km if steps is None else self.positions_km[list(steps)], range_km)

    def only_seeing(self) -> Constellation:
        """The same constellation without the satellites that see no task at any step.

        Raises
        ------
        ValueError
            If no satellite is left.
        """
        flat = self.benefits.flat()
        seeing = np.flatnonzero((np.diff(flat.indptr).reshape(self.T, self.n) > 0).any(axis=0))
        if not len(seeing):
            raise ValueError("inclination_deg, steps: no satellite ever sees a task")
        return constellation(
            self.positions_km[:, seeing], self.tasks, self.step_s, field_of_view=self.field_of_view,
            satellite_names=[self.satellite_names[i] for i in seeing], start=self.start,
        )  # fmt: skip

    def with_idle_tasks(self, count: int | None = None) -> Constellation:
        """The same constellation with `count` tasks of zero benefit appended (by default one per satellite)."""
        extra = self.n if count is None else count
        return replace(
            self, tasks=self.tasks.with_idle_tasks(extra), benefits=self.benefits.with_idle_tasks(extra)
        )


def constellation(
    positions_km: Any,
    tasks: GroundTasks,
    step_s: float,
    *,
    field_of_view: FieldOfView | None = None,
    satellite_names: Sequence[str] | None = None,
    start: datetime | None = None,
) -> Constellation:
    """A constellation from positions of your own.

    Parameters
    ----------
    positions_km : array_like, shape (T, n, 3)
        Earth-fixed positions, kilometres from the Earth's centre.
    tasks : GroundTasks
    step_s : float
        Seconds from one step to the next.
    field_of_view : FieldOfView, optional
        The thesis' field of view if omitted.
    satellite_names : sequence of str, optional
        Their numbers if omitted.
    start : datetime, optional
        Time of the first step; UTC if it has no time zone. Tasks with time windows need it.

    Raises
    ------
    ValueError
        If the positions are malformed or below the ground, the names do not match them, or tasks have time windows and
        there is no date.
    """
    positions = checked_positions(positions_km)
    view = FieldOfView() if field_of_view is None else field_of_view
    n = positions.shape[1]
    names = tuple(str(i) for i in range(n)) if satellite_names is None else tuple(satellite_names)
    if len(names) != n:
        raise ValueError(f"satellite_names has {len(names)} names for {n} satellites")
    if not (np.isfinite(step_s) and step_s > 0):
        raise ValueError(f"step_s must be a positive number of seconds, got {step_s}")
    if start is not None and not isinstance(start, datetime):
        raise ValueError(f"start must be a datetime, got {start!r}")
    if start is not None and start.tzinfo is None:
        start = start.replace(tzinfo=UTC)
    if tasks.windows and start is None:
        raise ValueError("start: the tasks have time windows, so the first step needs a date")
    benefits = visible_benefits(positions, tasks, view)
    if tasks.windows and start is not None:
        benefits = within(benefits, tasks.windows, start, float(step_s))
    _tell_unseen(tasks, benefits)
    return Constellation(positions, tasks, benefits, float(step_s), view, names, start)


def _unseen(tasks: GroundTasks, benefits: Benefits) -> IntArray:
    """Tasks that are worth something, and that no satellite ever sees."""
    seen = np.zeros(benefits.shape[2], dtype=bool)
    seen[benefits.flat().indices] = True
    return np.flatnonzero(~seen & (tasks.priority > 0))


def _tell_unseen(tasks: GroundTasks, benefits: Benefits) -> None:
    """Warn of tasks that are never seen: they are often mistakes in places or times that somebody gave."""
    unseen = _unseen(tasks, benefits)
    if len(unseen):
        logger.log(
            logging.INFO if tasks.scattered else logging.WARNING,
            "no satellite ever sees %d of %d tasks%s, such as %s", len(unseen), int((tasks.priority > 0).sum()),
            " within their windows" if tasks.windows else "", tasks.called(int(unseen[0])),
        )  # fmt: skip


def walker_constellation(
    shells: WalkerShell | Sequence[WalkerShell],
    tasks: GroundTasks,
    steps: int = 93,
    step_s: float = 60.0,
    *,
    start_s: float | None = None,
    earth: Earth = "rotating",
    j2: bool = False,
    sidereal_angle_deg: float | None = None,
    field_of_view: FieldOfView | None = None,
    start: datetime | None = None,
) -> Constellation:
    """A Walker constellation with its tasks above an Earth that turns; sizes and times are those of Holder (2024), 4.2.

    Parameters
    ----------
    shells, tasks, field_of_view
        Satellites, tasks, and what a satellite sees.
    steps, step_s : int, float
        Number of steps T and seconds between them. 93 minutes are one orbit at 550 km.
    start_s : float, optional
        Time of the first step after the shells' starting angles hold; one step if omitted, as in the published code.
    earth : {"rotating", "still"}
        "still" stops the Earth among the stars, as in the published code and in the built-in instances of the thesis,
        which says nothing of it.
    j2
        See `walker_positions_km`.
    sidereal_angle_deg : float, optional
        Where the Earth stands: the angle from the inertial x axis to the Greenwich meridian, `start_s` seconds before
        the first step. By default it follows from `start` (Greenwich mean sidereal time, IAU 1982, with UTC for UT1);
        without a date it is 0.
    start : datetime, optional
        Date of the first step, for tables, maps and time windows; UTC if it has no time zone. The nodes of the planes
        are then right ascensions of that date.
    """
    shells = (shells,) if isinstance(shells, WalkerShell) else tuple(shells)
    if start_s is None:
        start_s = step_s
    if sidereal_angle_deg is None:
        sidereal_angle_deg = 0.0
        if isinstance(start, datetime):
            sidereal_angle_deg = float(np.degrees(sidereal_rad(start)))
            if earth == "rotating":
                sidereal_angle_deg -= float(np.degrees(EARTH_RATE_RAD_S * start_s))
    positions = walker_positions_km(
        shells,
        steps,
        step_s,
        start_s=start_s,
        earth=earth,
        j2=j2,
        sidereal_angle_deg=sidereal_angle_deg,
    )
    names = [
        f"shell {k} plane {p} satellite {s}" if len(shells) > 1 else f"plane {p} satellite {s}"
        for k, shell in enumerate(shells)
        for p in range(shell.planes)
        for s in range(shell.satellites_per_plane)
    ]
    return constellation(
        positions, tasks, step_s, field_of_view=field_of_view, satellite_names=names, start=start
    )


def element_constellation(
    elements: ElementSets,
    tasks: GroundTasks,
    steps: int = 93,
    step_s: float = 60.0,
    *,
    start: datetime | None = None,
    earth: Earth = "rotating",
    field_of_view: FieldOfView | None = None,
) -> Constellation:
    """Real satellites with tasks on the ground; satellites that SGP4 cannot propagate are left out with a warning.

    Parameters
    ----------
    elements : ElementSets
        See `read_elements` and `starlink_elements`.
    tasks, field_of_view
        Tasks, and what a satellite sees.
    steps, step_s : int, float
        Number of steps T and seconds between them.
    start, earth
        See `element_positions_km`.
    """
    positions, kept = element_positions_km(elements, steps, step_s, start=start, earth=earth)
    names = [elements.names[i] for i in kept]
    return constellation(
        positions, tasks, step_s, field_of_view=field_of_view, satellite_names=names,
        start=elements.latest_epoch if start is None else start,
    )  # fmt: skip
