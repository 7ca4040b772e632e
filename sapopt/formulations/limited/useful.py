"""Which pairs an agent that may idle can gain from, and from when to when holding them has a point.

An agent gains nothing by holding a task before it earns anything there: idling earns as much, costs nothing, and is
free to begin, and taking the task up later is charged and counted once all the same. Only what is held from the very
start may be had for free. Nor does it gain by holding a task after the last step at which it earns something.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Switching
from sapopt.dynamics.idle import IdlePlace
from sapopt.problem.sap import SAP


def useful_pairs(
    problem: SAP, benefits: FloatArray, signed: bool, also: Sequence[tuple[int, int]] = ()
) -> np.ndarray:
    """Mask (n, T, m) of the pairs by which an agent may gain, by their benefit, in a limit or in a team.

    Parameters
    ----------
    problem : SAP
        A core (`SAP.core`).
    benefits : ndarray, shape (n, T, m)
        As of `agent_benefits`.
    signed : bool
        Whether a pair of negative benefit may be of use as well, because it moves the state.
    also : sequence of (agent, task), optional
        To count as useful at every step.
    """
    rows, (n, T, m) = problem.rows, benefits.shape
    if rows.idle < 0 or _wants_take_ups(problem):
        return np.ones((n, T, m), dtype=bool)
    mask: np.ndarray = (benefits != 0) & (benefits > -np.inf) if signed else benefits > 0
    for weights in (rows.pair, rows.taken, rows.stayed):
        pair, task = np.divmod(weights.cell, m)
        mask[pair % n, pair // n, task] = True
    mask[:, rows.team_cell // m, rows.team_cell % m] = True
    mask[:, :, rows.idle] = True
    for i, j in also:
        mask[i, :, j] = True
    return mask


def _wants_take_ups(problem: SAP) -> bool:
    """Whether a row wants take-ups, or pays for them: it may be served by taking up anything."""
    rows = problem.rows
    return bool(np.isfinite(rows.low[rows.taken_by.row]).any() or (rows.taken_by.weight < 0).any())


def kept_pairs(useful: np.ndarray, initial: int | None) -> np.ndarray:
    """Mask (T, m) of the pairs worth holding: between the first and the last useful step of a task.

    Without an initial assignment, and for the task held in it, from the start.
    """
    later = np.cumsum(useful[::-1], axis=0)[::-1] > 0
    before = np.cumsum(useful, axis=0) > 0
    if initial is None:
        before[:] = True
    else:
        before[:, initial] = True
    kept: np.ndarray = before & later
    return kept


def switching_rule(problem: SAP) -> Switching | None:
    """The plain switching rule of a core, also where idleness is a place beside it."""
    model = problem.model
    return model.inner.switching() if isinstance(model, IdlePlace) else model.switching()


def agent_benefits(problem: SAP) -> FloatArray:
    """The benefits by agent, shape (n, T, m)."""
    return np.stack([dense_step(problem.benefits.step(k)) for k in range(problem.T)], axis=1)


def tidied(problem: SAP, plan: IntArray) -> IntArray:
    """A plan (T, n) worth at least as much in which nobody holds a task before or after it can gain by it."""
    rule = switching_rule(problem)
    if problem.rows.idle < 0 or (rule is None and problem.model.by_rule() is None):
        return plan
    out = plan.copy()
    initial = problem.initial_assignment
    for i, useful in enumerate(useful_pairs(problem, agent_benefits(problem), signed=rule is None)):
        for first, stop in _runs(plan[:, i]):
            task = plan[first, i]
            good = first + np.flatnonzero(useful[first:stop, task])
            out[first:stop, i] = problem.rows.idle
            if len(good):
                free = first == 0 and (initial is None or initial[i] == task)
                out[first if free else good[0] : good[-1] + 1, i] = task
    return out


def _runs(tasks: IntArray) -> list[tuple[int, int]]:
    """Spans (first, stop) in which a task is held on end."""
    edges = np.flatnonzero(np.diff(tasks)) + 1
    return list(zip([0, *edges.tolist()], [*edges.tolist(), len(tasks)], strict=True))
