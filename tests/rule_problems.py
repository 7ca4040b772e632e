"""Tiny random problems with rule-based dynamics, and a user's own rule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sapopt import SAP
from sapopt.dynamics import AgentLocal, RideHailing, SlewCost, UnitCommitment, WaitingRides


@dataclass(frozen=True, eq=False)
class Learning(AgentLocal):
    """A user's own: the more often an agent has done a task in a row (up to twice), the better it does it."""

    bonus: float = 0.5

    def start(self, problem: SAP) -> np.ndarray:
        return np.full(problem.n, -1)

    def rule(self, k: int, agent: Any, local: Any, task: Any, benefit: Any) -> Any:
        last, times = np.divmod(local, 2)  # -1 is task -1, done once
        again = (benefit > 0) & (last == task)
        after = np.where(benefit > 0, 2 * task + again, -1)
        return np.where(again, self.bonus * (1 + times), 0.0), after


def slewing(seed: int, T: int = 4, n: int = 2, targets: int = 3) -> SAP:
    rng = np.random.default_rng(seed)
    m = targets + n
    benefits = np.zeros((T, n, m))
    benefits[:, :, :targets] = rng.random((T, n, targets)) * (rng.random((T, n, targets)) < 0.6)
    satellites = 7000.0 + 1000.0 * rng.normal(size=(T, n, 3))
    start = rng.permutation(m)[:n] if seed % 2 else None
    return SAP(benefits, SlewCost(0.5, satellites, 3000.0 * rng.normal(size=(targets, 3))), start)


def riding(seed: int, T: int = 5, n: int = 2, requests: int = 4, places: int = 4) -> SAP:
    rng = np.random.default_rng(seed)
    benefits = np.zeros((T, n, requests + n))
    for r in range(requests):
        benefits[rng.integers(T), :, r] = 1 + 3 * rng.random()
    travel = rng.integers(1, 4, (places, places))
    np.fill_diagonal(travel, 0)
    ends = rng.integers(0, places, (2, requests))
    return SAP(benefits, RideHailing(travel, *ends, rng.integers(0, places, n), 2, 0.3))


def waiting(seed: int, T: int = 5, n: int = 2, requests: int = 3, places: int = 4) -> SAP:
    rng = np.random.default_rng(seed)
    benefits = np.zeros((T, n, requests + n))
    latest = rng.integers(0, T + 2, requests)
    for r in range(requests):
        benefits[rng.integers(T) : latest[r] + 1, :, r] = 1 + 3 * rng.random()
    travel = rng.integers(1, 4, (places, places))
    np.fill_diagonal(travel, 0)
    ends = rng.integers(0, places, (2, requests))
    return SAP(benefits, WaitingRides(travel, *ends, latest, rng.integers(0, places, n), 0.3))


def committing(seed: int, T: int = 5, n: int = 2, blocks: int = 2, stops: bool = False) -> SAP:
    rng = np.random.default_rng(seed)
    benefits = np.zeros((T, n, blocks + 2 * n))
    benefits[:, :, :blocks] = 2 + 3 * rng.normal(size=(T, n, blocks))
    benefits[:, :, :blocks][rng.random((T, n, blocks)) < 0.2] = 0.0
    idling = rng.random(n)
    benefits[:, np.arange(n), blocks + np.arange(n)] = -idling
    times = rng.integers(1, 4, (2, n))
    first, initial = 3 * rng.random(n), rng.choice([-3, -1, 1, 3], n)
    return SAP(
        benefits, UnitCommitment(first, *times, idling, initial, 0.5 + rng.random(n) if stops else 0.0)
    )


def learning(seed: int, T: int = 4, n: int = 2, m: int = 4) -> SAP:
    rng = np.random.default_rng(seed)
    return SAP(rng.random((T, n, m)) * (rng.random((T, n, m)) < 0.7), Learning(0.3))


MAKERS = (slewing, riding, waiting, committing, learning)
