"""Ground tasks."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sapopt.domains.constellation import GroundTasks, even_tasks, random_tasks, ring_tasks
from sapopt.domains.constellation.earth import unit_vectors


@given(m=st.integers(1, 50), seed=st.integers(0, 2**32), uniform_in=st.sampled_from(["latitude", "area"]))
def test_random_tasks_keep_their_range_and_seed(m, seed, uniform_in):
    """Places and priorities are within range, and the seed decides them."""
    tasks = random_tasks(m, seed, max_latitude_deg=40.0, uniform_in=uniform_in)
    again = random_tasks(m, np.random.default_rng(seed), max_latitude_deg=40.0, uniform_in=uniform_in)
    assert tasks.m == m
    assert (np.abs(tasks.latitude_deg) <= 40.0).all()
    assert (np.abs(tasks.longitude_deg) <= 180.0).all()
    assert ((tasks.priority >= 1) & (tasks.priority <= 2)).all()
    for name in ("latitude_deg", "longitude_deg", "priority"):
        np.testing.assert_array_equal(getattr(tasks, name), getattr(again, name))


def test_area_is_uniform_on_the_sphere():
    """Drawn by area, half of the tasks lie within 30 degrees of the equator."""
    tasks = random_tasks(20000, 1, max_latitude_deg=90.0, uniform_in="area")
    assert np.mean(np.abs(tasks.latitude_deg) < 30.0) == pytest.approx(0.5, abs=0.02)


def test_priorities_from_a_list():
    """Priorities {1, 1, 1, 5} of section 6.4: a quarter of the tasks count five."""
    tasks = random_tasks(20000, 3, priorities=(1, 1, 1, 5))
    assert set(np.unique(tasks.priority)) == {1.0, 5.0}
    assert np.mean(tasks.priority == 5.0) == pytest.approx(0.25, abs=0.02)


def test_even_tasks_are_812_and_even():
    """The thesis' number of even tasks, none nearer to another than most of the spacing."""
    tasks = even_tasks()
    assert tasks.m == 812
    directions = unit_vectors(tasks.latitude_deg, tasks.longitude_deg)
    cosines = directions @ directions.T - 2 * np.eye(tasks.m)
    nearest = np.degrees(np.arccos(cosines.max(axis=1)))
    assert nearest.min() > 6.9
    assert nearest.max() < 8.0
    np.testing.assert_allclose(directions.sum(axis=0), 0.0, atol=1e-9)


@given(spacing=st.floats(3, 60), highest=st.floats(30, 90))
@example(spacing=60.0, highest=30.0)
@example(spacing=60.0, highest=90.0)
def test_even_tasks_stay_below_the_limit(spacing, highest):
    """Rings lie within the limit, symmetric about the equator."""
    tasks = even_tasks(spacing, highest)
    assert np.abs(tasks.latitude_deg).max() <= highest
    np.testing.assert_allclose(np.sort(tasks.latitude_deg), -np.sort(tasks.latitude_deg)[::-1])


def test_idle_tasks_are_worth_nothing():
    """Idle tasks come last and have priority 0."""
    tasks = even_tasks().with_idle_tasks(188)
    assert tasks.m == 1000
    assert (tasks.priority[812:] == 0).all()
    assert (tasks.priority[:812] > 0).all()


@pytest.mark.parametrize(("m", "highest", "rings"), [(812, 70.0, 21), (21, 70.0, 21), (50, 30.0, 4)])
def test_ring_tasks(m, highest, rings):
    """As many as asked for, the outermost rings at the limit, in proportion to the rings' length, north as south."""
    tasks = ring_tasks(m, highest, rings)
    latitudes, counts = np.unique(tasks.latitude_deg, return_counts=True)
    assert tasks.m == m
    np.testing.assert_allclose(latitudes, np.linspace(-highest, highest, rings))
    assert abs(counts - counts[::-1]).max() <= 1
    length = np.cos(np.radians(latitudes))
    assert abs(counts - (1 + (m - rings) * length / length.sum())).max() < 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: random_tasks(0), "m must"),
        (lambda: random_tasks(3, max_latitude_deg=91), "max_latitude_deg"),
        (lambda: random_tasks(3, uniform_in="volume"), "uniform_in"),
        (lambda: random_tasks(3, priorities=()), "priorities"),
        (lambda: random_tasks(3, priorities=(1, -1)), "priorities"),
        (lambda: even_tasks(0.0), "spacing_deg"),
        (lambda: even_tasks(7.0, 0.0), "max_latitude_deg"),
        (lambda: even_tasks().with_idle_tasks(-1), "count"),
        (lambda: ring_tasks(10), "m must be"),
        (lambda: ring_tasks(rings=1), "rings"),
        (lambda: ring_tasks(max_latitude_deg=90.0), "max_latitude_deg"),
        (lambda: GroundTasks([100.0], [0.0], [1.0]), "exchanged"),
        (lambda: GroundTasks([10.0], [0.0], [-1.0]), "priority must not be negative"),
        (lambda: GroundTasks([10.0, 0.0], [0.0], [1.0]), "longitude_deg"),
        (lambda: GroundTasks([10.0], [np.nan], [1.0]), "NaN"),
        (lambda: GroundTasks([], [], []), "empty"),
    ],
)
def test_bad_tasks(call, message):
    """Impossible tasks are refused by the name of the argument."""
    with pytest.raises(ValueError, match=message):
        call()
