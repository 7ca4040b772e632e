"""Field of view: the reference instance, and sparse against brute force."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt.domains.constellation import (
    FieldOfView,
    GroundTasks,
    WalkerShell,
    random_tasks,
    visible_benefits,
    walker_positions_km,
)
from sapopt.domains.constellation.earth import EARTH_RADIUS_KM, unit_vectors

MID = Path(__file__).parents[1] / "data" / "mid.npz"


def brute_force(positions, tasks, view):
    """Benefits by the words of eq. 4.1: angles of all pairs, from the triangle satellite, task, Earth's centre."""
    ground = EARTH_RADIUS_KM * unit_vectors(tasks.latitude_deg, tasks.longitude_deg)
    sight = ground - positions[:, :, None, :]
    up = np.einsum("knj,mj->knm", positions, ground) / np.linalg.norm(ground, axis=1)
    nadir = -np.einsum("knj,knmj->knm", positions, sight) / np.linalg.norm(positions, axis=2)[:, :, None]
    angle = np.arccos(np.clip(nadir / np.linalg.norm(sight, axis=3), -1, 1))
    above_horizon = up >= EARTH_RADIUS_KM
    return tasks.priority * np.where(above_horizon, view.proximity(angle), 0.0)


@pytest.fixture(scope="module")
def mid():
    """The reference instance, in the order of the flat CSR."""
    with np.load(MID) as file:
        data = dict(file)
    order = np.lexsort((data["task"], data["agent"], data["step"]))
    for name in ("step", "agent", "task", "benefit"):
        data[name] = data[name][order]
    return data


def test_reference_positions(mid):
    """The default convention gives the reference positions to the last digit of their single precision."""
    positions = walker_positions_km(WalkerShell(18, 18, 58.0, 550.0), 93, 60.0, start_s=60.0, earth="still")
    np.testing.assert_allclose(positions, mid["satellite_position_km"], atol=5e-4)


def test_reference_benefits_are_priority_times_proximity(mid):
    """At the reference positions, each benefit over its proximity is one priority in [1, 2] per task."""
    positions = walker_positions_km(WalkerShell(18, 18, 58.0, 550.0), 93, 60.0, start_s=60.0, earth="still")
    tasks = GroundTasks(mid["task_lat_deg"], mid["task_lon_deg"], np.ones(450))
    flat = visible_benefits(positions, tasks).flat()
    assert len(flat.data) == 120458
    rows = np.repeat(np.arange(93 * 324), np.diff(flat.indptr))
    np.testing.assert_array_equal(rows, mid["step"].astype(int) * 324 + mid["agent"])
    np.testing.assert_array_equal(flat.indices, mid["task"])
    priority = mid["benefit"] / flat.data
    lowest, highest = np.full(450, np.inf), np.full(450, -np.inf)
    np.minimum.at(lowest, flat.indices, priority)
    np.maximum.at(highest, flat.indices, priority)
    np.testing.assert_allclose(highest, lowest, rtol=1e-9)
    assert lowest.min() >= 1.0
    assert highest.max() <= 2.0


views = st.builds(FieldOfView, st.floats(1, 89), st.floats(0.01, 0.9))


@settings(max_examples=60)
@given(
    view=views,
    altitude=st.floats(200, 5000),
    inclination=st.floats(0, 180),
    seed=st.integers(0, 1000),
    idle=st.integers(0, 3),
)
def test_sparse_equals_brute_force(view, altitude, inclination, seed, idle):
    """The band search finds what the angles of all pairs give, in sorted rows without zeros."""
    positions = walker_positions_km(WalkerShell(3, 4, inclination, altitude), 3, 700.0, earth="rotating")
    tasks = random_tasks(60, seed, max_latitude_deg=90.0, uniform_in="area").with_idle_tasks(idle)
    benefits = visible_benefits(positions, tasks, view)
    flat = benefits.flat()
    assert benefits.is_sparse
    assert (flat.data > 0).all()
    starts = np.zeros(len(flat.indices), dtype=bool)
    starts[flat.indptr[:-1][np.diff(flat.indptr) > 0]] = True
    assert (np.diff(flat.indices)[~starts[1:]] > 0).all()
    np.testing.assert_allclose(benefits.dense(), brute_force(positions, tasks, view), atol=1e-9)


def test_tasks_at_the_poles_and_below_the_satellite():
    """Poles and the date line are no special places; straight below the proximity is 1."""
    tasks = GroundTasks([90.0, -90.0, 0.0, 0.0], [0.0, 77.0, 180.0, -180.0], [1.0, 1.0, 2.0, 2.0])
    positions = 7000.0 * np.array([[[0, 0, 1], [0, 0, -1], [-1, 0, 0], [1, 0, 0]]], dtype=float)
    expected = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 2, 2], [0, 0, 0, 0]]
    np.testing.assert_allclose(visible_benefits(positions, tasks).step(0).toarray(), expected, atol=1e-12)


def test_proximity_at_the_edge():
    """1 at the nadir, the edge value on the edge, 0 beyond it."""
    view = FieldOfView()
    edge = np.radians(60.0)
    np.testing.assert_allclose(view.proximity([0.0, edge, edge + 1e-9]), [1.0, 0.05, 0.0])
    assert view.footprint_rad(1.5 * EARTH_RADIUS_KM) == pytest.approx(np.arccos(1 / 1.5))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: FieldOfView(90.0), "half_angle_deg"),
        (lambda: FieldOfView(0.0), "half_angle_deg"),
        (lambda: FieldOfView(60.0, 1.0), "edge_proximity"),
        (lambda: visible_benefits(np.zeros((2, 3)), random_tasks(3)), "shape"),
        (lambda: visible_benefits(np.full((1, 1, 3), np.nan), random_tasks(3)), "satellite 0 at step 0"),
        (lambda: visible_benefits(np.full((1, 1, 3), 10.0), random_tasks(3)), "below the ground"),
    ],
)
def test_bad_views(call, message):
    """Impossible angles and positions are refused by the name of the argument."""
    with pytest.raises(ValueError, match=message):
        call()
