"""The next steps of a problem with limits, as a problem of their own: with what is left of each limit."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.rows import Rows, Weights
from sapopt.problem.sap import SAP


def window_of(
    problem: SAP, start: int, benefits: Benefits, previous: IntArray | None, used: FloatArray
) -> SAP:
    """The steps from `start` on for which there are benefits, as a core.

    An upper bound of a limit is what is left of it; a lower one is the share of what is lacking that the weights in the
    window have of all that are left. So the multipliers price what is left; they prove nothing about the whole.

    Parameters
    ----------
    problem : SAP
        A core (`SAP.core`).
    start : int
    benefits : Benefits
        Of the window, known or forecast.
    previous : ndarray of int64, shape (n,), or None
        Assignment before it.
    used : ndarray, shape (rows,)
        The sums so far.
    """
    assert problem.capacity is not None
    stop = start + benefits.shape[0]
    out = copy.copy(problem)
    out.T, out.benefits, out.core = stop - start, benefits, out
    out.capacity = problem.capacity[start:stop]
    out.initial_assignment = previous
    out.rows = _rows(problem.rows, start, stop, used, previous is not None)
    return out


def _rows(rows: Rows, start: int, stop: int, used: FloatArray, first_counts: bool) -> Rows:
    T, n, m = rows.shape
    size = n * m

    def inside(weights: Weights) -> Weights:
        keep = (weights.cell >= start * size) & (weights.cell < stop * size)
        return Weights(weights.cell[keep] - start * size, weights.row[keep], weights.weight[keep])

    here, left = np.zeros(rows.count), np.zeros(rows.count)
    for weights in (rows.pair, rows.taken):
        step, good = weights.cell // size, np.maximum(weights.weight, 0.0)
        for total, last in ((here, stop), (left, T)):
            keep = (step >= start) & (step < last)
            total += np.bincount(weights.row[keep], weights=good[keep], minlength=rows.count)
    share = np.divide(here, left, out=np.ones(rows.count), where=left > 0)
    lacking = rows.low - used
    wanted = np.where(lacking > 0, lacking, 0.0)
    teams = (rows.team_cell >= start * m) & (rows.team_cell < stop * m)
    return replace(
        rows, shape=(stop - start, n, m), low=np.where(lacking > 0, share * wanted, lacking), high=rows.high - used,
        pair=inside(rows.pair), taken=inside(rows.taken), stayed=inside(rows.stayed), first_counts=first_counts,
        team_cell=rows.team_cell[teams] - start * m, team_needs=rows.team_needs[teams],
        team_reward=rows.team_reward[teams],
    )  # fmt: skip
