"""Memory of past episodes in compact form: what was done, not what was seen.

An episode is its problem (its sparse benefits), the assignments, the rewards and the states: about 2.5 MB for 324
agents, 450 tasks and 100 steps where the observations would take 65 MB. Observations are made
again when a batch is drawn, at less than a millisecond a step.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import IntArray
from sapopt.learning.environment import Environment
from sapopt.learning.observation import Spec
from sapopt.learning.observation_kernels import action_index
from sapopt.problem.sap import SAP
from sapopt.running.chance import Chance


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode, as far as it is played.

    Attributes
    ----------
    seed : int
        Of its problem.
    problem : SAP
    plan : ndarray of int64, shape (T, n)
    rewards : ndarray of float32, shape (T, n)
        Zeros for steps that are not played yet.
    states : list
        Before the first step, and after every step that is played: T + 1 of them at the end.
    """

    seed: int
    problem: SAP
    plan: IntArray
    rewards: NDArray[np.float32]
    states: list[Any]

    @property
    def played(self) -> int:
        """Steps that are played."""
        return len(self.states) - 1

    def observe(self, k: int, spec: Spec) -> tuple[np.ndarray, IntArray]:
        """Observations at step k, and the tasks they list."""
        return spec.look(self.problem.benefits, k, self.problem.model, self.states[k], k)


def replayed(
    seed: int, problem: SAP, plan: IntArray, conflicts_shared: bool = False, chance: Chance | None = None
) -> Episode:
    """The episode that a plan makes."""
    env = Environment(problem, conflicts_shared, chance, seed)
    rewards = np.empty(plan.shape, np.float32)
    states = [env.state]
    while not env.done:
        k = env.k
        rewards[k] = env.step(plan[k])
        states.append(env.state)
    return Episode(seed, problem, plan, rewards, states)


@dataclass(frozen=True, eq=False)
class Batch:
    """Stretches of S successive steps of B episodes, all n agents.

    Attributes
    ----------
    observations : ndarray of float32, shape (B, S + 1, n, size)
        Before every step and after the last; zeros after the end of an episode.
    listed : list of B lists of S + 1 ndarrays of int64, shape (n, M)
        Tasks that the network's outputs stand for.
    actions : ndarray of int64, shape (B, S, n)
        Output of the network that was played.
    rewards : ndarray of float32, shape (B, S, n)
    going : ndarray of bool, shape (B,)
        False where the stretch reaches the end of its episode.
    m : list of int
        Number of tasks.
    """

    observations: np.ndarray
    listed: list[list[IntArray]]
    actions: IntArray
    rewards: np.ndarray
    going: NDArray[np.bool_]
    m: list[int]


class Replay:
    """The last `capacity` episodes.

    Parameters
    ----------
    capacity : int
    spec : Spec
    """

    def __init__(self, capacity: int, spec: Spec) -> None:
        self.episodes: deque[Episode] = deque(maxlen=capacity)
        self.spec = spec

    def add(self, episode: Episode) -> None:
        """Remember an episode; the oldest is forgotten when the memory is full."""
        self.episodes.append(episode)

    def reward_scale(self, kind: str) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation (n,) by which rewards are standardised.

        ``"agent"`` standardises the rewards of every agent on their own (published code), ``"common"`` divides all
        rewards by one number, so that the agents' values stay comparable; ``"none"`` leaves them.
        """
        n = self.episodes[-1].rewards.shape[1]
        if kind == "none":
            return np.zeros(n, np.float32), np.ones(n, np.float32)
        rewards = np.concatenate([e.rewards[: e.played] for e in self.episodes])
        if kind == "common":
            return np.zeros(n, np.float32), np.full(n, max(float(rewards.std()), 1e-6), np.float32)
        return rewards.mean(axis=0), np.maximum(rewards.std(axis=0), 1e-6)

    def sample(self, stretches: int, length: int, rng: np.random.Generator) -> Batch:
        """Draw stretches of at most `length` steps, every place for one in the memory with the same probability."""
        S = min(length, max(e.played for e in self.episodes))
        places = np.array([max(e.played - S + 1, 0) for e in self.episodes])
        if (places == places[0]).all():
            which = rng.integers(len(places), size=stretches)
            first = rng.integers(places[0], size=stretches)
        else:  # the last episode is still being played
            which = rng.choice(len(places), size=stretches, p=places / places.sum())
            first = rng.integers(places[which])
        episodes = [self.episodes[i] for i in which]
        T, n = episodes[0].plan.shape
        seen = np.zeros((stretches, S + 1, n, self.spec.size), np.float32)
        actions = np.empty((stretches, S, n), np.int64)
        listed: list[list[IntArray]] = []
        for b, episode in enumerate(episodes):
            listed.append([])
            for s in range(S + 1):
                k = int(first[b]) + s
                if k == T:
                    listed[b].append(np.full((n, self.spec.tasks), -1))
                    continue
                seen[b, s], tasks = episode.observe(k, self.spec)
                listed[b].append(tasks)
                if s < S:
                    actions[b, s] = action_index(tasks, episode.plan[k])
        rewards = np.stack([e.rewards[k : k + S] for e, k in zip(episodes, first, strict=True)])
        return Batch(seen, listed, actions, rewards, first + S < T, [e.problem.m for e in episodes])
