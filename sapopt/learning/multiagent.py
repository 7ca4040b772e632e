"""Any sequential assignment problem as a PettingZoo `ParallelEnv` and as a Gymnasium `Env`: thin adapters.

Agents choose for themselves, so a task can have several holders; the reward is that of shared conflicts (see
`sapopt.learning.environment`). An action is the slot of one of the agent's M listed tasks, or M to idle. The arrays of
`Environment` are far faster for training: these views are for libraries that expect them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from sapopt.data.types import FloatArray, IntArray
from sapopt.learning.choices import legal, tasks_of
from sapopt.learning.environment import Environment
from sapopt.learning.observation import ObservationSpec
from sapopt.problem.sap import SAP


class _Played:
    """What both views share: problems by seed, and the current episode."""

    def __init__(self, problems: SAP | Callable[[int], SAP], spec: ObservationSpec | None) -> None:
        self._problems = (lambda seed: problems) if isinstance(problems, SAP) else problems
        self._rng = np.random.default_rng(0)
        problem = self._problems(0)
        self.n = problem.n
        charge = problem.model.charge_of(problem.initial_state()) is not None
        self.spec = ObservationSpec(charge=charge) if spec is None else spec
        if self.spec.charge != charge:
            raise ValueError(f"spec: charge must be {charge} for {type(problem.dynamics).__name__}")

    def reset(self, seed: int | None) -> None:
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        problem = self._problems(int(self._rng.integers(2**31)))
        if problem.n != self.n:
            raise ValueError(f"problems: {problem.n} agents after {self.n}; all must have the same number")
        self.env = Environment(problem, conflicts_shared=True)
        self._look()

    def step(self, choices: IntArray) -> FloatArray:
        rewards = self.env.step(tasks_of(choices, self.listed, self.env.problem.m))
        self._look()
        return rewards

    def _look(self) -> None:
        if self.env.done:  # nothing is left to see or to choose
            self.observations = np.zeros((self.n, self.spec.size), np.float32)
            self.listed = np.full((self.n, self.spec.tasks), -1)
        else:
            self.observations, self.listed = self.env.observe(self.spec)
        self.mask = legal(self.listed).astype(np.int8)


def _observation_space(spec: ObservationSpec, shape: tuple[int, ...]) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


class SAPParallelEnv(ParallelEnv):
    """One agent of PettingZoo for every agent of the problem.

    Parameters
    ----------
    problems : SAP, or callable
        One problem, or ``problems(seed)``; all with the same number of agents.
    spec : ObservationSpec, optional
        By default that of the thesis, with charges where the dynamics has them.

    Notes
    -----
    An observation is a dictionary of ``observation`` and ``action_mask``. All agents stay to the end, then all are
    truncated: the horizon ends, the world does not.
    """

    metadata: dict[str, Any] = {"name": "sapopt_v0", "render_modes": []}  # noqa: RUF012 - PettingZoo's protocol

    def __init__(self, problems: SAP | Callable[[int], SAP], spec: ObservationSpec | None = None) -> None:
        self._played = _Played(problems, spec)
        self.possible_agents = [f"agent_{i}" for i in range(self._played.n)]
        self.agents: list[str] = []
        size, actions = self._played.spec.size, self._played.spec.actions
        self._actions = {
            agent: spaces.Discrete(actions, seed=i) for i, agent in enumerate(self.possible_agents)
        }
        self._observations = {
            agent: spaces.Dict(
                {
                    "observation": _observation_space(self._played.spec, (size,)),
                    "action_mask": spaces.Box(0, 1, (actions,), np.int8),
                }
            )
            for agent in self.possible_agents
        }

    def observation_space(self, agent: str) -> spaces.Space:
        """Space of an agent's observation."""
        return self._observations[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """Space of an agent's action."""
        return self._actions[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; the same seed gives the same problem."""
        self._played.reset(seed)
        self.agents = list(self.possible_agents)
        return self._seen(), self._infos()

    def step(self, actions: dict[str, Any]) -> tuple[dict[str, Any], ...]:
        """Play one step; choices that the mask forbids are taken as idling."""
        choices = np.array([actions[agent] for agent in self.agents], np.int64)
        idle = self._played.spec.tasks
        allowed = self._played.mask[np.arange(len(choices)), choices] > 0
        rewards = self._played.step(np.where(allowed, choices, idle))
        over = self._played.env.done
        agents = self.agents
        out = (
            self._seen(),
            dict(zip(agents, rewards.tolist(), strict=True)),
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, over),
            self._infos(),
        )
        if over:
            self.agents = []
        return out

    def render(self) -> None:
        """Nothing to see; `sapopt.plotting` draws plans."""

    def close(self) -> None:
        """Nothing to close."""

    def _seen(self) -> dict[str, Any]:
        played = self._played
        return {
            agent: {"observation": played.observations[i], "action_mask": played.mask[i]}
            for i, agent in enumerate(self.agents)
        }

    def _infos(self) -> dict[str, Any]:
        return {agent: {} for agent in self.agents}


class SAPEnv(gymnasium.Env):
    """The problem as one player who chooses for all agents; the reward is the sum.

    Parameters
    ----------
    problems, spec
        As for `SAPParallelEnv`.

    Notes
    -----
    Observation (n, size), action (n,) of slots. ``info["action_mask"]`` (n, M + 1) says what is allowed; other choices
    are taken as idling.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - Gymnasium's protocol

    def __init__(self, problems: SAP | Callable[[int], SAP], spec: ObservationSpec | None = None) -> None:
        self._played = _Played(problems, spec)
        n, used = self._played.n, self._played.spec
        self.observation_space = _observation_space(used, (n, used.size))
        self.action_space = spaces.MultiDiscrete(np.full(n, used.actions))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; the same seed gives the same problem."""
        super().reset(seed=seed)
        self._played.reset(seed)
        return self._played.observations, {"action_mask": self._played.mask}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Play one step."""
        choices = np.asarray(action, np.int64)
        allowed = self._played.mask[np.arange(len(choices)), choices] > 0
        rewards = self._played.step(np.where(allowed, choices, self._played.spec.tasks))
        info = {"action_mask": self._played.mask, "rewards": rewards}
        return self._played.observations, float(rewards.sum()), False, self._played.env.done, info
