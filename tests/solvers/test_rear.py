"""Windows behind the front of rolling windows."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from switching_problems import walking

from sapopt.running.rollout import rollout
from sapopt.solvers import HAA
from sapopt.solvers.dual_decomposition.network_plans import rear as module
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.rear import Rear


def test_it_improves_what_lies_behind_and_nothing_else() -> None:
    """The steps before the front get better, the last of them and those after it stay as they are."""
    problem = walking(0, T=40, cost=1.0)
    arrays, start = Arrays.of(problem), rollout(problem, HAA()).plan
    front = 25
    with Rear(arrays, np.zeros((problem.T, problem.m)), np.random.default_rng(0), lambda: math.inf) as rear:
        plan = rear.joined(start, front)
        np.testing.assert_array_equal(plan, start)
        end = time.monotonic() + 30.0
        while arrays.value(plan) <= arrays.value(start) and time.monotonic() < end:
            time.sleep(0.01)
            plan = rear.joined(start, front)
    assert arrays.value(plan) > arrays.value(start)
    np.testing.assert_array_equal(plan[front - 1 :], start[front - 1 :])
    assert all(len(np.unique(row)) == problem.n for row in plan)


def test_what_the_front_did_meanwhile_is_kept() -> None:
    """What is joined are the steps before the last front; those after it are the front's."""
    problem = walking(1, T=40, cost=1.0)
    arrays, start = Arrays.of(problem), rollout(problem, HAA()).plan
    other = start.copy()
    other[20:] = start[20:, ::-1]
    with Rear(arrays, np.zeros((problem.T, problem.m)), np.random.default_rng(0), lambda: math.inf) as rear:
        rear.joined(start, 20)
        plan = rear.joined(other, 30)
    np.testing.assert_array_equal(plan[19:], other[19:])


def test_what_goes_wrong_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of the thread is raised at the end, and does not end in silence."""

    def wrong(*_: object) -> None:
        raise ArithmeticError("wrong")

    def until_it_ended(rear: Rear) -> None:
        with rear:
            rear.joined(start, 30)
            end = time.monotonic() + 30.0
            while not rear._job.done() and time.monotonic() < end:
                time.sleep(0.01)

    monkeypatch.setattr(module, "improve_window", wrong)
    problem = walking(2, T=40)
    start = rollout(problem, HAA()).plan
    rear = Rear(Arrays.of(problem), np.zeros((40, problem.m)), np.random.default_rng(0), lambda: math.inf)
    with pytest.raises(ArithmeticError, match="wrong"):
        until_it_ended(rear)


def test_without_time_it_does_nothing() -> None:
    """It ends by itself, and the plan is what it was."""
    problem = walking(2, T=40)
    start = rollout(problem, HAA()).plan
    with Rear(Arrays.of(problem), np.zeros((40, problem.m)), np.random.default_rng(0), lambda: 0.0) as rear:
        rear.joined(start, 30)
        time.sleep(0.05)
        np.testing.assert_array_equal(rear.joined(start, 30), start)
