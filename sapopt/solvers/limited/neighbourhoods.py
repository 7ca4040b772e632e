"""Better plans from a plan: programmes in which a part of it is free.

A part is a span of steps for all agents, or a group of agents for all steps. Hard limits may be broken at a price that
outweighs what a plan could gain by it, so that a plan that breaks some is brought back within them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import maximise
from sapopt.formulations.limited.graph import PathGraph
from sapopt.formulations.limited.programme import limited_programme
from sapopt.running.control import Run

_ARCS = 6000
"""Free arcs of one programme, more or less."""
_SECONDS = 5.0
"""Most time of one programme."""


def worth(graph: PathGraph, plan: IntArray, elastic: float) -> float:
    """Value of a plan within the capacities, with hard limits broken at the price `elastic`; -inf if it is no plan."""
    problem, rows = graph.problem, graph.problem.rows
    arcs = graph.follow(plan)
    if arcs is None:
        return -np.inf
    share = np.zeros(graph.arcs)
    share[arcs] = 1.0
    assert problem.capacity is not None
    if (graph.usage(share) > problem.capacity).any():
        return -np.inf
    use = rows.use(plan, problem.initial_assignment)
    beyond = rows.violation(use)
    cost = float((beyond[beyond > 0] * np.minimum(rows.penalty, elastic)[beyond > 0]).sum())
    return float(graph.gain[arcs].sum() + rows.earned(plan).sum() - cost)


def improved(
    graph: PathGraph, plan: IntArray, loss: FloatArray, elastic: float, run: Run, rng: np.random.Generator
) -> Iterator[IntArray]:
    """Better and better plans, one for every programme that finds one; ends when all parts were tried in vain."""
    value = worth(graph, plan, elastic)
    size, quiet = 1.0, 0
    while not run.expired:
        parts = _parts(graph, size, rng)
        if not parts:
            return
        for free in parts:
            if run.expired:
                return
            arcs = graph.follow(plan)
            if arcs is None:
                return
            keep = _kept(graph, plan, free, loss, arcs)
            made = limited_programme(graph, keep, elastic)
            answer = maximise(
                made.programme, seconds=min(_SECONDS, run.seconds_left), tolerance=1e-6, start=made.point(arcs),
                watch=lambda *_: run.expired,
            )  # fmt: skip
            quiet += 1
            if answer.x is None:
                continue
            found = made.recover(answer.x)
            better = worth(graph, found, elastic)
            if better > value + 1e-9 * abs(value):
                plan, value, quiet = found, better, 0
                yield plan
        if quiet >= len(parts):
            if size > 3.0:
                return
            size, quiet = 1.6 * size, 0


def _parts(graph: PathGraph, size: float, rng: np.random.Generator) -> list[np.ndarray]:
    """Masks (T, n) of what is free, in random order."""
    T, n = graph.problem.T, graph.problem.n
    share = min(1.0, size * _ARCS / max(graph.arcs, 1))
    masks = []
    length = max(2, int(share * T))
    for first in range(0, max(T - length // 2, 1), max(length // 2, 1)):
        free = np.zeros((T, n), dtype=bool)
        free[first : first + length] = True
        masks.append(free)
    count = max(2, int(share * n))
    order = rng.permutation(n)
    for first in range(0, n, count):
        free = np.zeros((T, n), dtype=bool)
        free[:, order[first : first + count]] = True
        masks.append(free)
    return [masks[place] for place in rng.permutation(len(masks))]


def _kept(graph: PathGraph, plan: IntArray, free: np.ndarray, loss: FloatArray, arcs: IntArray) -> np.ndarray:
    """Arcs of the programme: those of the plan, and where it is free those that can lie on a path."""
    m = graph.problem.m
    step, task = np.divmod(np.maximum(graph.cell, 0), m)
    fits = ~graph.holds | free[step, graph.agent] | (plan[step, graph.agent] == task)
    keep = fits & np.isfinite(loss)
    keep[arcs] = True
    return keep
