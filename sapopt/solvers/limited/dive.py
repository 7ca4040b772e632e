"""A plan by diving: solve the linear relaxation, fix what it is surest of, and solve it again."""

from __future__ import annotations

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import maximise
from sapopt.formulations.limited.graph import PathGraph
from sapopt.formulations.limited.programme import limited_programme
from sapopt.running.control import Run

_SURE = 0.95
"""Share of a cell from which on an agent is fixed there."""
_SHARE = 0.06
"""Share of the cells left that a round fixes at least."""


def dive(graph: PathGraph, loss: FloatArray, allowed: float, elastic: float, run: Run) -> IntArray | None:
    """A plan (T, n) within the capacities; None if time ended first.

    Parameters
    ----------
    graph : PathGraph
    loss : ndarray, shape (arcs,)
        How much a plan loses at least that uses an arc.
    allowed : float
        Arcs of more loss are left out as long as there are others.
    elastic : float
        Price at which hard limits may be broken.
    run : Run
        Its clock.
    """
    problem = graph.problem
    T, n, m = problem.T, problem.n, problem.m
    step, task = np.divmod(np.maximum(graph.cell, 0), m)
    pair = (step * n + graph.agent) * m + task
    fixed = np.full(T * n, -1, dtype=np.int64)
    assert problem.capacity is not None
    room, wide = problem.capacity.copy(), False
    while not run.expired:
        at = fixed[step * n + graph.agent]
        fits = ~graph.holds | (at < 0) | (at == task)
        small = (loss <= allowed) | (at == task) | wide
        keep = fits & small & np.isfinite(loss)
        made = limited_programme(graph, keep, elastic)
        answer = maximise(
            made.programme, relaxed=True, seconds=run.seconds_left, watch=lambda *_: run.expired
        )
        if answer.x is None:
            if wide or run.expired:
                return None
            wide = True  # what was left out is needed after all
            continue
        x = answer.x[: len(made.kept)]
        held = graph.holds[made.kept]
        mass = np.bincount(pair[made.kept[held]], weights=x[held], minlength=T * n * m).reshape(T * n, m)
        top = mass.max(axis=1)
        loose = np.flatnonzero(fixed < 0)
        if (top[loose] > 1.0 - 1e-6).all():
            fixed[loose] = mass[loose].argmax(axis=1)
            return fixed.reshape(T, n)
        order = loose[np.argsort(-top[loose], kind="stable")]
        count = max(1, int(_SHARE * len(order)), int((top[order] >= _SURE).sum()))
        for cell in order[:count]:
            slot = cell // n, int(mass[cell].argmax())
            if room[slot] > 0:
                fixed[cell] = slot[1]
                room[slot] -= 1
    return None
