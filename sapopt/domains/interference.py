"""Beams that disturb each other: neighbouring ground tasks served at the same time lose (Holder 2024, section 7.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.constellation.earth import EARTH_RADIUS_KM, unit_vectors

if TYPE_CHECKING:
    from sapopt.domains.constellation import Constellation
    from sapopt.plotting.aboard import Aboard
    from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class DisturbedBeams:
    """A constellation in which tasks closer than `reach_km` disturb each other.

    Attributes
    ----------
    constellation : Constellation
    reach_km : float
        Distance on the ground from which on there is no interference.
    strength : float
        Loss of two tasks at the same place; it falls linearly to zero at `reach_km`.
    """

    constellation: Constellation
    reach_km: float = 600.0
    strength: float = 0.8

    def __post_init__(self) -> None:
        for name in ("reach_km", "strength"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be a positive number, got {getattr(self, name)!r}")

    def neighbours(self) -> tuple[IntArray, FloatArray]:
        """Pairs (P, 2) of tasks of positive priority that disturb each other, and their losses (P,)."""
        tasks = self.constellation.tasks
        useful = np.flatnonzero(tasks.priority > 0)
        places = unit_vectors(tasks.latitude_deg[useful], tasks.longitude_deg[useful])
        chord = 2.0 * np.sin(min(self.reach_km / EARTH_RADIUS_KM, np.pi) / 2.0)
        pairs = cKDTree(places).query_pairs(chord, output_type="ndarray")
        pairs = pairs[np.lexsort(pairs.T[::-1])].astype(np.int64).reshape(-1, 2)
        apart = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1)
        distance_km = 2.0 * np.arcsin(np.minimum(apart / 2.0, 1.0)) * EARTH_RADIUS_KM
        loss = self.strength * np.maximum(1.0 - distance_km / self.reach_km, 0.0)
        return useful[pairs], loss

    def on_earth(self) -> Aboard:
        """Every agent is a satellite of the constellation."""
        from sapopt.plotting.aboard import every_satellite

        return every_satellite(self.constellation)

    def problem(self, cost: Any = 0.5, *, idle_is_free: bool = False) -> SAP:
        """The sequential assignment problem with the losses of neighbours."""
        from sapopt.dynamics import Interference

        pairs, loss = self.neighbours()
        return self.constellation.problem(dynamics=Interference(pairs, loss, cost, idle_is_free))
