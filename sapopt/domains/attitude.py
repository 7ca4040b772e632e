"""Satellites that have to turn: the cost of a move is the slew between two pointing directions (thesis, 7.1.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.constellation import Constellation, GroundTasks
from sapopt.domains.scenario import refuse_idle_rule

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sapopt.plotting.aboard import Aboard
    from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class Attitude:
    """A constellation whose satellites pay for turning; every satellite has an idle task of its own at the end.

    Attributes
    ----------
    constellation : Constellation
    """

    constellation: Constellation

    @property
    def targets_km(self) -> FloatArray:
        """Earth-fixed places of the tasks, shape (m, 3)."""
        from sapopt.domains.constellation.earth import EARTH_RADIUS_KM, unit_vectors

        tasks: GroundTasks = self.constellation.tasks
        return EARTH_RADIUS_KM * unit_vectors(tasks.latitude_deg, tasks.longitude_deg)

    def on_earth(self) -> Aboard:
        """Every agent is a satellite of the constellation."""
        from sapopt.plotting.aboard import every_satellite

        return every_satellite(self.constellation)

    def problem(
        self, cost: Any = 0.5, *, idle_is_free: bool | None = None, initial_assignment: Any = None
    ) -> SAP:
        """The sequential assignment problem, with n idle tasks appended.

        Parameters
        ----------
        cost : float
            Cost of a slew through one radian.
        idle_is_free : bool, optional
            Refused: a satellite always turns to nadir for free.
        initial_assignment : array_like of int, shape (n,), optional
            Tasks pointed at before the first step; without it the first step pays nothing.
        """
        from sapopt.dynamics import SlewCost

        refuse_idle_rule(idle_is_free, "a satellite that idles turns to nadir for free")
        dynamics = SlewCost(cost, self.constellation.positions_km, self.targets_km)
        wide = self.constellation.with_idle_tasks()
        return wide.problem(dynamics=dynamics, initial_assignment=initial_assignment)

    def slews_deg(self, plan: IntArray) -> FloatArray:
        """Degrees that every satellite turns at every step of a plan on its way to a task, shape (T, n)."""
        problem = self.problem(cost=1.0)
        state = problem.initial_state()
        out = np.zeros(plan.shape)
        for k, row in enumerate(problem.check_plan(plan)):
            out[k] = -problem.model.handover_at(k, state, row)
            state = problem.transition(k, state, row)
        return np.degrees(out)

    def draw(self, plan: IntArray, ax: Axes | None = None) -> Axes:
        """Draw how far the satellites turn: every slew as a dot, and the mean of those that turn as a line."""
        from sapopt.plotting.style import PALETTE, axes_or_new, despine, step_axis

        ax = axes_or_new(ax, (7.2, 3.4))
        slews = self.slews_deg(plan)
        step, _ = np.nonzero(slews > 0)
        ax.plot(step, slews[slews > 0], ".", ms=3, color=PALETTE[0], alpha=0.35, label="slew of a satellite")
        step_axis(ax)
        ax.set_ylabel("slew (degrees)")
        ax.set_ylim(0, max(float(slews.max()) * 1.05, 1.0))
        turning = (slews > 0).sum(axis=1)
        mean = np.divide(slews.sum(axis=1), turning, out=np.zeros(len(turning)), where=turning > 0)
        ax.plot(mean, color=PALETTE[1], lw=1.8, label="mean of those that turn")
        ax.legend(frameon=False, loc="upper right", fontsize=9)
        ax.set_title(
            f"{(slews > 0).sum():,} slews, {slews.sum():,.0f} degrees in all", fontsize=9, loc="left"
        )
        despine(ax)
        return ax
