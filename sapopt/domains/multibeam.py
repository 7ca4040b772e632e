"""Satellites with several beams that serve users on the ground (Holder 2024, section 4.4).

Every satellite serves up to ten tasks at once, its b-th beam at ``0.9 ** b`` of the benefit; taking up a task that no
beam of the same satellite served at the step before costs a handover. Each beam is a synthetic agent
(`sapopt.formulations.synthetic`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sapopt.domains.constellation import Constellation
    from sapopt.formulations.synthetic import SyntheticAgents
    from sapopt.plotting.aboard import Aboard
    from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class MultiBeam:
    """A constellation whose satellites have several beams.

    Attributes
    ----------
    constellation : Constellation
    beams : int
        Beams of every satellite.
    decay : float
        The b-th beam (from 0) earns ``decay ** b`` of the benefit.
    """

    constellation: Constellation
    beams: int = 10
    decay: float = 0.9

    def synthetic(self, cost: Any = 0.5, *, idle_is_free: bool = False) -> SyntheticAgents:
        """The problem of the beams, with the way back to the satellites.

        Parameters
        ----------
        cost : float
            Cost of a handover.
        idle_is_free : bool
            Charge only tasks that the satellite sees; otherwise idle beams pay like others when they are moved.
        """
        import numpy as np

        from sapopt.formulations.synthetic import synthetic_agents

        if np.ndim(cost) != 0:
            raise ValueError("cost: beams take one number for all handovers")
        # The base problem gives every satellite one task of its own, idle ones where there are too few.
        short = max(0, self.constellation.n - self.constellation.m)
        base = self.constellation.with_idle_tasks(short).problem(cost, idle_is_free=idle_is_free)
        return synthetic_agents(base, self.beams, self.decay)

    def on_earth(self) -> Aboard:
        """Every agent is a beam of one of the satellites."""
        from sapopt.plotting.aboard import Aboard

        return Aboard(self.constellation, self.synthetic().agent_of, None)

    def problem(self, cost: Any = 0.5, *, idle_is_free: bool = False) -> SAP:
        """The sequential assignment problem of the beams."""
        return self.synthetic(cost, idle_is_free=idle_is_free).problem


def multi_beam(
    seed: int = 0,
    *,
    steps: int = 93,
    tasks: int = 1200,
    beams: int = 10,
    decay: float = 0.9,
    planes: int = 6,
    per_plane: int = 6,
    altitude_km: float = 550.0,
    inclination_deg: float = 58.0,
) -> MultiBeam:
    """The built-in scenario: 36 satellites, ten beams each, random tasks, one orbit in steps of a minute.

    The thesis gives ten beams, the decay, and "a group of satellites over the United States", for which see
    `multi_beam_us`. Here the tasks lie on the whole Earth, and the numbers of satellites and tasks are ours, such that
    a satellite sees about as many tasks (11) as it has beams.
    """
    from sapopt.domains import constellation as c

    shell = c.WalkerShell(planes, per_plane, inclination_deg, altitude_km)
    return MultiBeam(
        c.walker_constellation(shell, c.random_tasks(tasks, seed), steps, earth="still"), beams, decay
    )


def multi_beam_us(
    seed: int = 0,
    *,
    steps: int = 93,
    beams: int = 10,
    decay: float = 0.9,
    planes: int = 12,
    per_plane: int = 12,
    altitude_km: float = 550.0,
    inclination_deg: float = 58.0,
    resolution: int = 3,
) -> MultiBeam:
    """Satellites over the United States (Holder 2024, 4.4): one task at the centre of each hexagon of the country.

    Ten beams, a decay of 0.9, priorities uniform on [1, 2] are the thesis'. Ours are the constellation, of which the
    satellites that never see the United States are left out, and the 633 tasks.
    """
    import numpy as np

    from sapopt.domains import constellation as c
    from sapopt.domains.tracking import us_regions

    regions = us_regions(resolution)
    priority = np.random.default_rng(seed).uniform(1.0, 2.0, len(regions))
    places = c.GroundTasks(regions.latitude_deg, regions.longitude_deg, priority, scattered=True)
    every = c.walker_constellation(
        c.WalkerShell(planes, per_plane, inclination_deg, altitude_km), places, steps, earth="still"
    )
    return MultiBeam(every.only_seeing(), beams, decay)
