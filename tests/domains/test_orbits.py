"""Walker constellations and the Earth's frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sapopt.domains.constellation import (
    STARLINK_SHELLS,
    STARLINK_SHELLS_4225,
    WalkerShell,
    walker_positions_km,
)
from sapopt.domains.constellation.earth import (
    EARTH_MU_KM3_S2,
    EARTH_RADIUS_KM,
    EARTH_RATE_RAD_S,
    greenwich_sidereal_rad,
)

shells = st.builds(
    WalkerShell,
    planes=st.integers(1, 6),
    satellites_per_plane=st.integers(1, 6),
    inclination_deg=st.floats(0, 180),
    altitude_km=st.floats(200, 36000),
    phasing=st.integers(0, 5),
)


@given(shell=shells, earth=st.sampled_from(["still", "rotating"]), j2=st.booleans())
def test_orbits_are_circles_within_their_inclination(shell, earth, j2):
    """Every satellite keeps its radius and never leaves the latitudes of its inclination."""
    positions = walker_positions_km(shell, 12, 500.0, earth=earth, j2=j2)
    assert positions.shape == (12, shell.n, 3)
    radius = EARTH_RADIUS_KM + shell.altitude_km
    np.testing.assert_allclose(np.linalg.norm(positions, axis=2), radius, rtol=1e-12)
    assert (
        np.abs(positions[..., 2]).max()
        <= radius * np.sin(np.radians(shell.inclination_deg)) * (1 + 1e-9) + 1e-6
    )


@given(shell=shells, j2=st.booleans())
def test_planes_are_turned_copies(shell, j2):
    """Without phasing, the next plane is the last one turned about the pole by the spacing of the nodes."""
    shell = WalkerShell(shell.planes, shell.satellites_per_plane, shell.inclination_deg, shell.altitude_km)
    positions = walker_positions_km(shell, 5, 300.0, earth="still", j2=j2)
    angle = 2 * np.pi / shell.planes
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    planes = positions.reshape(5, shell.planes, shell.satellites_per_plane, 3)
    np.testing.assert_allclose(planes @ turn.T, np.roll(planes, -1, axis=1), atol=1e-6)


def test_phasing_shifts_neighbouring_planes():
    """With phasing F the next plane is ahead by F / n of a turn; F = planes is a whole place."""
    plain = walker_positions_km(WalkerShell(3, 4, 50.0, 600.0), 2, 60.0, earth="still").reshape(2, 3, 4, 3)
    shifted = walker_positions_km(WalkerShell(3, 4, 50.0, 600.0, phasing=3), 2, 60.0, earth="still").reshape(
        2, 3, 4, 3
    )
    np.testing.assert_allclose(shifted[:, 1], np.roll(plain[:, 1], -1, axis=1), atol=1e-9)


def test_period_and_rotating_earth():
    """After one period the satellite is back among the stars, and the Earth has turned below it."""
    shell = WalkerShell(1, 1, 40.0, 550.0)
    period = 2 * np.pi * np.sqrt((EARTH_RADIUS_KM + 550.0) ** 3 / EARTH_MU_KM3_S2)
    still = walker_positions_km(shell, 2, period, earth="still")
    np.testing.assert_allclose(still[1], still[0], atol=1e-6)
    turning = walker_positions_km(shell, 2, period, earth="rotating")[:, 0]
    longitude = np.arctan2(turning[:, 1], turning[:, 0])
    # At a node, where the drift of the longitude over the ground is due to the Earth alone.
    assert np.mod(longitude[0] - longitude[1], 2 * np.pi) == pytest.approx(EARTH_RATE_RAD_S * period)


def test_j2_rates_match_the_literature():
    """The sun-synchronous orbit at 600 km: 97.79 degrees of inclination give 360 degrees a year."""
    from sapopt.domains.constellation.orbits import _secular_rates_rad_s

    node, latitude = _secular_rates_rad_s(EARTH_RADIUS_KM + 600.0, np.radians(97.787), True)
    assert np.degrees(node) * 86400 * 365.2422 == pytest.approx(360.0, rel=1e-3)
    unperturbed = _secular_rates_rad_s(EARTH_RADIUS_KM + 600.0, np.radians(97.787), False)
    assert unperturbed[0] == 0.0
    assert latitude / unperturbed[1] == pytest.approx(
        1 - 1.5 * 1.08263e-3 * (6378.137 / 6978.137) ** 2 * 0.9266, rel=1e-6
    )


def test_shells_follow_one_another():
    """Several shells are numbered one after the other, and the Starlink shells have their documented sizes."""
    assert sum(s.n for s in STARLINK_SHELLS) == 4408
    assert sum(s.n for s in STARLINK_SHELLS_4225) == 4225
    both = walker_positions_km(STARLINK_SHELLS[2:4], 2, 60.0)
    np.testing.assert_array_equal(both[:, 720:], walker_positions_km(STARLINK_SHELLS[3], 2, 60.0))


def test_sidereal_time_of_known_dates():
    """Greenwich mean sidereal time of two textbook dates (Meeus 12.a: 13h10m46.3668s; Vallado 3-5: 152.578788 deg)."""
    meeus = 2446895.5
    assert np.degrees(greenwich_sidereal_rad(meeus)) == pytest.approx(197.693195, abs=1e-5)
    assert np.degrees(greenwich_sidereal_rad(2448855.009722)) == pytest.approx(152.578788, abs=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"altitude_km": -1.0}, "altitude_km must be positive"),
        ({"altitude_km": 550000.0}, "kilometres"),
        ({"altitude_km": float("nan")}, "altitude_km"),
        ({"inclination_deg": 181.0}, "inclination_deg"),
        ({"planes": 0}, "planes"),
        ({"satellites_per_plane": 2.5}, "satellites_per_plane"),
        ({"phasing": float("inf")}, "phasing"),
    ],
)
def test_bad_shells(change, message):
    """Impossible shells are refused by the name of the argument."""
    with pytest.raises(ValueError, match=message):
        WalkerShell(
            **(
                {"planes": 2, "satellites_per_plane": 2, "inclination_deg": 50.0, "altitude_km": 550.0}
                | change
            )
        )


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((WalkerShell(2, 2, 50, 550), 0, 60.0), {}, "steps"),
        ((WalkerShell(2, 2, 50, 550), 3, 0.0), {}, "step_s"),
        (((), 3, 60.0), {}, "shells is empty"),
        ((WalkerShell(2, 2, 50, 550), 3, 60.0), {"earth": "flat"}, "'still' or 'rotating'"),
        ((WalkerShell(2, 2, 50, 550), 3, 60.0), {"start_s": np.nan}, "start_s"),
    ],
)
def test_bad_positions(arguments, options, message):
    """Impossible steps and settings are refused by the name of the argument."""
    with pytest.raises(ValueError, match=message):
        walker_positions_km(*arguments, **options)
