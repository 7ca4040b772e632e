"""Ride-hailing: where a driver is, and until when it is busy, decides which rides it can take (thesis, 7.1.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray, checked_cost, index_array
from sapopt.dynamics.base import AgentColumns, Setting
from sapopt.dynamics.rules.agent_local import AgentLocal, LocalStates


def checked_travel(travel: object) -> IntArray:
    """Steps from place to place.

    Raises
    ------
    ValueError
        If they are no square array, negative, or 0 off the diagonal.
    """
    steps = index_array(travel, "travel")
    if steps.ndim != 2 or steps.shape[0] != steps.shape[1] or (steps < 0).any():
        raise ValueError(f"travel must be a (V, V) array of steps, not negative, got shape {steps.shape}")
    if np.diagonal(steps).any() or (steps + np.eye(len(steps), dtype=np.int64) == 0).any():
        raise ValueError(
            "travel must be 0 on the diagonal and at least 1 elsewhere; merge places that are one"
        )
    return steps


def checked_places(places: object, name: str, count: int) -> IntArray:
    """Places of drivers or requests.

    Raises
    ------
    ValueError
        If they are no list of places that there are.
    """
    found = index_array(places, name)
    if found.ndim != 1 or (len(found) and not (found.min() >= 0 and found.max() < count)):
        raise ValueError(f"{name} must be a list of places in 0..{count - 1}")
    return found


def check_requests(problem: Setting, home: IntArray, pick_up: IntArray) -> None:
    """Check that drivers and requests fit a problem.

    Raises
    ------
    ValueError
        If there are more or fewer drivers than agents, or a benefit is negative or of no request.
    """
    if len(home) != problem.n:
        raise ValueError(f"home has {len(home)} places for {problem.n} drivers")
    flat = problem.benefits.flat()
    if int(flat.indices.max(initial=-1)) >= len(pick_up):
        raise ValueError(
            f"pick_up has {len(pick_up)} places, but task {flat.indices.max()} has a benefit as well"
        )
    if len(flat.data) and flat.data.min() < 0:
        raise ValueError(
            "benefits must not be negative here; leave requests out that are not worth their way"
        )


@dataclass(frozen=True, eq=False)
class RideHailing(AgentLocal):
    """Drivers take rides, which carry them through the city.

    Task r is a request. It is on offer at the one step at which it has a benefit, the step it comes in; who takes it
    must be able to be at the pick-up at most `patience` steps later, also a driver who has to finish another ride
    first. The driver pays `cost` for every step of empty driving to the pick-up, is busy until the drop-off, and is
    free there. A driver sent to a request that it cannot reach in time stays where it is and gets nothing. A request
    that nobody takes is gone. (Requests that wait on offer for several steps are for `WaitingRides`: what keeps two
    drivers off one request is a limit there, as the capacity of a task holds for each step.)

    The local state is the place where a driver is or will be free, and when.

    Parameters
    ----------
    travel : array_like of int, shape (V, V)
        Steps from place to place, not negative, 0 only on the diagonal.
    pick_up, drop_off : array_like of int, shape (R,)
        Places of the requests, which are the tasks 0 .. R - 1. Later tasks are for idling.
    home : array_like of int, shape (n,)
        Where the drivers start, free.
    patience : int
        Most steps between a request and its pick-up.
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
    home: IntArray
    patience: int = 3
    cost: float = 1.0
    agents_alike = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "travel", checked_travel(self.travel))
        for name in ("pick_up", "drop_off", "home"):
            object.__setattr__(self, name, checked_places(getattr(self, name), name, len(self.travel)))
        if len(self.pick_up) != len(self.drop_off):
            raise ValueError(
                f"drop_off has {len(self.drop_off)} places for {len(self.pick_up)} pick-ups; give one each"
            )
        if isinstance(self.patience, bool) or int(self.patience) != self.patience or self.patience < 0:
            raise ValueError(f"patience must be a whole number of steps, not negative, got {self.patience!r}")
        object.__setattr__(self, "cost", checked_cost(self.cost))

    def __repr__(self) -> str:
        return f"RideHailing({len(self.travel)} places, patience={self.patience}, cost={self.cost})"

    def validate(self, problem: Setting) -> None:
        """Check that drivers and requests fit the problem, and that no request is on offer twice."""
        check_requests(problem, self.home, self.pick_up)
        flat = problem.benefits.flat()
        step = np.repeat(np.arange(problem.T), np.diff(flat.indptr[:: problem.n]))
        offers = np.unique(step * problem.m + flat.indices) % problem.m
        if len(np.unique(offers)) < len(offers):
            raise ValueError("benefits: a request may be on offer (have a benefit) at one step only")

    def start(self, problem: Setting) -> IntArray:
        """All drivers are free at home; an initial assignment tells nothing about them."""
        return self.home.copy()

    def features(self, state: LocalStates) -> FloatArray:
        """In how many times `patience` (or steps, without any) every driver is free, shape ``(n, 1)``."""
        busy = np.maximum(state.local // len(self.travel) - state.step, 0)
        return (busy / max(self.patience, 1))[:, None].astype(np.float64)

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
        goes = (benefit > 0) & (free + empty <= k + self.patience)
        eta = np.where(goes, -self.cost * empty, np.where(benefit > 0, -benefit, 0.0))
        done = np.where(goes, free + empty + self.travel[pick, drop], free)
        return eta, np.maximum(done, k + 1) * len(self.travel) + np.where(goes, drop, place)
