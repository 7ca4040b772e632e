"""Ride-hailing with requests that wait: a request is on offer for several steps, and taken once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray, checked_cost, index_array
from sapopt.dynamics.base import AgentColumns, Setting
from sapopt.dynamics.rules.agent_local import AgentLocal, LocalStates
from sapopt.dynamics.rules.ride_hailing import check_requests, checked_places, checked_travel


@dataclass(frozen=True, eq=False)
class WaitingRides(AgentLocal):
    """Drivers take rides, as in `RideHailing`, from requests that wait until their patience ends.

    Task r is a request. It is on offer at every step at which it has a benefit, and must be picked up by its latest
    step. That nobody else takes it afterwards is no matter of a driver's own state: such problems have
    ``limits=[Limit.once()]``. A driver sent to a request that it cannot reach in time stays where it is and gets
    nothing.

    The local state is the place where a driver is or will be free, and when.

    Parameters
    ----------
    travel : array_like of int, shape (V, V)
        Steps from place to place, not negative, 0 only on the diagonal.
    pick_up, drop_off : array_like of int, shape (R,)
        Places of the requests, which are the tasks 0 .. R - 1. Later tasks are for idling.
    latest : array_like of int, shape (R,)
        Last step at which each request may be picked up.
    home : array_like of int, shape (n,)
        Where the drivers start, free.
    cost : float
        Cost of one step of empty driving, not negative.

    Raises
    ------
    ValueError
        If a place does not exist, or a number is out of range.
    """

    travel: IntArray
    pick_up: IntArray
    drop_off: IntArray
    latest: IntArray
    home: IntArray
    cost: float = 1.0
    agents_alike = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "travel", checked_travel(self.travel))
        for name in ("pick_up", "drop_off", "home"):
            object.__setattr__(self, name, checked_places(getattr(self, name), name, len(self.travel)))
        object.__setattr__(self, "latest", index_array(self.latest, "latest"))
        for name in ("drop_off", "latest"):
            if np.shape(getattr(self, name)) != self.pick_up.shape:
                raise ValueError(
                    f"{name} has {np.size(getattr(self, name))} entries for {len(self.pick_up)} pick-ups; give one each"
                )
        object.__setattr__(self, "cost", checked_cost(self.cost))

    def __repr__(self) -> str:
        return f"WaitingRides({len(self.travel)} places, cost={self.cost})"

    def validate(self, problem: Setting) -> None:
        """Check that drivers and requests fit the problem."""
        check_requests(problem, self.home, self.pick_up)

    def start(self, problem: Setting) -> IntArray:
        """All drivers are free at home; an initial assignment tells nothing about them."""
        return self.home.copy()

    def features(self, state: LocalStates) -> FloatArray:
        """In how many steps every driver is free, shape ``(n, 1)``."""
        return np.maximum(state.local // len(self.travel) - state.step, 0)[:, None].astype(np.float64)

    def agent_columns(self, state: LocalStates) -> AgentColumns:
        """Where every driver is or will be free, and in how many steps."""
        free, place = np.divmod(state.local, len(self.travel))
        return AgentColumns({}, {"place": place, "busy": np.maximum(free - state.step, 0)})

    def of_columns(self, columns: AgentColumns) -> LocalStates:
        """The drivers before the first step of the benefits."""
        return LocalStates(0, columns.values["busy"] * len(self.travel) + columns.values["place"])

    def rule(
        self, k: int, agent: IntArray, local: IntArray, task: IntArray, benefit: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Drive to the pick-up and on to the drop-off, or stay. The local state is ``free * V + place``."""
        free, place = np.divmod(local, len(self.travel))
        free = np.maximum(free, k)
        request = np.where(benefit > 0, task, 0)
        pick, drop = self.pick_up[request], self.drop_off[request]
        empty = self.travel[place, pick]
        goes = (benefit > 0) & (free + empty <= self.latest[request])
        eta = np.where(goes, -self.cost * empty, np.where(benefit > 0, -benefit, 0.0))
        done = np.where(goes, free + empty + self.travel[pick, drop], free)
        return eta, np.maximum(done, k + 1) * len(self.travel) + np.where(goes, drop, place)
