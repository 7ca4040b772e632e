"""What a satellite sees: the field of view of eq. 4.1 and the sparse benefits it gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.domains.constellation.earth import EARTH_RADIUS_KM, unit_vectors

if TYPE_CHECKING:
    from sapopt.data.benefits import Benefits
    from sapopt.domains.constellation.tasks import GroundTasks


@dataclass(frozen=True)
class FieldOfView:
    """Field of view of every satellite, eq. 4.1: a cone about the nadir, best in the middle.

    The proximity of a task seen at the off-nadir angle theta is ``exp(-theta^2 / (2 sigma^2))``, where sigma makes it
    `edge_proximity` on the edge of the cone; it is 0 outside of the cone and below the horizon.

    Attributes
    ----------
    half_angle_deg : float
        Largest off-nadir angle, above 0 and below 90. The thesis uses 60.
    edge_proximity : float
        Proximity at that angle, above 0 and below 1. The thesis uses 0.05.
    """

    half_angle_deg: float = 60.0
    edge_proximity: float = 0.05

    def __post_init__(self) -> None:
        if not 0.0 < self.half_angle_deg < 90.0:
            raise ValueError(
                f"half_angle_deg must lie above 0 and below 90 degrees, got {self.half_angle_deg}; "
                "it is half the opening angle of the field of view, counted from the nadir"
            )
        if not 0.0 < self.edge_proximity < 1.0:
            raise ValueError(f"edge_proximity must lie above 0 and below 1, got {self.edge_proximity}")

    @property
    def half_angle_rad(self) -> float:
        """Largest off-nadir angle in radians."""
        return float(np.radians(self.half_angle_deg))

    @property
    def sigma_rad(self) -> float:
        """Standard deviation sigma of eq. 4.1 in radians."""
        return float(self.half_angle_rad / np.sqrt(-2.0 * np.log(self.edge_proximity)))

    def proximity(self, off_nadir_rad: Any) -> FloatArray:
        """Proximity of tasks above the horizon at these off-nadir angles (any shape)."""
        angle = np.asarray(off_nadir_rad, dtype=np.float64)
        return np.where(angle <= self.half_angle_rad, np.exp(-0.5 * (angle / self.sigma_rad) ** 2), 0.0)

    def footprint_rad(self, radius_km: Any) -> FloatArray:
        """Largest angle at the Earth's centre between a satellite at `radius_km` from there and a task it sees."""
        sine = np.asarray(radius_km, dtype=np.float64) * np.sin(self.half_angle_rad) / EARTH_RADIUS_KM
        edge = np.arcsin(np.minimum(sine, 1.0)) - self.half_angle_rad
        # Where the cone is wider than the Earth's disc, the horizon is the limit.
        return np.where(sine <= 1.0, edge, np.arccos(EARTH_RADIUS_KM / np.asarray(radius_km)))


def visible_benefits(
    positions_km: FloatArray, tasks: GroundTasks, field_of_view: FieldOfView | None = None
) -> Benefits:
    """Benefits priority x proximity of all satellites for all tasks at all steps, sparse (eq. 4.1).

    No array of n x m entries is made: tasks are sorted by latitude once, and a satellite looks only at the band of
    latitudes it can see.

    Parameters
    ----------
    positions_km : ndarray, shape (T, n, 3)
        Earth-fixed positions.
    tasks : GroundTasks
    field_of_view : FieldOfView, optional
        The thesis' field of view if omitted.

    Returns
    -------
    Benefits
        Sparse, shape (T, n, m). Tasks of priority 0 are never stored.

    Raises
    ------
    ValueError
        If the positions have the wrong shape, are not finite, or lie below the ground.
    """
    from sapopt.data.benefits import Benefits
    from sapopt.domains.constellation import view_kernels  # compiled code: imported when it is needed

    positions = checked_positions(positions_km)
    view = FieldOfView() if field_of_view is None else field_of_view
    useful = np.flatnonzero(tasks.priority > 0.0)
    ground = unit_vectors(tasks.latitude_deg[useful], tasks.longitude_deg[useful])
    south_to_north = np.argsort(ground[:, 2], kind="stable")
    radius = np.linalg.norm(positions, axis=2)
    shape = (positions.shape[0], positions.shape[1], tasks.m)
    if radius.min() <= EARTH_RADIUS_KM:
        step, satellite = np.argwhere(radius <= EARTH_RADIUS_KM)[0]
        raise ValueError(
            f"positions_km: satellite {satellite} is below the ground at step {step}; positions are kilometres "
            "from the Earth's centre"
        )
    footprint = view.footprint_rad(radius)
    indptr, order = view_kernels.visible_tasks(
        positions.reshape(-1, 3),
        footprint.ravel(),
        np.ascontiguousarray(ground[south_to_north]),
        south_to_north,
    )
    data = view_kernels.proximities(
        positions.reshape(-1, 3), ground, indptr, order, EARTH_RADIUS_KM, view.half_angle_rad, view.sigma_rad
    )
    data *= tasks.priority[useful][order]
    return Benefits.from_flat(indptr, useful.astype(np.int32)[order], data, shape)


def checked_positions(positions_km: Any) -> FloatArray:
    """Positions as a contiguous float64 array of shape (T, n, 3); raises ValueError if they cannot be that."""
    positions = np.ascontiguousarray(positions_km, dtype=np.float64)
    if positions.ndim != 3 or positions.shape[2] != 3 or 0 in positions.shape:
        raise ValueError(f"positions_km must have shape (T, n, 3), got {positions.shape}")
    if not np.isfinite(positions).all():
        step, satellite, _ = np.argwhere(~np.isfinite(positions))[0]
        raise ValueError(f"positions_km holds NaN or infinity for satellite {satellite} at step {step}")
    return positions
