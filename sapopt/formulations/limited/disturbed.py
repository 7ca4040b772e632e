"""Tasks that disturb each other as limits: at most one of a pair is served at a step, or its loss is paid.

Where a task takes one agent, the agents that serve task a or task b at a step are 0, 1 or 2, and both are served if
they are 2. So "at most 1, and what is beyond costs the loss" says the same as the loss itself. A problem whose only
interaction are such losses is one with limits, and with paths of its own for every agent. Its dual has one multiplier
for every pair and step, at most the loss.

A pair of which a task takes several agents at a step is left out there: its loss only lowers the value.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import IntArray
from sapopt.problem.rows import Weights
from sapopt.problem.sap import SAP


def needs_limits(problem: SAP) -> bool:
    """Whether prices of tasks alone do not hold a problem: it asks for more than the plain one, or tasks disturb."""
    return not problem.is_plain or problem.model.disturbed() is not None


def untangled(problem: SAP, exact: bool = False) -> SAP:
    """A core (`SAP.core`) with a row more for every disturbing pair of tasks and step, and no interaction.

    The rows follow those of the limits, pair by pair, and for each pair step by step. A problem in which nothing
    disturbs is returned as it is.

    Parameters
    ----------
    problem : SAP
        A core.
    exact : bool
        Refuse what would have to leave a loss out; else the values of the new problem may be higher than they are.

    Raises
    ------
    ValueError
        If it is to be exact and a task of a pair takes several agents.
    """
    disturbed = problem.model.disturbed()
    if disturbed is None:
        return problem
    T, n, m = problem.T, problem.n, problem.m
    room = np.ones((T, m), dtype=np.int64) if problem.capacity is None else problem.capacity
    a, b = disturbed.pairs.T
    single = (room[:, a] <= 1) & (room[:, b] <= 1)
    if exact and not single.all():
        raise ValueError(
            f"dynamics: with {problem.model.called}, prices take agents apart only where every task of a pair takes "
            "one agent; HAA, HAAL and IteratedAssignment serve such a problem"
        )
    first, count = problem.rows.count, len(a) * T
    parts = []
    for k in range(T):
        serves = dense_step(problem.benefits.step(k)) > 0
        pair = np.flatnonzero(single[k] & serves[:, a].any(axis=0) & serves[:, b].any(axis=0))
        for task in (a[pair], b[pair]):
            agent, place = np.nonzero(serves[:, task])
            parts.append((k * n + agent) * m + task[place])
            parts.append(first + pair[place] * T + k)
    cell, row = _joined(parts[::2]), _joined(parts[1::2])
    rows, infinite = problem.rows, np.full(count, np.inf)
    out = copy.copy(problem)
    out.rows = replace(
        rows,
        names=(*rows.names, *_names(problem, disturbed.pairs)),
        low=np.concatenate([rows.low, -infinite]),
        high=np.concatenate([rows.high, np.ones(count)]),
        told_low=np.concatenate([rows.told_low, -infinite]),
        told_high=np.concatenate([rows.told_high, np.ones(count)]),
        penalty=np.concatenate([rows.penalty, np.repeat(disturbed.loss, T)]),
        pair=Weights(
            np.concatenate([rows.pair.cell, cell]),
            np.concatenate([rows.pair.row, row]),
            np.concatenate([rows.pair.weight, np.ones(len(cell))]),
        ),
    )
    out.model, out.core, out.capacity = disturbed.alone, out, room
    return out


def undisturbed(problem: SAP) -> SAP:
    """A plain problem without the losses. Its bounds are bounds of the problem as well: losses only lower a value."""
    disturbed = problem.model.disturbed()
    assert disturbed is not None
    out = copy.copy(problem)
    out.model, out.core = disturbed.alone, out
    return out


def _names(problem: SAP, pairs: IntArray) -> list[str]:
    naming, steps = problem.naming, range(problem.T)
    called = [f"{naming.task(int(a))} beside {naming.task(int(b))}" for a, b in pairs]
    return [f"{pair}, {naming.step(k)}" for pair in called for k in steps]


def _joined(parts: list[IntArray]) -> IntArray:
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])
