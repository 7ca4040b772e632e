"""Dynamics of a user's own, for tests: local to the agents, and global."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sapopt.data.benefits import dense_step

LEVELS = 3


@dataclass(frozen=True, eq=False)
class Tiring:
    """Agents tire: a task of positive benefit takes a level of strength, any other gives one back; the weak pay.

    The local state is the level 0..2. At level 0 work costs `price`, or is forbidden if that is infinite.
    """

    price: float = 0.7
    first: int = 1
    benefits: Any = field(default=None, kw_only=True)

    def bind(self, benefits: Any) -> Tiring:
        return Tiring(self.price, self.first, benefits=benefits)

    def initial_state(self, problem: Any) -> tuple[int, ...]:
        return (self.first,) * problem.n

    def handover(self, k: int, state: tuple[int, ...]) -> np.ndarray:
        works = dense_step(self.benefits.step(k)) > 0
        weak = np.array(state)[:, None] == 0
        return np.where(works & weak, -self.price, 0.0)

    def transition(self, k: int, state: tuple[int, ...], assignment: np.ndarray) -> tuple[int, ...]:
        works = dense_step(self.benefits.step(k))[np.arange(len(state)), assignment] > 0
        return tuple(int(x) for x in np.clip(np.array(state) + np.where(works, -1, 1), 0, LEVELS - 1))

    def local_model(self, benefits: Any, state: tuple[int, ...]) -> TiringStates:
        return TiringStates(self.price, state)


@dataclass(frozen=True)
class TiringStates:
    """The same, seen by one agent."""

    price: float
    state: tuple[int, ...]

    def state_count(self) -> int:
        return LEVELS

    def start(self, agent: int) -> int:
        return self.state[agent]

    def step(self, k: int, agent: int, benefit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        works = benefit > 0
        level = np.arange(LEVELS)[:, None]
        successor = np.clip(level + np.where(works, -1, 1)[None, :], 0, LEVELS - 1)
        return successor, np.where((level == 0) & works[None, :], -self.price, 0.0)


@dataclass(frozen=True)
class Dictator:
    """A global state: the task agent 0 held last decides what everyone else's tasks are worth."""

    bonus: float = 1.0

    def initial_state(self, problem: Any) -> tuple[int, int, int]:
        return (0, problem.n, problem.m)

    def handover(self, k: int, state: tuple[int, int, int]) -> np.ndarray:
        leader, n, m = state
        eta = np.zeros((n, m))
        eta[1:, leader] = self.bonus
        return eta

    def transition(self, k: int, state: tuple[int, int, int], assignment: np.ndarray) -> tuple[int, int, int]:
        return (int(assignment[0]), state[1], state[2])
