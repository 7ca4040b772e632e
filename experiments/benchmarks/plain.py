"""Plain Algorithm 2: every sequence of intervals from scratch, dense matrices, scipy's assignment.

The baseline of the speed comparison and, with the parking rule, the independent check of HAAL's values: nothing is
shared between sequences and nothing comes from sapopt.
"""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment


def sequences(start: int, stop: int) -> list[list[tuple[int, int]]]:
    """All ways to cut ``start .. stop - 1`` into intervals, shortest first interval first."""
    out = []
    inner = range(start + 1, stop)
    for count in range(len(inner) + 1):
        for cuts in combinations(inner, count):
            edges = [start, *cuts, stop]
            out.append(list(pairwise(edges)))
    return sorted(out)


def alpha(matrix: np.ndarray, idle: float, park: bool) -> np.ndarray:
    """Best assignment of a dense matrix; with `park`, idle agents take the lowest-numbered free tasks in turn."""
    chosen = linear_sum_assignment(matrix, maximize=True)[1]
    if park:
        n, m = matrix.shape
        chosen = np.where(matrix[np.arange(n), chosen] > idle, chosen, -1)
        free = iter(np.setdiff1d(np.arange(m), chosen))
        chosen = np.array([j if j >= 0 else next(free) for j in chosen])
    return chosen


def plain_step(
    benefits: np.ndarray, cost: float, k: int, lookahead: int, held: np.ndarray | None, park: bool = True
) -> np.ndarray:
    """First assignment of the best sequence at step k; `benefits` has shape (T, n, m)."""
    steps, n, m = benefits.shape
    stop = min(k + lookahead, steps)
    best, first = -np.inf, np.empty(0, dtype=int)
    for sequence in sequences(k, stop):
        value, state, opening = 0.0, held, None
        for a, b in sequence:
            matrix = benefits[a:b].sum(axis=0)
            if state is not None:
                eta = np.full((n, m), -cost)
                eta[np.arange(n), state] = 0.0
                matrix = matrix + eta
            chosen = alpha(matrix, 0.0 if state is None else -cost, park)
            value += matrix[np.arange(n), chosen].sum()
            state = chosen
            opening = chosen if opening is None else opening
        if opening is not None and value > best + 1e-12 * abs(best if np.isfinite(best) else 0.0):
            best, first = value, opening
    return first
