"""Satellites that track objects: regions as tasks, two observers per region, one step of acquisition.

The model of eq. 4.3: satellite i earns ``proximity x objects in the region`` from a region only if it held it at the
step before; a second observer adds a fifth of that. Objects appear without notice, so the future is a forecast.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.tracking.objects import Objects, moving_objects
from sapopt.domains.tracking.regions import Regions, us_regions

if TYPE_CHECKING:
    from collections.abc import Callable

    from sapopt.data.benefits import Benefits
    from sapopt.domains.constellation import Constellation, WalkerShell
    from sapopt.formulations.synthetic import SyntheticTasks
    from sapopt.plotting.aboard import Aboard
    from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class Tracking:
    """Satellites, regions and objects.

    Attributes
    ----------
    satellites : Constellation
        Its tasks are the centres of the regions, all of priority 1; its benefits are the proximities.
    regions : Regions
    objects : Objects
    observers : int
        Satellites that may observe one region at a time.
    decay : float
        The second observer earns this share of the benefit, a third one its square.
    watch : float
        What a region in view is worth without any object, in objects: beta^e / beta^t of eq. 4.3. It makes "in view" a
        positive benefit.
    scale : float
        What an object in the region is worth: beta^t.
    needs_sight : bool
        Whether a region counts as held only while the satellite sees it. Equation 4.3 does not ask for that.
    """

    satellites: Constellation
    regions: Regions
    objects: Objects
    observers: int = 2
    decay: float = 0.2
    watch: float = 0.02
    scale: float = 1.0
    needs_sight: bool = True

    def synthetic(self) -> SyntheticTasks:
        """The problem of the observers, with the way back to the regions.

        Satellites start idle: every one has an idle task of its own, and has to acquire the first region it observes.
        """
        from sapopt.data.benefits import Benefits
        from sapopt.dynamics import SyntheticSwitching
        from sapopt.formulations.synthetic import synthetic_tasks
        from sapopt.problem.sap import SAP

        seen = self.satellites
        counts = self.objects.counts(len(self.regions))
        benefits = Benefits([self._weighted(k, counts[k]) for k in range(seen.T)])
        dynamics = SyntheticSwitching(forfeit=1.0, needs_sight=self.needs_sight)
        base = SAP(
            benefits, dynamics, seen.m + np.arange(seen.n), agents=seen.satellite_names or None,
            tasks=[*self.regions.cells, *(f"idle {i}" for i in range(seen.n))],
        )  # fmt: skip
        return synthetic_tasks(base, np.repeat([self.observers, 1], [seen.m, seen.n]), self.decay)

    def on_earth(self) -> Aboard:
        """Every agent is a satellite; a region has a task for each observer."""
        from sapopt.plotting.aboard import Aboard

        return Aboard(self.satellites, np.arange(self.satellites.n), self.synthetic().task_of)

    def problem(self, cost: Any = 0.0, *, idle_is_free: bool = False) -> SAP:
        """The sequential assignment problem of the observers, with the objects' true ways as benefits.

        Solve it with ``forecast=self.forecast()``; without, a policy knows what nobody can know.

        Raises
        ------
        ValueError
            If a cost is asked for: a change of region costs its acquisition, nothing else.
        """
        if np.ndim(cost) != 0 or cost != 0 or idle_is_free:
            raise ValueError(
                "cost: tracking charges the step of acquisition; leave cost and idle_is_free out"
            )
        return self.synthetic().problem

    def forecast(self, horizon: int = 8) -> Callable[[int, int], Benefits]:
        """What is known at step k of the next steps: the objects that are there, going straight on.

        Parameters
        ----------
        horizon : int
            Steps that are forecast at most, the current one among them; not less than a policy's lookahead.
        """
        from sapopt.data.benefits import Benefits
        from sapopt.formulations.synthetic.copies import copied_tasks

        if isinstance(horizon, bool) or int(horizon) != horizon or horizon < 1:
            raise ValueError(f"horizon must be a whole number of at least 1, got {horizon!r}")
        copies = np.repeat([self.observers, 1], [self.satellites.m, self.satellites.n])

        def forecast(k: int, steps: int) -> Benefits:
            ahead = min(steps, horizon)
            counts = self.objects.predicted(k, ahead, self.regions)
            rows = Benefits([self._weighted(k + step, counts[step]) for step in range(ahead)])
            return copied_tasks(rows, copies, self.decay)

        return forecast

    def tracked(self, plan: Any, by: Literal["same", "any"] = "same") -> float:
        """Share of the objects that are tracked, over all objects and steps but the first, 0 to 1.

        Parameters
        ----------
        plan : array_like of int, shape (T, n)
            Plan of the observers.
        by : {"same", "any"}
            "A target is tracked if the region it is in is observed, and had also been observed in the previous time
            step" (section 4.3): by the same satellite, which then has set up, or by any two. A satellite observes a
            region that it holds and sees.
        """
        if by not in ("same", "any"):
            raise ValueError(f"by must be 'same' or 'any', got {by!r}")
        regions = self.synthetic().original(plan)
        holds = self._observed(regions)
        total, found = 0, 0
        for k in range(1, self.satellites.T):
            there = self.objects.region[k]
            there = there[there >= 0]
            total += len(there)
            if by == "same":
                kept = regions[k][(regions[k] == regions[k - 1]) & holds[k] & holds[k - 1]]
            else:
                kept = np.intersect1d(regions[k][holds[k]], regions[k - 1][holds[k - 1]])
            found += int(np.isin(there, kept).sum())
        return found / total if total else 0.0

    def coverable(self) -> float:
        """Share of the objects in view of some satellite at this step and the one before: no plan tracks more."""
        total, found = 0, 0
        for k in range(1, self.satellites.T):
            there = self.objects.region[k]
            there = there[there >= 0]
            both = (self._sees(k) * self._sees(k - 1)).sum(axis=0) > 0
            total += len(there)
            found += int(both[there].sum())
        return found / total if total else 0.0

    def _sees(self, k: int) -> sp.csr_array:
        return sp.csr_array(self.satellites.benefits.step(k) > 0).astype(np.int64)

    def _observed(self, regions: IntArray) -> np.ndarray:
        """Whether every satellite sees the region it holds, (T, n)."""
        inside = regions < self.satellites.m
        looked: FloatArray = self.satellites.benefits.at(np.where(inside, regions, 0))
        return inside & (looked > 0)

    def _weighted(self, k: int, counts: IntArray) -> sp.csr_array:
        """Benefits of a step: proximity times the objects of the region, and idle tasks."""
        near = sp.csr_array(self.satellites.benefits.step(k))
        data = self.scale * near.data * (counts[near.indices] + self.watch)
        n, m = near.shape
        return sp.csr_array((data, near.indices, near.indptr), shape=(n, m + n))


def tracking(
    seed: int = 0,
    *,
    steps: int = 93,
    shell: WalkerShell | None = None,
    resolution: int = 3,
    arrivals_per_step: float = 0.6,
    observers: int = 2,
    decay: float = 0.2,
    along_grid: bool = False,
    watch: float = 0.02,
    scale: float = 1.0,
    needs_sight: bool = True,
) -> Tracking:
    """The built-in scenario: the satellites of a Walker constellation that come over the United States in an orbit.

    The thesis gives the hexagons, two observers and the decay of 0.2; its other numbers are in `tracking_thesis`. The
    rest is ours: a `shell` of 40 x 25 satellites at 550 km and 58 degrees unless another is given, of which those
    that never see the United States are left out (575 are left); cells of H3 resolution 3; on average 0.6 new objects
    a minute, some 15 at a time, which some 30 satellites in view could observe.
    """
    from sapopt.domains import constellation as c

    regions = us_regions(resolution)
    places = c.GroundTasks(regions.latitude_deg, regions.longitude_deg, np.ones(len(regions)), scattered=True)
    shell = shell or c.WalkerShell(40, 25, inclination_deg=58.0, altitude_km=550.0)
    satellites = c.walker_constellation(shell, places, steps, earth="still").only_seeing()
    objects = moving_objects(regions, steps, seed, arrivals_per_step=arrivals_per_step, along_grid=along_grid)
    return Tracking(satellites, regions, objects, observers, decay, watch, scale, needs_sight)


def tracking_thesis(seed: int = 0, **options: Any) -> Tracking:
    """The scenario by the numbers of section 4.3, where the thesis gives them.

    beta^e = 1 and beta^t = 10, two observers, the second at a fifth, targets that move along the grid, and eq. 4.3 as
    it stands: a region earns if the satellite held one of its copies at the step before, whether it saw it or not. The
    thesis also names lambda = 0.5, which has no place in eq. 4.3 and none here. Constellation, cells, number and speed
    of the targets are those of `tracking`, whose keyword arguments are the `options`.
    """
    given: dict[str, Any] = {"along_grid": True, "watch": 0.1, "scale": 10.0, "needs_sight": False}
    return tracking(seed, **(given | options))
