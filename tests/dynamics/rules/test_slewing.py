"""Slew costs: angles from the geometry of each step, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sapopt import SAP, SwitchingCost, solve
from sapopt.dynamics import SlewCost
from sapopt.dynamics.rules.slewing import angle_rad
from sapopt.solvers import HAA, HAAL

# One satellite flies along x at z = 10, over targets on the plane z = 5; the centre of the Earth is below at 0.
TARGETS = np.array([[0.0, 0.0, 5.0], [5.0, 0.0, 5.0]])
SATELLITE = np.array([[[0.0, 0.0, 10.0]], [[5.0, 0.0, 10.0]], [[5.0, 5.0, 10.0]]])
QUARTER = np.pi / 4


def problem(benefits: np.ndarray, initial: list[int] | None = None, cost: float = 1.0) -> SAP:
    return SAP(benefits, SlewCost(cost, SATELLITE, TARGETS), initial)


def test_angles_change_with_the_geometry() -> None:
    """Task 0 to task 1 is 45 degrees at either step, from other places: 0 degrees is free, a third step differs."""
    seen = np.zeros((3, 1, 3))
    seen[:, 0, :2] = 1.0
    here = problem(seen, [0])
    assert here.evaluate([[0], [0], [0]]).value == pytest.approx(3.0)  # following a task is free
    assert here.evaluate([[1], [1], [1]]).value == pytest.approx(3.0 - QUARTER)
    assert here.evaluate([[0], [1], [1]]).value == pytest.approx(3.0 - QUARTER)
    # At the last step both targets are 5 to the side: directions (-5,-5,-5) and (0,-5,-5).
    cosine = 50.0 / np.sqrt(75.0 * 50.0)
    assert here.evaluate([[0], [0], [1]]).value == pytest.approx(3.0 - np.arccos(cosine))


def test_idle_returns_to_nadir() -> None:
    """After idling the satellite turns from nadir, which costs the off-nadir angle."""
    seen = np.zeros((3, 1, 3))
    seen[:, 0, :2] = 1.0
    here = problem(seen, [0])
    down = angle_rad(-SATELLITE[2], TARGETS[:1] - SATELLITE[2])[0]
    assert here.evaluate([[0], [2], [0]]).value == pytest.approx(2.0 - down)
    # A task that is not seen counts as idling, and so does an initial task that is not seen.
    seen[0] = 0.0
    assert problem(seen, [1]).evaluate([[2], [0], [0]]).value == pytest.approx(
        2.0 - angle_rad(-SATELLITE[1], TARGETS[:1] - SATELLITE[1])[0]
    )


def test_first_step_without_a_past_is_free() -> None:
    seen = np.zeros((3, 1, 3))
    seen[:, 0, :2] = 1.0
    assert problem(seen).evaluate([[1], [1], [1]]).value == pytest.approx(3.0)


def test_without_cost_it_is_stepwise_assignment() -> None:
    rng = np.random.default_rng(0)
    benefits = np.zeros((3, 1, 3))
    benefits[:, :, :2] = rng.random((3, 1, 2))
    free = problem(benefits, [0], cost=0.0)
    assert solve(free, HAA()).value == pytest.approx(solve(SAP(benefits, SwitchingCost(0.0)), HAA()).value)
    assert solve(free, HAAL(3)).value == pytest.approx(benefits.max(axis=2).sum())


@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6))
def test_angle_is_a_metric(numbers: list[float]) -> None:
    shift = np.eye(2, 3) * 2.0
    a, b = shift[0] + numbers[:3], shift[1] + numbers[3:]
    assert angle_rad(a, a) == 0.0
    assert angle_rad(a, b) == angle_rad(b, a)
    assert 0.0 <= angle_rad(a, b) <= np.pi
    assert angle_rad(a, -a) == pytest.approx(np.pi)
    assert angle_rad(3.0 * a, b) == pytest.approx(angle_rad(a, b))


@pytest.mark.parametrize(
    ("cost", "satellites", "targets", "message"),
    [
        (-1.0, SATELLITE, TARGETS, "cost must be"),
        (np.eye(3), SATELLITE, TARGETS, "cost must be"),
        (1.0, SATELLITE[0], TARGETS, "satellites_km must be"),
        (1.0, SATELLITE, TARGETS[0], "targets_km must be"),
        (1.0, SATELLITE * np.nan, TARGETS, "satellites_km must be"),
        (1.0, SATELLITE[:2], TARGETS, "satellites_km has shape"),
        (1.0, SATELLITE, TARGETS[:1], "targets_km has 1 places"),
    ],
)
def test_bad_input(cost: object, satellites: np.ndarray, targets: np.ndarray, message: str) -> None:
    benefits = np.zeros((3, 1, 3))
    benefits[:, :, :2] = 1.0
    with pytest.raises(ValueError, match=message):
        SAP(benefits, SlewCost(cost, satellites, targets))  # type: ignore[arg-type]


def test_negative_benefits_are_refused() -> None:
    with pytest.raises(ValueError, match="benefits must not be negative"):
        problem(-np.ones((3, 1, 2)))
