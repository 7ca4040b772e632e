"""Small problems under the rules that allow for exchanges and dives, plans of them, and who holds what."""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt import SAP, SwitchingCost
from sapopt.data.types import IntArray
from sapopt.dynamics import SyntheticSwitching


def problem_of(kind: str, seed: int) -> SAP:
    """A small problem under one of the rules that allow for exchanges."""
    rng = np.random.default_rng(seed)
    T, n, m = 8, 5, int(rng.integers(5, 9))
    benefits = np.round(rng.random((T, n, m)) - 0.2, 2) * (rng.random((T, n, m)) < rng.choice([0.4, 1.0]))
    start = rng.permutation(m)[:n] if seed % 2 else None
    rules: dict[str, Any] = {
        "uniform": SwitchingCost(0.3),
        "idle is free": SwitchingCost(0.3, idle_is_free=True),
        "matrix": SwitchingCost(rng.random((m, m)) * (1 - np.eye(m))),
        "copies": SyntheticSwitching(0.2, forfeit=0.5, task_of=np.arange(m) // 2, idle_is_free=bool(seed % 3)),
        "sight": SyntheticSwitching(forfeit=1.0, needs_sight=True, idle_is_free=bool(seed % 3)),
    }  # fmt: skip
    if kind in ("uniform", "matrix") and seed % 3 == 0:
        benefits[1:, :, 0] = -np.inf
    return SAP(benefits, rules[kind], start)


KINDS = ("uniform", "idle is free", "matrix", "copies", "sight")


def some_plan(problem: SAP, rng: np.random.Generator) -> IntArray:
    """Any plan that holds no forbidden pair."""
    plan = np.array([1 + rng.permutation(problem.m - 1)[: problem.n] for _ in range(problem.T)])
    return plan if problem.m > problem.n else np.array([rng.permutation(problem.m) for _ in range(problem.T)])


def owners(problem: SAP, plan: IntArray) -> IntArray:
    """Who holds every task."""
    owner = np.full((problem.T, problem.m), -1, dtype=np.int32)
    owner[np.arange(problem.T)[:, None], plan] = np.arange(problem.n)
    return owner
