"""Brute force over joint states: exact for any dynamics, also user-defined and global ones, of a tiny problem.

Step by step, every full assignment is tried in every state that can be reached, and of the ways into equal states
only the best is kept. States are equal if the model's `key` says so.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator
from itertools import permutations
from typing import Any

import numpy as np

from sapopt.data.feasibility import InfeasibleError, explain_infeasible
from sapopt.data.types import IntArray
from sapopt.problem.sap import SAP
from sapopt.running.control import Run

LIMIT = 20_000_000
"""Assignments tried over all steps and states; beyond that the other methods are the right ones."""


class TooLargeError(ValueError):
    """The problem is too large for brute force."""


def refusal(problem: SAP, limit: int = LIMIT) -> str | None:
    """None, or the reason why brute force is out of reach (already with one state per step)."""
    count = math.perm(problem.m, problem.n)
    if count * problem.T > limit:
        return (
            f"{count} assignments at each of {problem.T} steps are too many for brute force; "
            "use Exact(method='network') or another method for agent-local dynamics"
        )
    return None


def assignments(n: int, m: int) -> IntArray:
    """All full assignments, shape (m! / (m - n)!, n)."""
    return np.array(list(permutations(range(m), n)), dtype=np.int64).reshape(-1, n)


def best_plan(problem: SAP, run: Run | None = None, limit: int = LIMIT) -> IntArray | None:
    """An optimal plan (T, n); None if the time ended first.

    Raises
    ------
    TooLargeError
        If there are too many states and assignments.
    InfeasibleError
        If some step cannot be reached or left by any plan.
    """
    reason = refusal(problem, limit)
    if reason:
        raise TooLargeError(reason)
    rows = assignments(problem.n, problem.m)
    agents = np.arange(problem.n)
    # fingerprint -> (value, state, how it was reached); the state keeps its identity alive
    layer: dict[Hashable, tuple[float, Any, Any]] = {}
    start = problem.initial_state()
    layer[problem.model.key(start)] = (0.0, start, None)
    tried = 0
    for k in range(problem.T):
        tried += len(layer) * len(rows)
        if tried > limit:
            raise TooLargeError(
                f"{len(layer)} states at step {k} with {len(rows)} assignments each are too many for brute force; "
                "give the dynamics a `key` that merges equal states, or use another method"
            )
        after: dict[Hashable, tuple[float, Any, Any]] = {}
        allowed = np.zeros((problem.n, problem.m), dtype=bool)
        for value, state, trail in layer.values():
            if run is not None and run.expired:
                return None
            hat = problem.beta_hat(k, state)
            allowed |= np.isfinite(hat)
            worth = hat[agents, rows].sum(axis=1)
            if problem.model.interacts:  # terms that no matrix holds
                worth += problem.model.interaction(k, state, rows).sum(axis=1)
            for r in np.flatnonzero(worth > -np.inf):
                following = problem.transition(k, state, rows[r])
                key = problem.model.key(following)
                total = value + worth[r]
                if key not in after or total > after[key][0]:
                    after[key] = (total, following, (rows[r], trail))
        if not after:
            detail = (
                explain_infeasible(allowed, problem.naming)
                or "every state that can be reached leaves no full assignment"
            )
            raise InfeasibleError(f"step {k}: {detail}")
        layer = after
    best = max(layer.values(), key=lambda entry: entry[0])
    return np.array(list(_steps(best[2])))[::-1]


def _steps(trail: Any) -> Iterator[IntArray]:
    while trail is not None:
        yield trail[0]
        trail = trail[1]
