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
        self._problems = problems
        self._rng = np.random.default_rng(0)
        self.env: Environment | None = None
        problem = self._problem(0)
        self.n = problem.n
        charge = problem.model.charge_of(problem.initial_state()) is not None
        self.spec = ObservationSpec(charge=charge) if spec is None else spec
        if self.spec.charge != charge:
            raise ValueError(f"spec: charge must be {charge} for {type(problem.dynamics).__name__}")

    def reset(self, seed: int | None) -> None:
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        problem = self._problem(int(self._rng.integers(2**31)))
        if problem.n != self.n:
            raise ValueError(f"problems: {problem.n} agents after {self.n}; all must have the same number")
        self.env = Environment(problem, conflicts_shared=True)
        self._look()

    def running(self) -> Environment:
        """The episode; raises ValueError if there is none to go on with."""
        if self.env is None:
            raise ValueError("there is no episode yet; call reset() first")
        if self.env.done:
            raise ValueError("the episode is over; call reset()")
        return self.env

    @property
    def done(self) -> bool:
        return self.env is not None and self.env.done

    def step(self, choices: IntArray) -> FloatArray:
        """Play slots of all agents; a slot that the mask forbids is taken as idling."""
        env = self.running()
        allowed = self._mask[np.arange(self.n), choices] > 0
        rewards = env.step(tasks_of(np.where(allowed, choices, self.spec.tasks), self._listed, env.problem.m))
        self._look()
        return rewards

    # What is handed out are copies: a caller may write into them, and the masks decide what is allowed.

    def seen(self) -> np.ndarray:
        """Observations (n, size) now."""
        return self._observations.copy()

    def mask(self) -> np.ndarray:
        """What is allowed now, (n, M + 1), 0 or 1."""
        return self._mask.copy()

    def _problem(self, seed: int) -> SAP:
        # No lambda for a fixed problem: an environment is pickled when it goes to a worker.
        return self._problems if isinstance(self._problems, SAP) else self._problems(seed)

    def _look(self) -> None:
        assert self.env is not None
        if self.env.done:  # nothing is left to see or to choose
            self._observations = np.zeros((self.n, self.spec.size), np.float32)
            self._listed = np.full((self.n, self.spec.tasks), -1)
        else:
            self._observations, self._listed = self.env.observe(self.spec)
        self._mask = legal(self._listed).astype(np.int8)


def _slot(value: Any, agent: str, actions: int) -> int:
    """The slot that an agent chooses; raises ValueError if it is no whole number in range."""
    slot = np.asarray(value)
    if slot.size != 1 or not np.issubdtype(slot.dtype, np.integer):
        raise ValueError(f"actions: {agent} must choose a whole number, got {value!r}")
    if not 0 <= slot.item() < actions:
        raise ValueError(
            f"actions: {agent} must choose a slot between 0 and {actions - 1}, got {slot.item()}"
        )
    return int(slot.item())


def _observation_space(spec: ObservationSpec, shape: tuple[int, ...]) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


class SAPParallelEnv(ParallelEnv):
    """One agent of PettingZoo for every agent of the problem.

    Parameters
    ----------
    problems : SAP, or callable
        One problem, or ``problems(seed)``; all with the same number of agents.
    spec : ObservationSpec, optional
        By default `ObservationSpec()`, with charges where the dynamics has them.

    Notes
    -----
    An observation is a dictionary of ``observation`` and ``action_mask``. All agents stay to the end, and then all are
    terminated: the horizon is finite and part of the problem, nothing is worth anything after it. Arrays that are
    handed out are the caller's own. An environment can be pickled if `problems` can, in the middle of an episode too.

    Raises
    ------
    ValueError
        By `step` before `reset` or after the end, or if an agent's choice is missing or no slot.
    """

    metadata: dict[str, Any] = {"name": "sapopt_v0", "render_modes": []}  # noqa: RUF012 - PettingZoo's protocol

    def __init__(self, problems: SAP | Callable[[int], SAP], spec: ObservationSpec | None = None) -> None:
        self._played = _Played(problems, spec)
        self.render_mode: str | None = None  # wrappers ask for it
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
        self._played.running()
        agents = self.agents
        if strangers := [agent for agent in actions if agent not in self._actions]:
            raise ValueError(
                f"actions: there is no agent {strangers[0]!r}; they are agent_0 to agent_{len(agents) - 1}"
            )
        if missing := [agent for agent in agents if agent not in actions]:
            raise ValueError(
                f"actions: the choice of {missing[0]} is missing ({len(missing)} of {len(agents)} are)"
            )
        slots = self._played.spec.actions
        rewards = self._played.step(
            np.array([_slot(actions[agent], agent, slots) for agent in agents], dtype=np.int64)
        )
        over = self._played.done
        out = (
            self._seen(),
            dict(zip(agents, rewards.tolist(), strict=True)),
            dict.fromkeys(agents, over),
            dict.fromkeys(agents, False),
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
        seen, mask = self._played.seen(), self._played.mask()
        return {
            agent: {"observation": seen[i], "action_mask": mask[i]} for i, agent in enumerate(self.agents)
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
    are taken as idling. The last step of the horizon is terminated, as for `SAPParallelEnv`.
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
        return self._played.seen(), {"action_mask": self._played.mask()}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Play one step.

        Raises
        ------
        ValueError
            Before `reset`, after the end, or if the action is not n slots.
        """
        self._played.running()
        given, used = np.asarray(action), self._played.spec
        if given.shape != (self._played.n,):
            raise ValueError(
                f"action must have shape ({self._played.n},), one slot for each agent, got {given.shape}"
            )
        choices = np.array(
            [_slot(slot, f"agent_{i}", used.actions) for i, slot in enumerate(given)], np.int64
        )
        rewards = self._played.step(choices)
        info = {"action_mask": self._played.mask(), "rewards": rewards}
        return self._played.seen(), float(rewards.sum()), self._played.done, False, info
