"""Algorithm 2 once more, by enumeration: dense matrices, scipy, nothing from sapopt; to compare HAAL with.

The free choices are made as HAAL documents them: among equal assignments the lexicographically smallest, idle agents on
the lowest-numbered free tasks, among equal sequences the one with the shortest first interval.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment


def sequences(start: int, stop: int) -> list[list[tuple[int, int]]]:
    """All ways to cut ``start .. stop - 1`` into intervals, shortest first interval first."""
    inner = range(start + 1, stop)
    cuts = [c for count in range(len(inner) + 1) for c in combinations(inner, count)]
    return sorted([(a, b) for a, b in zip((start, *c), (*c, stop), strict=True)] for c in cuts)


def handover(
    benefits: np.ndarray, cost: float, idle_is_free: bool, k: int, held: np.ndarray | None
) -> np.ndarray:
    """Handover matrix of step k."""
    _, n, m = benefits.shape
    if held is None:
        return np.zeros((n, m))
    eta = np.full((n, m), -cost)
    eta[np.arange(n), held] = 0.0
    return np.where(benefits[k] > 0, eta, 0.0) if idle_is_free else eta


def alpha(matrix: np.ndarray, idle: float, ties: bool) -> np.ndarray:
    """Assignment of greatest value; `idle` is what an agent gets without a task that is worth anything.

    With `ties` the canonical one among equals is looked for, which takes time.
    """
    n, m = matrix.shape
    gains = np.maximum(matrix - idle, 0.0)
    if ties:
        chosen = smallest(gains)
    else:
        chosen = linear_sum_assignment(gains, maximize=True)[1]
        chosen = np.where(gains[np.arange(n), chosen] > 0, chosen, m)
    return park(matrix, idle, chosen)


def smallest(gains: np.ndarray) -> np.ndarray:
    """Lexicographically smallest optimal choice (m: idle): agent by agent, the first task that keeps the optimum."""
    n, m = gains.shape
    wide = np.concatenate([gains, np.full((n, n), -1e6)], axis=1)
    wide[np.arange(n), m + np.arange(n)] = 0.0
    wide[:, :m][gains <= 0] = -1e6
    best = wide[linear_sum_assignment(wide, maximize=True)].sum()
    for i in range(n):
        for j in [*range(m), m + i]:
            if wide[i, j] < -1e5:
                continue
            fixed = wide.copy()
            fixed[i] = -1e6
            fixed[i, j] = wide[i, j]
            if fixed[linear_sum_assignment(fixed, maximize=True)].sum() > best - 1e-7:
                wide = fixed
                break
    return np.minimum(linear_sum_assignment(wide, maximize=True)[1], m)


def park(matrix: np.ndarray, idle: float, chosen: np.ndarray) -> np.ndarray:
    """Give the agents without a task (m) the lowest-numbered free ones on which they do not do worse than idle.

    If there is none, idling is not free, and the best assignment of the full matrix is taken.
    """
    n, m = matrix.shape
    free = np.ones(m + 1, dtype=bool)
    free[chosen] = False
    out = chosen.copy()
    for i in np.flatnonzero(chosen == m):
        spots = np.flatnonzero(free[:m] & (matrix[i] >= idle))
        if not len(spots):
            return linear_sum_assignment(matrix, maximize=True)[1]
        out[i] = spots[0]
        free[spots[0]] = False
    return out


def plain_step(
    benefits: np.ndarray,
    cost: float,
    k: int,
    lookahead: int,
    held: np.ndarray | None,
    *,
    idle_is_free: bool = False,
    ties: bool = False,
) -> np.ndarray:
    """First assignment of the best sequence at step k; `benefits` has shape (T, n, m), none of them negative."""
    stop = min(k + lookahead, len(benefits))
    agents = np.arange(benefits.shape[1])
    best, first = -np.inf, np.empty(0, dtype=np.int64)
    for sequence in sequences(k, stop):
        value, state, opening = 0.0, held, None
        for a, b in sequence:
            matrix = benefits[a:b].sum(axis=0) + handover(benefits, cost, idle_is_free, a, state)
            state = alpha(matrix, 0.0 if state is None or idle_is_free else -cost, ties)
            value += matrix[agents, state].sum()
            opening = state if opening is None else opening
        if opening is not None and (best == -np.inf or value > best + 1e-12 * abs(best)):
            best, first = value, opening
    return first
