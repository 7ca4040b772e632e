"""The PettingZoo and Gymnasium views: their own conformance tests, seeds, masks and rewards."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("pettingzoo")

from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test

from sapopt import SAP, SwitchingCost
from sapopt.domains.instances import instance
from sapopt.learning import ObservationSpec
from sapopt.learning.choices import legal, tasks_of
from sapopt.learning.multiagent import SAPEnv, SAPParallelEnv

SPEC = ObservationSpec(4, 3, 2, charge=False)


def problems(seed: int) -> SAP:
    """Small constellations with free idling."""
    return instance("constellation-toy", seed, idle_is_free=True, steps=4)


def test_pettingzoo_conformance() -> None:
    """PettingZoo's own tests of the interface and of seeds."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        parallel_api_test(SAPParallelEnv(problems, SPEC), num_cycles=12)
        parallel_seed_test(lambda: SAPParallelEnv(problems, SPEC), num_cycles=8)


def test_gymnasium_conformance() -> None:
    """Gymnasium's own check."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(SAPEnv(problems, SPEC), skip_render_check=True)


def test_rewards_of_a_conflict() -> None:
    """Both views pay shared conflicts, and idling where a choice is not allowed."""
    problem = SAP(
        np.array([[[4.0, 0.0, 0.0], [2.0, 0.0, 0.0]]] * 2), SwitchingCost(0.5, idle_is_free=True), [0, 1]
    )
    spec = ObservationSpec(2, 1, 1, charge=False)
    env = SAPParallelEnv(problem, spec)
    seen, _ = env.reset(seed=3)
    np.testing.assert_array_equal(seen["agent_0"]["action_mask"], [1, 0, 1])
    _, rewards, ended, truncated, _ = env.step({"agent_0": 0, "agent_1": 0})
    assert rewards == {"agent_0": 2.0, "agent_1": 0.75}
    assert not any(ended.values())
    assert not any(truncated.values())
    _, rewards, _, truncated, _ = env.step({"agent_0": 1, "agent_1": 2})
    assert rewards == {"agent_0": 0.0, "agent_1": 0.0}
    assert all(truncated.values())
    assert env.agents == []
    single = SAPEnv(problem, spec)
    _, info = single.reset(seed=3)
    assert info["action_mask"].shape == (2, 3)
    assert single.step(np.array([0, 2]))[1] == 4.0


def test_idle_agents_are_parked() -> None:
    """An idle agent takes a free task that it does not list, where there is one."""
    listed = np.array([[0, 1], [0, -1], [2, -1]])
    np.testing.assert_array_equal(legal(listed)[1], [True, False, True])
    np.testing.assert_array_equal(tasks_of(np.array([0, 0, 0]), listed, 4), [0, 0, 2])
    np.testing.assert_array_equal(tasks_of(np.array([2, 0, 2]), listed, 4), [2, 0, 1])
    np.testing.assert_array_equal(tasks_of(np.array([2, 2, 0]), listed, 3), [0, 1, 2])
    with pytest.raises(ValueError, match="agent 1 has no task in slot 1"):
        tasks_of(np.array([0, 1, 0]), listed, 4)
    with pytest.raises(ValueError, match="between 0 and 2"):
        tasks_of(np.array([0, 3, 0]), listed, 4)


def test_spec_must_fit() -> None:
    """Charges are observed where there are some, and only there."""
    with pytest.raises(ValueError, match="charge"):
        SAPParallelEnv(problems, ObservationSpec(4, 3, 2, charge=True))
