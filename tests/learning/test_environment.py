"""The environment: its rewards are the value of the plan, and shared conflicts are what the rule says."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from sapopt import SAP, SwitchingCost, solve
from sapopt.domains.chance import Failures
from sapopt.domains.instances import instance
from sapopt.learning import Environment, ObservationSpec
from sapopt.running.chance import play
from sapopt.solvers import HAA


@pytest.mark.parametrize("shared", [False, True])
def test_rewards_add_up_to_the_value(shared: bool) -> None:
    """For assignments both rules give the value of the plan."""
    problem = instance("constellation-toy", 1, idle_is_free=True)
    result = solve(problem, HAA())
    env = Environment(problem, conflicts_shared=shared)
    for _ in range(2):
        env.reset()
        total = sum(env.step(tasks).sum() for tasks in result.plan)
        assert env.done
        assert total == pytest.approx(result.value)
    with pytest.raises(ValueError, match="reset"):
        env.step(result.plan[0])


def test_what_it_does_not_know_is_refused() -> None:
    """Idleness would be scored as another task: told, not miscounted."""
    with pytest.raises(ValueError, match="no capacities, idleness or limits"):
        Environment(SAP(np.ones((2, 2, 2)), SwitchingCost(0.5), idle=True))


def test_conflicts() -> None:
    """Forbidden by default; if shared, q holders earn a q-th each and pay their own handover in full."""
    problem = SAP(np.array([[[4.0, 1.0, 0.2], [2.0, 0.0, 0.2]]]), SwitchingCost(0.5), [0, 1])
    with pytest.raises(ValueError, match="task 0 is given to agents 0, 1"):
        Environment(problem).step(np.array([0, 0]))
    env = Environment(problem, conflicts_shared=True)
    np.testing.assert_allclose(env.step(np.array([0, 0])), [2.0, 0.75])
    env.reset()
    np.testing.assert_allclose(env.step(np.array([2, 2])), [-0.3, -0.3])


def test_observations_follow_the_steps() -> None:
    """The environment shows the benefits of its step and what was held."""
    problem = SAP(np.arange(8.0).reshape(2, 2, 2), SwitchingCost(0.5), [0, 1])
    env = Environment(problem)
    spec = ObservationSpec(2, 1, 1, charge=False)
    before, tasks = env.observe(spec)
    np.testing.assert_array_equal(tasks, [[1, -1], [1, 0]])
    np.testing.assert_array_equal(before[:, :2], [[1, 0], [3, 2]])
    np.testing.assert_array_equal(before[:, -2:], [[0, 0], [1, 0]])
    env.step(np.array([1, 0]))
    after, _ = env.observe(spec)
    np.testing.assert_array_equal(after[:, :2], [[5, 4], [7, 6]])
    np.testing.assert_array_equal(after[:, -2:], [[1, 0], [0, 1]])


def test_chance_in_an_environment() -> None:
    """The environment draws its states: rewards are those of the same plan played by itself, and repeat by the seed."""
    problem = instance("power", 1, steps=6)
    chance = Failures(0.2)
    plan = solve(problem, HAA()).plan
    wanted = play(problem, plan, chance, 7)
    env = Environment(problem, chance=chance, seed=7)
    for _ in range(2):
        env.reset()
        np.testing.assert_array_equal([env.step(tasks) for tasks in plan], wanted.rewards)
    other = Environment(problem, chance=chance, seed=8)
    assert sum(other.step(tasks).sum() for tasks in plan) != wanted.value
