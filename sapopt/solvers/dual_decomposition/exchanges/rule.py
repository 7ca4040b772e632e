"""Rules under which a step earns what the task before and the task now decide, as the compiled exchanges read them."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np

from sapopt.dynamics.copies.paths import SyntheticPaths
from sapopt.dynamics.paths.window import flat_benefits
from sapopt.kernels.jit import njit
from sapopt.problem.sap import SAP
from sapopt.solvers.dual_decomposition.network_plans.arrays import lookup

PairRule = namedtuple(
    "PairRule", "indptr indices data table agents cost matrix forfeit idle_is_free needs_sight real initial"
)
"""Benefits as compressed sparse rows (row ``k * agents + i``), and where most are not zero also as `table` (T, n, m),
else empty; what entering a pair costs: `cost`, or where it is not empty ``matrix`` (m, m), and the share `forfeit` of
its benefit; whether that is free where there is no benefit, and a task counts as held only where there was one; the
real task of every task (m,); and the assignment before the first step (n,), -1 where that step is free."""

_FULL = 0.25
"""Share of benefits that are not zero, from which on a table is kept."""

_TABLE = 25_000_000
"""Most numbers of a table."""


def pair_rule(problem: SAP) -> Any:
    """The rule of a problem as a `PairRule`, or None where more than two assignments in a row decide."""
    switching = problem.model.switching()
    matrix, forfeit, sight, real = np.zeros((0, 0)), 0.0, False, np.arange(problem.m)
    if switching is not None:
        cost, idle_is_free = switching.uniform_cost or 0.0, switching.idle_is_free
        if switching.uniform_cost is None:
            matrix = np.ascontiguousarray(switching.cost, dtype=np.float64)
    else:
        first_step = problem.benefits.slice(0, 1)  # the parameters are the same at every step
        oracle = problem.model.path_oracle(first_step, problem.initial_state())
        if not isinstance(oracle, SyntheticPaths):
            return None
        window = oracle.window
        cost, forfeit, idle_is_free = window.cost, window.forfeit, window.idle_is_free
        sight, real = window.needs_sight, window.real
    indptr, indices, data, (T, n, m) = flat_benefits(problem.benefits)
    is_full = data.size > _FULL * T * n * m and T * n * m <= _TABLE
    table = problem.benefits.dense() if is_full else np.zeros((0, 0, 0))
    start = problem.initial_assignment
    initial = np.full(n, -1) if start is None else np.asarray(start, dtype=np.int64)
    return PairRule(
        indptr, indices, data, np.ascontiguousarray(table, dtype=np.float64), n, cost, matrix, forfeit,
        bool(idle_is_free), bool(sight), real, initial,
    )  # fmt: skip


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def benefit(rule, k, i, j):  # type: ignore[no-untyped-def]
    """Return the benefit of agent i on task j at step k."""
    if rule.table.shape[0] > 0:
        return rule.table[k, i, j]
    return lookup(rule, k, i, j)


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def earned(rule, k, i, before, j):  # type: ignore[no-untyped-def]
    """Return what agent i earns on task j at step k after it held the task `before` (-1: the first step is free)."""
    gain = benefit(rule, k, i, j)
    if before < 0 or (rule.idle_is_free and not gain > 0.0 and rule.forfeit == 0.0):
        return gain
    if rule.real[before] == rule.real[j] and (
        k == 0 or not rule.needs_sight or benefit(rule, k - 1, i, before) > 0.0
    ):
        return gain
    if rule.idle_is_free and not gain > 0.0:
        return gain
    charge = rule.matrix[before, j] if rule.matrix.shape[0] > 0 else rule.cost
    return gain - charge - rule.forfeit * max(gain, 0.0)


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def entered(rule, k, i, j):  # type: ignore[no-untyped-def]
    """Return what agent i earns on task j at step k after another task, without what a matrix charges for the way."""
    gain = benefit(rule, k, i, j)
    if rule.idle_is_free and not gain > 0.0:
        return gain
    charge = 0.0 if rule.matrix.shape[0] > 0 else rule.cost
    return gain - charge - rule.forfeit * max(gain, 0.0)


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def span(rule, plan, i, first, last):  # type: ignore[no-untyped-def]
    """Return what agent i earns over the steps first..last - 1, and by going on from there."""
    total = 0.0
    before = plan[first - 1, i] if first > 0 else rule.initial[i]
    for k in range(first, min(last + 1, plan.shape[0])):
        j = plan[k, i]
        total += earned(rule, k, i, before, j)
        before = j
    return total


@njit(borrows=True, nogil=True)
def total_value(rule, plan):  # type: ignore[no-untyped-def]
    """Return the value of a plan (T, n)."""
    total = 0.0
    for i in range(plan.shape[1]):
        total += span(rule, plan, i, np.int64(0), plan.shape[0])
    return total
