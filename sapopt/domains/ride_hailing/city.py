"""A city with drivers and requests, and the problem made of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.scenario import refuse_idle_rule

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class City:
    """Places, drivers, and requests.

    Attributes
    ----------
    places_km : ndarray, shape (V, 2)
        East and north of every place.
    travel : ndarray of int64, shape (V, V)
        Steps from place to place.
    arrival : ndarray of int64, shape (R,)
        Step at which every request comes in, ascending.
    pick_up, drop_off : ndarray of int64, shape (R,)
        Places.
    fare : ndarray, shape (R,)
    home : ndarray of int64, shape (n,)
        Where the drivers start.
    steps : int
        Number of steps T.
    step_s : float
        Seconds from one step to the next.
    patience : int
        Most steps between a request and its pick-up.
    """

    places_km: FloatArray
    travel: IntArray
    arrival: IntArray
    pick_up: IntArray
    drop_off: IntArray
    fare: FloatArray
    home: IntArray
    steps: int
    step_s: float
    patience: int

    def __post_init__(self) -> None:
        requests = len(self.arrival)
        for name in ("pick_up", "drop_off", "fare"):
            if len(getattr(self, name)) != requests:
                raise ValueError(f"{name} has {len(getattr(self, name))} entries for {requests} requests")
        if not np.isfinite(self.fare).all():
            raise ValueError(f"fare of request {int(np.argmin(np.isfinite(self.fare)))} is not finite")
        if requests and not (self.arrival.min() >= 0 and self.arrival.max() < self.steps):
            raise ValueError(f"arrival must lie in 0..{self.steps - 1}, the steps of the city")
        if self.places_km.shape != (len(self.travel), 2):
            raise ValueError(f"places_km has shape {self.places_km.shape}, travel {self.travel.shape}")

    def worth(self, cost: float) -> FloatArray:
        """Fare less the cost of the ride itself, shape (R,); the way to the pick-up comes on top."""
        return self.fare - cost * self.travel[self.pick_up, self.drop_off]

    def problem(self, cost: Any = 0.5, *, idle_is_free: bool | None = None) -> SAP:
        """The sequential assignment problem: request r is task r, and every driver has an idle task at the end.

        Parameters
        ----------
        cost : float
            Cost of one step of driving, with or without a passenger. Requests that do not pay for their own ride are
            not on offer.
        idle_is_free : bool, optional
            Refused: a driver who waits always does so for free.
        """
        from sapopt.data.benefits import Benefits
        from sapopt.dynamics import RideHailing
        from sapopt.problem.sap import SAP

        refuse_idle_rule(idle_is_free, "a driver who waits does so for free")
        n, requests = len(self.home), len(self.arrival)
        rule = RideHailing(self.travel, self.pick_up, self.drop_off, self.home, self.patience, cost)
        worth = self.worth(rule.cost)
        offered = np.flatnonzero(worth > 0)
        offered = offered[np.argsort(self.arrival[offered], kind="stable")]
        counts = np.bincount(self.arrival[offered], minlength=self.steps)
        indptr = np.concatenate([[0], np.cumsum(np.repeat(counts, n))])
        blocks = np.split(offered, np.cumsum(counts)[:-1])
        indices = np.concatenate([np.tile(block, n) for block in blocks])
        benefits = Benefits.from_flat(indptr, indices, worth[indices], (self.steps, n, requests + n))
        labels = [f"request {r}" for r in range(requests)] + [f"idle {i}" for i in range(n)]
        return SAP(benefits, rule, agents=[f"driver {i}" for i in range(n)], tasks=labels)

    def rides(self, plan: IntArray, cost: float = 0.5) -> list[tuple[int, int, int, int]]:
        """The rides of a plan: (driver, request, step of the pick-up, step of the drop-off), in the order of taking."""
        problem = self.problem(cost)
        plan = problem.check_plan(plan)
        worth = problem.benefits.at(plan)
        state = problem.initial_state()
        places = len(self.travel)
        out = []
        for k, row in enumerate(plan):
            free, place = np.divmod(state.local, places)
            for i in np.flatnonzero(worth[k] > 0):
                request = int(row[i])
                at = max(int(free[i]), k) + int(self.travel[place[i], self.pick_up[request]])
                if at <= k + self.patience:
                    ride = int(self.travel[self.pick_up[request], self.drop_off[request]])
                    out.append((int(i), request, at, at + ride))
            state = problem.transition(k, state, row)
        return out

    def draw(self, plan: IntArray, cost: float = 0.5, ax: Axes | None = None) -> Axes:
        """Draw the requests on the map: rides as lines from pick-up to drop-off, the unserved as crosses."""
        from matplotlib.collections import LineCollection

        from sapopt.plotting.style import PALETTE, axes_or_new, despine

        ax = axes_or_new(ax, (5.6, 5.6))
        served = np.array([request for _, request, _, _ in self.rides(plan, cost)], dtype=np.int64)
        ends = np.stack([self.places_km[self.pick_up[served]], self.places_km[self.drop_off[served]]], axis=1)
        ax.add_collection(LineCollection(list(ends), colors=PALETTE[0], linewidths=0.8, alpha=0.4))
        lost = np.setdiff1d(np.arange(len(self.arrival)), served)
        for places, mark, color, label in (
            (self.pick_up[served], "o", PALETTE[0], f"picked up: {len(served)}"),
            (self.pick_up[lost], "x", PALETTE[1], f"not served: {len(lost)}"),
            (self.home, "s", PALETTE[2], f"drivers at the start: {len(self.home)}"),
        ):
            east, north = self.places_km[places].T
            ax.plot(east, north, ls="none", marker=mark, ms=5, color=color, label=label, alpha=0.8)
        ax.set_aspect("equal")
        ax.set_xlabel("east (km)")
        ax.set_ylabel("north (km)")
        ax.legend(frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0, 1.01))
        despine(ax)
        return ax


def random_city(
    drivers: int = 100,
    requests: int = 600,
    steps: int = 60,
    seed: int = 0,
    *,
    width: int = 10,
    patience: int = 4,
) -> City:
    """A square city of streets one kilometre apart; one step is two minutes and drives one block.

    Requests start mostly in the centre in the first half of the time and mostly outside in the second, so that it
    matters where a driver is left. A fare is 2 plus 1.2 per block, times a factor around 1 that says how much the ride
    is wanted.

    Parameters
    ----------
    drivers, requests, steps : int
        n, R and T.
    seed : int
    width : int
        Crossings along each side; V is its square.
    patience : int
        Most steps between a request and its pick-up.

    Raises
    ------
    ValueError
        If a number is too small.
    """
    for name, value, least in (
        ("drivers", drivers, 1), ("requests", requests, 1), ("steps", steps, 1), ("width", width, 2),
    ):  # fmt: skip
        if int(value) != value or value < least:
            raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    rng = np.random.default_rng(seed)
    places = np.stack(np.divmod(np.arange(width**2), width), axis=1).astype(np.float64)
    travel = np.abs(places[:, None] - places[None]).sum(axis=2).astype(np.int64)
    far = np.linalg.norm(places - places.mean(axis=0), axis=1) / (width / 2)
    inner = np.exp(-2.0 * far**2)
    arrival = np.sort(rng.integers(0, steps, requests))
    from_inner = rng.random(requests) < np.where(arrival < steps / 2, 0.8, 0.2)
    weights = np.stack([np.ones(len(places)), inner / inner.mean()])
    weights /= weights.sum(axis=1, keepdims=True)
    pick_up = np.where(
        from_inner, rng.choice(len(places), requests, p=weights[1]), rng.choice(len(places), requests, p=weights[0])
    )  # fmt: skip
    drop_off = np.where(
        from_inner, rng.choice(len(places), requests, p=weights[0]), rng.choice(len(places), requests, p=weights[1])
    )  # fmt: skip
    drop_off = np.where(drop_off == pick_up, (drop_off + 1) % len(places), drop_off)
    fare = (2.0 + 1.2 * travel[pick_up, drop_off]) * rng.lognormal(0.0, 0.25, requests)
    home = rng.choice(len(places), drivers)
    return City(
        places,
        travel,
        arrival,
        pick_up,
        drop_off,
        fare.round(2),
        home,
        int(steps),
        120.0,
        int(patience),
    )
