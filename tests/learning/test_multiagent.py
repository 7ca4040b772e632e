"""The PettingZoo and Gymnasium views: their own conformance tests, seeds, masks and rewards."""

from __future__ import annotations

import pickle
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
    _, rewards, ended, truncated, _ = env.step({"agent_0": 1, "agent_1": 2})
    assert rewards == {"agent_0": 0.0, "agent_1": 0.0}
    assert all(ended.values())
    assert not any(truncated.values())
    assert env.agents == []
    single = SAPEnv(problem, spec)
    _, info = single.reset(seed=3)
    assert info["action_mask"].shape == (2, 3)
    assert single.step(np.array([0, 2]))[1:4] == (4.0, False, False)
    assert single.step(np.array([2, 2]))[2:4] == (True, False)


def test_masks_are_the_callers_own() -> None:
    """Writing into what an environment handed out changes neither rewards nor what it hands out later."""
    clean, used = (SAPParallelEnv(problems, SPEC) for _ in range(2))
    total = []
    forbidden = 0
    for env in (clean, used):
        seen, _ = env.reset(seed=5)
        rewards = []
        while env.agents:
            # The first slot that the mask forbids, where there is one: a mask that was opened must not allow it.
            actions = {a: int(np.argmin(seen[a]["action_mask"])) for a in env.agents}
            forbidden += sum(not seen[a]["action_mask"][slot] for a, slot in actions.items())
            if env is used:
                for one in seen.values():
                    one["action_mask"][:] = 1
                    one["observation"][:] = 7.0
            seen, gained, *_ = env.step(actions)
            rewards.append(gained)
        total.append(rewards)
    assert forbidden > 10
    assert total[0] == total[1]
    single, other = SAPEnv(problems, SPEC), SAPEnv(problems, SPEC)
    mask = single.reset(seed=5)[1]["action_mask"]
    opened = other.reset(seed=5)[1]["action_mask"]
    opened[:] = 1
    assert single.step(mask.argmin(axis=1))[1] == other.step(mask.argmin(axis=1))[1]


def parallel_rewards(env: SAPParallelEnv, seen: dict, steps: int) -> list:
    """Rewards of the next steps of agents that take their first slot."""
    out = []
    for _ in range(steps):
        seen, gained, *_ = env.step({a: int(np.argmax(seen[a]["action_mask"])) for a in env.agents})
        out.append(gained)
    return out


@pytest.mark.parametrize("made", [problems, problems(0)], ids=["callable", "problem"])
def test_pickling(made: SAP) -> None:
    """An environment goes to a worker and back in the middle of an episode, and plays on as the one that stayed."""
    env = SAPParallelEnv(made, SPEC)
    pickle.loads(pickle.dumps(env)).reset(seed=1)
    seen, _ = env.reset(seed=1)
    parallel_rewards(env, seen, 1)
    copy = pickle.loads(pickle.dumps(env))
    assert parallel_rewards(copy, copy._seen(), 3) == parallel_rewards(env, env._seen(), 3)
    single = SAPEnv(made, SPEC)
    single.reset(seed=1)
    twin = pickle.loads(pickle.dumps(single))
    action = np.full(env._played.n, SPEC.tasks)
    assert twin.step(action)[1] == single.step(action)[1]


def test_render_mode() -> None:
    """Wrappers such as SuperSuit's ask for it."""
    assert SAPParallelEnv(problems, SPEC).render_mode is None
    assert SAPEnv(problems, SPEC).render_mode is None


def test_clear_words() -> None:
    """Steps before the start and after the end, missing agents, strangers, and what is no slot: each told as it is."""
    problem = SAP(np.ones((1, 2, 3)), SwitchingCost(0.5, idle_is_free=True))
    spec = ObservationSpec(2, 1, 1, charge=False)
    env, single = SAPParallelEnv(problem, spec), SAPEnv(problem, spec)
    both = {"agent_0": 0, "agent_1": np.int64(1)}
    with pytest.raises(ValueError, match=r"no episode yet; call reset\(\) first"):
        env.step(both)
    with pytest.raises(ValueError, match=r"no episode yet; call reset\(\) first"):
        single.step([0, 0])
    env.reset(seed=0)
    single.reset(seed=0)
    for actions, reason in (
        ({"agent_0": 0}, r"choice of agent_1 is missing \(1 of 2"),
        (both | {"agent_7": 0}, "no agent 'agent_7'; they are agent_0 to agent_1"),
        (both | {"agent_1": 1.9}, "agent_1 must choose a whole number, got 1.9"),
        (both | {"agent_1": True}, "whole number"),
        (both | {"agent_1": None}, "whole number"),
        (both | {"agent_1": [1, 1]}, "whole number"),
        (both | {"agent_1": -1}, "slot between 0 and 2, got -1"),
        (both | {"agent_1": 3}, "slot between 0 and 2, got 3"),
    ):
        with pytest.raises(ValueError, match=reason):
            env.step(actions)
    for action, reason in (
        ([0], r"shape \(2,\)"), ([0, 1.9], "agent_0 must choose a whole number"), ([0, 3], "between 0 and 2"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=reason):
            single.step(action)
    env.step(both)
    single.step([0, 1])
    for over in (lambda: env.step(both), lambda: single.step([0, 1])):
        with pytest.raises(ValueError, match=r"the episode is over; call reset\(\)"):
            over()


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
