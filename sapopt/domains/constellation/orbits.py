"""Walker constellations on circular orbits: positions of all satellites at all steps, vectorised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.domains.constellation.earth import (
    EARTH_J2,
    EARTH_MU_KM3_S2,
    EARTH_RADIUS_KM,
    EARTH_RATE_RAD_S,
    turn_about_pole,
)

Earth = Literal["still", "rotating"]

_HIGHEST_KM = 1e5  # beyond lies no orbit of a constellation, but many an altitude given in metres


@dataclass(frozen=True)
class WalkerShell:
    """A Walker constellation: evenly spaced planes with evenly spaced satellites, all on circular orbits.

    Satellite ``s`` of plane ``p`` starts with right ascension of the node ``p * raan_spread_deg / planes`` and argument
    of latitude ``first_latitude_argument_deg + 360 s / satellites_per_plane + 360 phasing p / (planes *
    satellites_per_plane)``. Satellites are numbered plane by plane.

    Attributes
    ----------
    planes, satellites_per_plane : int
        How many, at least 1.
    inclination_deg : float
        0 to 180.
    altitude_km : float
        Above the sphere of radius `EARTH_RADIUS_KM`.
    phasing : float
        Walker's phasing parameter F; the published code of Holder (2024) has 0, the thesis names none.
    raan_spread_deg : float
        360 for a Walker delta, 180 for a Walker star.
    first_latitude_argument_deg : float
        Argument of latitude of satellite 0 of plane 0 at time 0. The default, 180, is that of the published
        code.
    """

    planes: int
    satellites_per_plane: int
    inclination_deg: float
    altitude_km: float
    phasing: float = 0.0
    raan_spread_deg: float = 360.0
    first_latitude_argument_deg: float = 180.0

    def __post_init__(self) -> None:
        for name in ("planes", "satellites_per_plane"):
            value = getattr(self, name)
            if int(value) != value or value < 1:
                raise ValueError(f"{name} must be a whole number of at least 1, got {value}")
        if not 0.0 <= self.inclination_deg <= 180.0:
            raise ValueError(
                f"inclination_deg must lie between 0 and 180 degrees, got {self.inclination_deg}"
            )
        if not 0.0 < self.altitude_km <= _HIGHEST_KM:
            raise ValueError(
                f"altitude_km must be positive and at most {_HIGHEST_KM:g}, got {self.altitude_km}; "
                "give kilometres above the surface, not metres and not the distance to the centre"
            )
        for name in ("phasing", "raan_spread_deg", "first_latitude_argument_deg"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, got {getattr(self, name)}")

    @property
    def n(self) -> int:
        """Number of satellites."""
        return self.planes * self.satellites_per_plane


STARLINK_SHELLS = (
    WalkerShell(72, 22, 53.0, 550.0),
    WalkerShell(72, 22, 53.2, 540.0),
    WalkerShell(36, 20, 70.0, 570.0),
    WalkerShell(6, 58, 97.6, 560.0),
    WalkerShell(4, 43, 97.6, 560.0),
)
"""The five nominal shells of the first Starlink generation (FCC 21-48, April 2021): 4408 satellites."""

STARLINK_SHELLS_4225 = (*STARLINK_SHELLS[:3], WalkerShell(5, 33, 97.6, 560.0), STARLINK_SHELLS[4])
"""Five shells of 4225 satellites in all, the number of the thesis' out-of-distribution test (section 6.5).

The licence has 4408 satellites. Here the 183 that are too many are taken from the fourth shell (5 planes of 33 instead
of 6 of 58), so that the other four stay nominal: a choice of this library. The thesis has other shells at other
altitudes, see `STARLINK_SHELLS_2019`.
"""

STARLINK_SHELLS_2019 = (
    WalkerShell(32, 50, 53.0, 550.0),
    WalkerShell(32, 50, 53.8, 510.0),
    WalkerShell(8, 50, 74.0, 530.0),
    WalkerShell(5, 75, 81.0, 675.0),
    WalkerShell(6, 75, 70.0, 725.0),
)
"""The five shells of section 6.5 of Holder (2024): 4425 satellites.

