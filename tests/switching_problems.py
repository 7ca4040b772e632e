"""Problems with switching costs for the tests of planners: tiny ones, their optimum, and small constellations."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt import SAP, SwitchingCost


def tiny(seed: int) -> SAP:
    """A random problem with n <= 3, m <= 4, T <= 5 and any form of the switching cost."""
    rng = np.random.default_rng(seed)
    T, n = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    m = int(rng.integers(n, 5))
    benefits = rng.random((T, n, m)) * (rng.random((T, n, m)) < 0.7)
    if seed % 7 == 3:
        benefits -= 0.2
    if seed % 5 == 4 and n < m:
        benefits[rng.integers(T), rng.integers(n), rng.integers(m)] = -np.inf
    cost: Any = float(rng.choice([0.0, 0.1, 0.5, 2.0]))
    if seed % 3 == 1:
        cost = rng.random((m, m))
        np.fill_diagonal(cost, 0.0)
    initial = rng.permutation(m)[:n] if seed % 2 else None
    values: Any = benefits
    if seed % 4 == 2:
        values = [sp.csr_array(step) for step in benefits]
    return SAP(values, SwitchingCost(cost, idle_is_free=seed % 6 >= 3), initial)


def optimum(problem: SAP) -> float:
    """The best value, by dynamic programming over all assignments."""
    states = [np.array(p) for p in itertools.permutations(range(problem.m), problem.n)]
    agents = np.arange(problem.n)
    known = {None: 0.0} if problem.initial_assignment is None else {tuple(problem.initial_assignment): 0.0}
    for k in range(problem.T):
        after: dict[Any, float] = {}
        for held, value in known.items():
            gain = problem.beta_hat(k, None if held is None else np.array(held))
            for x in states:
                total = value + float(gain[agents, x].sum())
                key = tuple(x)
                after[key] = max(after.get(key, -np.inf), total)
        known = after
    return max(known.values())


def walking(seed: int = 0, T: int = 24, n: int = 12, m: int = 16, cost: float = 0.4) -> SAP:
    """Agents that pass over tasks one after another, a small constellation on a line."""
    rng = np.random.default_rng(seed)
    place = rng.random(n)[None, :, None] * m + 0.35 * np.arange(T)[:, None, None]
    distance = np.abs((place - np.arange(m) + m / 2) % m - m / 2)
    return SAP((1 + rng.random(m)) * np.maximum(0.0, 1 - distance / 1.7), SwitchingCost(cost))
