"""Constants and frames of the Earth, shared by the orbits and the ground tasks."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray

EARTH_RADIUS_KM = 6378.137
"""Radius of the spherical Earth: the equatorial radius of WGS 84, used at every latitude, as in the published code of
Holder (2024)."""

EARTH_MU_KM3_S2 = 398600.4418
"""Gravitational parameter of the Earth, WGS 84."""

EARTH_J2 = 1.08262668e-3
"""Second zonal harmonic of the Earth's field."""

EARTH_RATE_RAD_S = 7.292115e-5
"""Rotation of the Earth against the stars, WGS 84."""

_SIDEREAL_EXCESS_TURNS_PER_DAY = 8640184.812866 / 36525.0 / 86400.0


def turn_about_pole(positions_km: FloatArray, angle_rad: Any) -> FloatArray:
    """Coordinates of the same points in a frame that is turned east by `angle_rad` about the polar axis.

    Parameters
    ----------
    positions_km : ndarray, shape (T, n, 3)
    angle_rad : float or ndarray of shape (T,)
        The sidereal angle, which turns inertial into Earth-fixed coordinates.

    Returns
    -------
    ndarray, shape (T, n, 3)
    """
    angle = np.asarray(angle_rad, dtype=np.float64).reshape(-1, 1)
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = positions_km[..., 0], positions_km[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x, positions_km[..., 2]], axis=-1)


def greenwich_sidereal_rad(julian_date: Any) -> FloatArray:
    """Greenwich mean sidereal time at Julian dates (UT1), the IAU 1982 series that goes with SGP4's TEME frame."""
    date = np.asarray(julian_date, dtype=np.float64)
    days = date - 2451545.0
    century = days / 36525.0
    # The linear term is counted in turns, and the whole ones are dropped before they cost precision.
    turns = np.mod(days, 1.0) + np.mod(days * _SIDEREAL_EXCESS_TURNS_PER_DAY, 1.0)
    seconds = 67310.54841 + 0.093104 * century**2 - 6.2e-6 * century**3
    return np.mod(2 * np.pi * (turns + seconds / 86400.0), 2 * np.pi)


def sidereal_rad(time: datetime) -> float:
    """Greenwich mean sidereal time at a moment, which is UTC if it has no zone; UTC stands for UT1, within 0.9 s."""
    moment = time.replace(tzinfo=UTC) if time.tzinfo is None else time
    days = (moment - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1)
    return float(greenwich_sidereal_rad(2451545.0 + days))


def unit_vectors(latitude_deg: Any, longitude_deg: Any) -> FloatArray:
    """Earth-fixed directions of points on the ground (spherical Earth), shape (m, 3)."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    return np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)],
        axis=-1,
    )
