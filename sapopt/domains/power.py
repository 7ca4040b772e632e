"""Earth observation with free idling, and with satellites that run on batteries (chapter 6 of Holder 2024)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.constellation import Constellation, WalkerShell, random_tasks, walker_constellation
from sapopt.dynamics.battery.model import PayFor

if TYPE_CHECKING:
    import networkx as nx

    from sapopt.data.benefits import Benefits
    from sapopt.plotting.aboard import Aboard
    from sapopt.problem.sap import SAP

PRIORITIES = (1.0, 1.0, 1.0, 5.0)
"""Priorities of tasks are drawn from these with equal chances (published code; not in the thesis)."""

PUBLISHED_SHELL = WalkerShell(18, 18, 58.0, 550.0)

STEP_S = 63.76
"""Seconds from one step to the next (published code; the thesis has steps of a minute)."""


@dataclass(frozen=True, eq=False)
class PowerConstellation:
    """A constellation whose satellites may idle for free and, in the power environment, live on batteries.

    Attributes
    ----------
    constellation : Constellation
        Satellites, tasks and benefits.
    initial_assignment : ndarray of int64, shape (n,), or None
        Held before the first step; without it the first step pays no handover.
    battery : bool
        Whether the satellites have batteries (section 6.4); without, idling is free and that is all (6.3).
    pay_for : {"moves", "entries"}
        What satellites with batteries pay for, see `Battery`.
    """

    constellation: Constellation
    initial_assignment: IntArray | None
    battery: bool = True
    pay_for: PayFor = "moves"

    @property
    def positions_km(self) -> FloatArray:
        """Earth-fixed positions of the satellites, shape (T, n, 3)."""
        return self.constellation.positions_km

    @property
    def benefits(self) -> Benefits:
        """Sparse benefits, shape (T, n, m): priority times proximity."""
        return self.constellation.benefits

    def graphs(self, range_km: float = 2500.0, steps: Sequence[int] | None = None) -> list[nx.Graph]:
        """Communication graphs, see `Constellation.graphs`."""
        return self.constellation.graphs(range_km, steps)

    def on_earth(self) -> Aboard:
        """Every agent is a satellite of the constellation."""
        from sapopt.plotting.aboard import every_satellite

        return every_satellite(self.constellation)

    def problem(self, cost: Any = 0.5, *, dynamics: Any = None, **options: Any) -> SAP:
        """The sequential assignment problem.

        Parameters
        ----------
        cost : float
            Cost of a handover.
        dynamics : object, optional
            A state model in place of the built-in one.
        **options
            Options of the state model: those of `Battery`, such as ``drain`` or ``pay_for``, or without batteries
            ``idle_is_free``.
        """
        from sapopt.dynamics import Battery, SwitchingCost

        if dynamics is None and self.battery:
            if "idle_is_free" in options:
                raise ValueError(
                    "idle_is_free does not apply to satellites with batteries, which always idle for free; "
                    "pay_for='entries' makes them pay for every start of work"
                )
            dynamics = Battery(cost, **({"pay_for": self.pay_for} | options))
        elif dynamics is None:
            dynamics = SwitchingCost(cost, **({"idle_is_free": True} | options))
        elif options:
            raise ValueError(f"{', '.join(options)}: set this on the dynamics that you pass")
        return self.constellation.problem(initial_assignment=self.initial_assignment, dynamics=dynamics)


def power_constellation(
    shells: WalkerShell | Sequence[WalkerShell] = PUBLISHED_SHELL,
    tasks: int = 450,
    steps: int = 100,
    seed: int = 0,
    *,
    battery: bool = True,
    pay_for: PayFor = "moves",
    priorities: Sequence[float] = PRIORITIES,
    earth: Any = "still",
    j2: bool = False,
) -> PowerConstellation:
    """The environment of section 6.4, or without batteries one like that of 6.3, at the published code's settings.

    Priorities, the length of a step, the random initial assignment, latitudes within 55 degrees and the still Earth
    are not in the thesis' text. `earth_coverage` is section 6.3 by the text.

    Parameters
    ----------
    shells : WalkerShell or sequence of them
    tasks : int
        Random tasks on the ground; at least one per satellite.
    steps : int
        Steps of 63.76 seconds.
    seed : int
        Decides the tasks and the initial assignment.
    battery, pay_for
        See `PowerConstellation`.
    priorities : sequence of float
        What the tasks' priorities are drawn from.
    earth, j2
        As in `walker_constellation`.
    """
    ground = random_tasks(tasks, seed, priorities=priorities)
    built = walker_constellation(shells, ground, steps, STEP_S, earth=earth, j2=j2)
    if built.n > built.m:
        raise ValueError(f"tasks must be at least the number of satellites, {built.n}, got {tasks}")
    start = np.random.default_rng([seed, 1]).permutation(built.m)[: built.n]
    return PowerConstellation(built, start, battery, pay_for)


def earth_coverage(
    seed: int = 0, *, steps: int = 93, tasks: int = 450, earth: Any = "still", j2: bool = False
) -> PowerConstellation:
    """The environment of section 6.3 of Holder (2024), by its text: every task is worth 1, idling is free.

    324 satellites, an orbit in steps of a minute, as in 4.2.1; "the only difference is that beta_max is 1 for all
    tasks and that handover penalties are only applied when switching to a meaningful task". The places of the tasks
    are those of `random_tasks`, and the Earth stands still, as in ``constellation-mid``.

    Parameters
    ----------
    seed : int
        Decides the places of the tasks.
    steps, tasks : int
    earth, j2
        As in `walker_constellation`.
    """
    ground = random_tasks(tasks, seed, priorities=(1.0,))
    built = walker_constellation(PUBLISHED_SHELL, ground, steps, earth=earth, j2=j2)
    return PowerConstellation(built, None, battery=False)