The thesis takes "the nominal configuration of Starlink" from del Portillo, Cameron and Crawley (Acta Astronautica 159,
2019) and replaces its altitudes of 1150, 1110, 1130, 1275 and 1325 km by 550, 510, 530, 675 and 725 km. That
configuration has 4425 satellites, the number that the FCC approved in March 2018; the thesis writes 4225 and names no
shell that it left out.
"""


def walker_positions_km(
    shells: WalkerShell | Sequence[WalkerShell],
    steps: int,
    step_s: float,
    *,
    start_s: float = 0.0,
    earth: Earth = "rotating",
    j2: bool = False,
    sidereal_angle_deg: float = 0.0,
) -> FloatArray:
    """Earth-fixed positions of the satellites of one or more shells.

    Parameters
    ----------
    shells : WalkerShell or sequence of WalkerShell
        Their satellites are numbered one shell after the other.
    steps : int
        Number of steps T.
    step_s : float
        Seconds from one step to the next.
    start_s : float
        Time of the first step, in seconds after the shells' starting angles hold. The thesis' published code takes
        its first picture one step after that: ``start_s=step_s``.
    earth : {"rotating", "still"}
        "still" leaves the Earth at rest among the stars, as the thesis' published code does.
    j2 : bool
        Add the secular drift of node and argument of latitude due to the oblateness of the Earth (first order in J2).
    sidereal_angle_deg : float
        Angle between the inertial x axis and the Greenwich meridian at time 0.

    Returns
    -------
    ndarray of float64, shape (T, n, 3)
        Kilometres.

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    shells = (shells,) if isinstance(shells, WalkerShell) else tuple(shells)
    if not shells:
        raise ValueError("shells is empty; give at least one WalkerShell")
    if earth not in ("still", "rotating"):
        raise ValueError(f"earth must be 'still' or 'rotating', got {earth!r}")
    if not (np.isfinite(start_s) and np.isfinite(sidereal_angle_deg)):
        raise ValueError(
            f"start_s and sidereal_angle_deg must be finite, got {start_s} and {sidereal_angle_deg}"
        )
    time_s = start_s + step_times_s(steps, step_s)
    inertial = np.concatenate([_shell_positions_km(shell, time_s, j2) for shell in shells], axis=1)
    angle = np.radians(sidereal_angle_deg) + (
        EARTH_RATE_RAD_S * time_s if earth == "rotating" else 0.0 * time_s
    )
    return turn_about_pole(inertial, angle) if np.any(angle) else inertial


def step_times_s(steps: int, step_s: float) -> FloatArray:
    """Seconds since the first step, shape (T,); raises ValueError unless both arguments are positive."""
    if int(steps) != steps or steps < 1:
        raise ValueError(f"steps must be a whole number of at least 1, got {steps}")
    if not (np.isfinite(step_s) and step_s > 0):
        raise ValueError(f"step_s must be a positive number of seconds, got {step_s}")
    return step_s * np.arange(int(steps), dtype=np.float64)


def _shell_positions_km(shell: WalkerShell, time_s: FloatArray, j2: bool) -> FloatArray:
    plane, place = np.divmod(np.arange(shell.n), shell.satellites_per_plane)
    inclination = np.radians(shell.inclination_deg)
    radius = EARTH_RADIUS_KM + shell.altitude_km
    node_rate, latitude_rate = _secular_rates_rad_s(radius, inclination, j2)
    node = np.radians(plane * (shell.raan_spread_deg / shell.planes)) + node_rate * time_s[:, None]
    latitude_argument = (
        np.radians(
            shell.first_latitude_argument_deg
            + place * (360.0 / shell.satellites_per_plane)
            + plane * (360.0 * shell.phasing / shell.n)
        )
        + latitude_rate * time_s[:, None]
    )
    cos_u, sin_u = np.cos(latitude_argument), np.sin(latitude_argument)
    cos_node, sin_node = np.cos(node), np.sin(node)
    cos_i, sin_i = np.cos(inclination), np.sin(inclination)
    return radius * np.stack(
        [
            cos_node * cos_u - sin_node * cos_i * sin_u,
            sin_node * cos_u + cos_node * cos_i * sin_u,
            sin_i * sin_u,
        ],
        axis=-1,
    )


def _secular_rates_rad_s(radius_km: float, inclination_rad: float, j2: bool) -> tuple[float, float]:
    """Rates of the node and of the argument of latitude of a circular orbit, first order in J2."""
    mean_motion = np.sqrt(EARTH_MU_KM3_S2 / radius_km**3)
    if not j2:
        return 0.0, float(mean_motion)
    factor = 1.5 * EARTH_J2 * (EARTH_RADIUS_KM / radius_km) ** 2
    cos_i = np.cos(inclination_rad)
    # Perigee drift and the drift of the mean anomaly add up to (4 cos^2 i - 1) on a circular orbit.
    return float(-factor * mean_motion * cos_i), float(mean_motion * (1.0 + factor * (4.0 * cos_i**2 - 1.0)))
