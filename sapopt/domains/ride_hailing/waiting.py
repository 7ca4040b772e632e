"""Requests that wait for a driver until their patience ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import IntArray
from sapopt.domains.ride_hailing.city import City, random_city
from sapopt.domains.scenario import refuse_idle_rule

if TYPE_CHECKING:
    from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class WaitingCity:
    """A city whose requests stay on offer from their arrival on, until somebody takes them or their patience ends.

    Attributes
    ----------
    city : City
        A request may be taken at every step from its arrival on, and must be picked up at most `City.patience` steps
        after it.
    """

    city: City

    @property
    def latest(self) -> IntArray:
        """Last step, shape (R,), at which every request may be picked up."""
        return self.city.arrival + self.city.patience

    def problem(self, cost: Any = 0.5, *, idle_is_free: bool | None = None) -> SAP:
        """The sequential assignment problem: request r is task r, taken once.

        Parameters
        ----------
        cost : float
            Cost of one step of driving, with or without a passenger. Requests that do not pay for their own ride are
            not on offer.
        idle_is_free : bool, optional
            Refused: a driver who waits always does so for free.
        """
        import scipy.sparse as sp

        from sapopt.dynamics import WaitingRides
        from sapopt.problem.limit import Limit
        from sapopt.problem.sap import SAP

        refuse_idle_rule(idle_is_free, "a driver who waits does so for free")
        city, latest = self.city, self.latest
        n, requests = len(city.home), len(city.arrival)
        rule = WaitingRides(city.travel, city.pick_up, city.drop_off, latest, city.home, cost)
        worth = city.worth(rule.cost)
        benefits = []
        for k in range(city.steps):
            offered = np.flatnonzero((worth > 0) & (city.arrival <= k) & (k <= latest))
            row = np.zeros(requests)
            row[offered] = worth[offered]
            benefits.append(sp.csr_array(np.broadcast_to(row, (n, requests))))
        return SAP(
            benefits, rule, idle=True, limits=[Limit.once(name="taken")],
            agents=[f"driver {i}" for i in range(n)], tasks=[f"request {r}" for r in range(requests)],
        )  # fmt: skip

    def taken(self, plan: IntArray, cost: float = 0.5) -> list[tuple[int, int, int, int]]:
        """The rides of a plan: (driver, request, step of the pick-up, step of the drop-off), in the order of taking."""
        problem, city = self.problem(cost), self.city
        plan = problem.check_plan(plan)
        state, core = problem.core.initial_state(), problem.core
        out = []
        for k, row in enumerate(problem.placed(plan)):
            free, place = np.divmod(state.local, len(city.travel))
            for i in np.flatnonzero(plan[k] >= 0):
                request = int(plan[k, i])
                at = max(int(free[i]), k) + int(city.travel[place[i], city.pick_up[request]])
                offered = core.benefits.slice(k, k + 1).at(row[None])[0, i] > 0
                if offered and at <= self.latest[request]:
                    ride = int(city.travel[city.pick_up[request], city.drop_off[request]])
                    out.append((int(i), request, at, at + ride))
            state = core.transition(k, state, row)
        return out


def random_waiting_city(
    drivers: int = 20,
    requests: int = 120,
    steps: int = 40,
    seed: int = 0,
    *,
    width: int = 8,
    patience: int = 6,
) -> WaitingCity:
    """The city of `random_city`, with requests that wait; patience counts from a request's arrival to its pick-up."""
    return WaitingCity(random_city(drivers, requests, steps, seed, width=width, patience=patience))
