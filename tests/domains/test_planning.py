"""The built-in problems with limits: what each of them promises, on small sizes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sapopt import solve
from sapopt.domains.deep_space import DeepSpace, fitting_starts, random_deep_space
from sapopt.domains.imaging import imaging_day
from sapopt.domains.instances import find_instance, instance
from sapopt.domains.ride_hailing import random_waiting_city
from sapopt.domains.roster import Roster, random_roster
from sapopt.solvers import HAA, DualDecomposition

NAMES = ("imaging", "nurse-roster", "deep-space", "waiting-rides")


@pytest.mark.parametrize("name", NAMES)
def test_listed_sizes(name: str) -> None:
    """The sizes that the list tells are those of the instances."""
    problem = instance(name)
    assert find_instance(name).shape == (problem.T, problem.n, problem.m)


@pytest.mark.parametrize("name", NAMES)
def test_a_choice_that_the_rule_does_not_have_is_refused(name: str) -> None:
    """Whether idling is free is no question here, and the message says why."""
    with pytest.raises(ValueError, match="idle_is_free: there is nothing to choose here"):
        instance(name, idle_is_free=True)


def test_imaging_looks_once() -> None:
    """Each target once, within its window, in sight; the pair target by two at a step; stations within antennas."""
    day = imaging_day(1, satellites=6, targets=15, steps=100, stations=2, antennas=1)
    problem = day.problem()
    result = solve(problem, DualDecomposition(), time_limit=5)
    worth = day.constellation.benefits
    looks = np.zeros(day.targets, dtype=int)
    for k, row in enumerate(result.plan):
        for j in np.unique(row[row >= 0]):
            who = np.flatnonzero(row == j)
            seeing = worth.slice(k, k + 1).at(np.full((1, problem.n), j))[0, who] > 0
            if j >= day.targets:
                assert len(who) <= day.antennas
                continue
            assert len(who) <= (2 if j == day.pair else 1)
            inside = bool(day.window[j, 0] <= k < day.window[j, 1])
            looks[j] += int(seeing.sum()) if inside else 0
    assert (np.delete(looks, day.pair) <= 1).all()
    assert looks[day.pair] in (0, 2)
    assert looks.sum() > 0
    for policy in (HAA(),):
        problem.check_plan(solve(problem, policy).plan)


def test_imaging_team_pays_for_two() -> None:
    """Two satellites that see the pair target together earn its reward, in the value of the plan."""
    day = imaging_day(1, satellites=6, targets=30, steps=200, stations=0)
    problem = day.problem(cost=0.0)
    seen = np.array(
        [
            (day.constellation.benefits.slice(k, k + 1).at(np.full((1, 6), day.pair))[0] > 0)
            for k in range(200)
        ]
    )
    inside = (day.window[day.pair, 0] <= np.arange(200)) & (np.arange(200) < day.window[day.pair, 1])
    k = int(np.flatnonzero((seen.sum(axis=1) >= 2) & inside)[0])
    plan = np.full((200, 6), -1)
    two = np.flatnonzero(seen[k])[:2]
    plan[k, two[0]] = day.pair
    alone = problem.evaluate(plan).value
    plan[k, two[1]] = day.pair
    reward = 2.0 * day.constellation.tasks.priority[day.pair]
    assert problem.evaluate(plan).value - alone > reward
    plan[k, two[1]] = -1
    other = int(np.flatnonzero(~seen[k])[0])
    plan[k, other] = day.pair
    with pytest.raises(ValueError, match="forbidden"):
        problem.evaluate(plan)


def test_roster_keeps_its_rules() -> None:
    """No ward is short where that can be, nobody works on a day off, nor too long without a rest."""
    roster = random_roster(8, 5, 10, seed=3, in_a_row=3)
    result = solve(roster.problem(), DualDecomposition(), time_limit=8)
    plan = result.plan
    assert roster.short_of(plan) == 0
    assert (plan[roster.day_off] == -1).all()
    works = plan >= 0
    for first in range(len(plan) - 3):
        assert (works[first : first + 4].sum(axis=0) <= 3).all()
    held = np.stack([np.bincount(row[row >= 0], minlength=5) for row in plan])
    assert (held <= roster.places).all()
    assert roster.short_of(np.full_like(plan, -1)) == 50


def test_deep_space_tracks() -> None:
    """A track begins where its spacecraft stays in view; an antenna does one thing at a time; arrays begin together."""
    space = random_deep_space(5, 12, 60, seed=1, arrays=4)
    assert (space.needs == 2).any()
    problem = space.problem()
    result = solve(problem, DualDecomposition(), time_limit=8)
    assert result.value == pytest.approx(space.hours_served(result.plan), abs=0.1)
    served = np.zeros(problem.m, dtype=int)
    for i in range(problem.n):
        free = 0
        for k in np.flatnonzero(result.plan[:, i] >= 0):
            j = result.plan[k, i]
            assert space.begins[k, i, j]
            assert k >= free
            free = k + space.length[j]
            served[j] += 1
    assert (served <= space.needs).all()


def test_starts_that_fit() -> None:
    """Where a track may begin, by looking at every step of it."""
    rng = np.random.default_rng(0)
    view = rng.random((20, 2, 3)) < 0.8
    served, before = np.array([1, 3, 25]), 2
    begins = fitting_starts(view, served, before)
    for k in range(20):
        for j, length in enumerate(served):
            span = view[k + before : k + before + length, :, j]
            expected = span.all(axis=0) if len(span) == length else np.zeros(2, dtype=bool)
            np.testing.assert_array_equal(begins[k, :, j], expected)


def test_waiting_rides_are_taken_once_and_in_time() -> None:
    """Every request has one driver at most, who is there before its patience ends, and not before it comes in."""
    waiting = random_waiting_city(3, 8, 8, seed=2, width=4, patience=3)
    problem = waiting.problem()
    result = solve(problem, DualDecomposition(), time_limit=4)
    rides = waiting.taken(result.plan)
    assert rides
    requests = [request for _, request, _, _ in rides]
    assert len(set(requests)) == len(requests)
    city = waiting.city
    fares = 0.0
    for driver in range(3):
        place, free = int(city.home[driver]), 0
        for _, request, at, end in [ride for ride in rides if ride[0] == driver]:
            assert city.arrival[request] <= at <= waiting.latest[request]
            assert at >= free + city.travel[place, city.pick_up[request]] - city.patience
            fares += city.worth(0.5)[request]
            place, free = int(city.drop_off[request]), end
    assert result.value <= fares + 1e-9
    assert result.value > 0


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: imaging_day(satellites=0), "satellites must be a whole number of at least 1"),
        (lambda: imaging_day(satellites=61), "two trains of 30 have room for 60"),
        (lambda: random_roster(nurses=0), "nurses must be a whole number"),
        (lambda: random_deep_space(arrays=-1), "arrays must be a whole number"),
        (lambda: random_waiting_city(drivers=0), "drivers must be a whole number"),
        (
            lambda: Roster(np.zeros((1, 1)), np.zeros((1, 1), dtype=bool), np.ones(1, dtype=int)),
            "preference must be positive",
        ),
        (
            lambda: Roster(np.ones((2, 1)), np.zeros((1, 1), dtype=bool), np.ones(1, dtype=int)),
            "day_off must be a mask",
        ),
        (
            lambda: DeepSpace(
                np.ones((1, 1, 1), dtype=bool), np.ones(1), np.ones(1, dtype=int), np.array([2])
            ),
            "needs must be 1 numbers from 1 to 1",
        ),
    ],
)
def test_bad_numbers_are_refused(make: Any, said: str) -> None:
    """Each gets one clear line."""
    with pytest.raises(ValueError, match=said):
        make()
