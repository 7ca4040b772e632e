"""A day of imaging satellites: every target once, one of them by two at a time, and contacts with ground stations.

Tasks are the targets, each wanted within a time window, then the ground stations. A picture is worth the target's
priority, from wherever it is seen; a step of contact is worth a little. A target is looked at once. The one that is
wanted from two sides, the *pair target*, pays when two satellites look at it at the same step. A station holds as many
satellites as it has antennas. A satellite pays for every turn, by its angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import IntArray
from sapopt.domains.attitude import Attitude
from sapopt.domains.constellation import (
    Constellation,
    GroundTasks,
    WalkerShell,
    constellation,
    random_tasks,
    walker_positions_km,
)
from sapopt.domains.scenario import refuse_idle_rule

if TYPE_CHECKING:
    from sapopt.plotting.aboard import Aboard
    from sapopt.problem.sap import SAP

_ALONE = 0.1
"""What one picture of the pair target is worth, as a share of what it would be of another target."""
_REWARD = 2.0
"""What two pictures of it at a time are worth together, in its priority."""
_CONTACT = 0.02
"""Priority of a ground station: what a step of contact is worth."""
_RING = 30
"""Places along an orbit; a train takes the first ones."""


@dataclass(frozen=True, eq=False)
class ImagingDay:
    """Satellites, targets with their windows, and ground stations.

    Attributes
    ----------
    constellation : Constellation
        Its tasks are the targets, then the stations.
    window : ndarray of int64, shape (targets, 2)
        First step at which a target is wanted, and the step after the last one.
    pair : int
        The target that two satellites must look at together.
    antennas : int
        Of every station.
    """

    constellation: Constellation
    window: IntArray
    pair: int
    antennas: int

    def __post_init__(self) -> None:
        steps, targets = self.constellation.T, len(self.window)
        if self.window.shape != (targets, 2) or targets > self.constellation.m:
            raise ValueError(f"window must have shape (targets, 2), got {self.window.shape}")
        if (self.window < 0).any() or (self.window > steps).any():
            raise ValueError(f"window must lie in 0..{steps}")
        if not 0 <= self.pair < targets:
            raise ValueError(f"pair must be one of the {targets} targets, got {self.pair}")
        if self.antennas < 1:
            raise ValueError(f"antennas must be at least 1, got {self.antennas}")

    @property
    def targets(self) -> int:
        """Number of targets; later tasks are stations."""
        return len(self.window)

    def on_earth(self) -> Aboard:
        """Every agent is a satellite of the constellation."""
        from sapopt.plotting.aboard import every_satellite

        return every_satellite(self.constellation)

    def problem(self, cost: Any = 0.2, *, idle_is_free: bool | None = None) -> SAP:
        """The sequential assignment problem, with limits and a team.

        Parameters
        ----------
        cost : float
            Cost of a slew through one radian.
        idle_is_free : bool, optional
            Refused: a satellite always turns to nadir for free.
        """
        import scipy.sparse as sp

        from sapopt.dynamics import SlewCost
        from sapopt.problem.limit import Limit, Team
        from sapopt.problem.sap import SAP

        refuse_idle_rule(idle_is_free, "a satellite that idles turns to nadir for free")
        base, pair = self.constellation, self.pair
        open_from = np.concatenate([self.window[:, 0], np.zeros(base.m - self.targets, dtype=np.int64)])
        open_to = np.concatenate([self.window[:, 1], np.full(base.m - self.targets, base.T)])
        worth = base.tasks.priority * np.where(np.arange(base.m) == pair, _ALONE, 1.0)
        benefits = []
        for k in range(base.T):
            is_open = (open_from <= k) & (k < open_to)
            step = (sp.csr_array(base.benefits.step(k)).toarray() > 0) * np.where(is_open, worth, 0.0)
            step[step[:, pair] <= 0, pair] = -np.inf  # who does not see it is of no help to the other
            benefits.append(sp.csr_array(step))
        capacity = np.ones((base.T, base.m), dtype=np.int64)
        capacity[:, self.targets :] = self.antennas
        seers = np.array([(step[:, [pair]] > 0).sum() for step in benefits])
        capacity[:, pair] = np.minimum(seers, 2)
        together = np.flatnonzero(seers >= 2)
        limits: list[Limit | Team] = [Limit.once(np.delete(np.arange(self.targets), pair), name="one look")]
        limits.append(Limit.once(pair, 2, name="two looks"))
        if len(together):
            reward = _REWARD * float(base.tasks.priority[pair])
            limits.append(Team(pair, 2, reward=reward, steps=together))
        names = [f"target {j}" for j in range(self.targets)]
        names += [f"station {j}" for j in range(base.m - self.targets)]
        rule = SlewCost(cost, base.positions_km, Attitude(base).targets_km)
        return SAP(
            benefits,
            rule,
            idle=True,
            capacity=capacity,
            limits=limits,
            agents=base.satellite_names,
            tasks=names,
        )


def imaging_day(
    seed: int = 0,
    *,
    satellites: int = 12,
    targets: int = 40,
    steps: int = 1440,
    stations: int = 3,
    antennas: int = 2,
) -> ImagingDay:
    """A made-up day by the minute: two trains of satellites, six each, 12 degrees apart, over a turning Earth.

    Each target is wanted for a third of the time, from a random moment on. The pair target is the one that two
    satellites see at once most often.

    Parameters
    ----------
    seed : int
    satellites, targets, steps : int
        n and T; m is targets and stations together.
    stations, antennas : int

    Raises
    ------
    ValueError
        If a number is too small, or too large for the trains.
    """
    for name, value, least in (
        ("satellites", satellites, 1), ("targets", targets, 1), ("steps", steps, 1), ("stations", stations, 0),
        ("antennas", antennas, 1),
    ):  # fmt: skip
        if int(value) != value or value < least:
            raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    if satellites > 2 * _RING:
        raise ValueError(f"satellites: two trains of {_RING} have room for {2 * _RING}, got {satellites}")
    rng = np.random.default_rng(seed)
    ring = walker_positions_km(WalkerShell(2, _RING, 58.0, 550.0), steps, 60.0, earth="rotating")
    half = (satellites + 1) // 2
    aboard = np.concatenate([np.arange(half), _RING + np.arange(satellites - half)])
    wanted = random_tasks(targets, rng, uniform_in="area")
    ground = random_tasks(max(stations, 1), rng, uniform_in="area")
    tasks = GroundTasks(
        np.concatenate([wanted.latitude_deg, ground.latitude_deg[:stations]]),
        np.concatenate([wanted.longitude_deg, ground.longitude_deg[:stations]]),
        np.concatenate([wanted.priority, np.full(stations, _CONTACT)]),
        scattered=True,
    )
    names = [f"train {i // half} satellite {i % half}" for i in range(satellites)]
    base = constellation(ring[:, aboard], tasks, 60.0, satellite_names=names)
    length = max(1, steps // 3)
    first = rng.integers(0, steps - length + 1, targets)
    window = np.stack([first, first + length], axis=1)
    flat = base.benefits.flat()
    step = np.repeat(np.arange(steps), np.diff(flat.indptr[:: base.n]))
    inside = flat.indices < targets
    at, task = step[inside], flat.indices[inside].astype(np.int64)
    good = (window[task, 0] <= at) & (at < window[task, 1])
    seen = np.bincount(at[good] * targets + task[good], minlength=steps * targets).reshape(steps, targets)
    pair = int(np.argmax((seen >= 2).sum(axis=0)))
    return ImagingDay(base, window, pair, int(antennas))
