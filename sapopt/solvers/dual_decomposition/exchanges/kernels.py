"""Compiled exchanges: simulated annealing over segments of a plan (Kirkpatrick, Gelatt and Vecchi 1983).

A move takes a cell that the prices call good for its agent: agent i, step k, task j. If somebody holds j at k, the two
swap all they do over a few steps around k; else i goes to j for as long as it is free. The steps reach from k to where
one of the two changes its task anyhow, or not at all, so that a move opens few new changes. What the whole plan gains
is known from the two paths over these steps and the one after.

A loss is taken with probability ``exp(-loss / temperature)``; the caller lowers the temperature from call to call.
"""

from __future__ import annotations

import math

from sapopt.kernels.jit import njit
from sapopt.solvers.dual_decomposition.exchanges.rule import earned, span

_REACH = 8
"""Steps over which an agent is led back to where it holds the task already."""

_DRAWS = 6
"""Tries to find a free task."""


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def draw(dice):  # type: ignore[no-untyped-def]
    """Return a number in (0, 1) and go on: two multiplicative generators combined, L'Ecuyer (1988)."""
    dice[0] = dice[0] * 40014 % 2147483563
    dice[1] = dice[1] * 40692 % 2147483399
    z = dice[0] - dice[1]
    if z < 1:
        z += 2147483562
    return z / 2147483563.0


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _from_where(plan, i, other, j, k, dice):  # type: ignore[no-untyped-def]
    """Return the first step of a move at step k: where one of the two took up its task, or where i left task j."""
    kind = int(5.0 * draw(dice))
    who = i if kind == 0 or (other < 0 and kind < 3) else other
    first = k
    if kind < 3 and who >= 0:
        while first > 0 and plan[first - 1, who] == plan[k, who]:
            first -= 1
    elif kind == 3:
        for t in range(k - 1, max(k - _REACH, -1), -1):
            if plan[t, i] == j:
                return t + 1
    return first


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _till_where(plan, i, other, j, k, dice):  # type: ignore[no-untyped-def]
    """Return the step after the last one of a move at step k, alike."""
    steps = plan.shape[0]
    kind = int(5.0 * draw(dice))
    who = i if kind == 0 or (other < 0 and kind < 3) else other
    last = k + 1
    if kind < 3 and who >= 0:
        while last < steps and plan[last, who] == plan[k, who]:
            last += 1
    elif kind == 3:
        for t in range(k + 1, min(k + _REACH, steps)):
            if plan[t, i] == j:
                return t
    return last


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _is_taken(gain, temperature, dice):  # type: ignore[no-untyped-def]
    return gain >= 0.0 or (temperature > 0.0 and draw(dice) < math.exp(gain / temperature))


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _shift(rule, plan, owner, i, j, k, first, last, temperature, dice):  # type: ignore[no-untyped-def]
    """Let agent i go to the task j, free at step k, for as long as it is free within the steps; return the gain."""
    start, stop = k, k + 1
    while start > first and owner[start - 1, j] < 0:
        start -= 1
    while stop < last and owner[stop, j] < 0:
        stop += 1
    old = span(rule, plan, i, start, stop)
    new, before = 0.0, plan[start - 1, i] if start > 0 else rule.initial[i]
    for t in range(start, stop):
        new += earned(rule, t, i, before, j)
        before = j
    if stop < plan.shape[0]:
        new += earned(rule, stop, i, before, plan[stop, i])
    if not _is_taken(new - old, temperature, dice):
        return 0.0
    for t in range(start, stop):
        owner[t, plan[t, i]] = -1
        plan[t, i] = j
        owner[t, j] = i
    return new - old


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _swap(rule, plan, owner, i, other, first, last, temperature, dice):  # type: ignore[no-untyped-def]
    """Let two agents swap what they do over some steps; return the gain."""
    old = span(rule, plan, i, first, last) + span(rule, plan, other, first, last)
    for t in range(first, last):
        plan[t, i], plan[t, other] = plan[t, other], plan[t, i]
    new = span(rule, plan, i, first, last) + span(rule, plan, other, first, last)
    if not _is_taken(new - old, temperature, dice):
        for t in range(first, last):
            plan[t, i], plan[t, other] = plan[t, other], plan[t, i]
        return 0.0
    for t in range(first, last):
        owner[t, plan[t, i]] = i
        owner[t, plan[t, other]] = other
    return new - old


@njit(borrows=True, nogil=True)
def anneal(rule, cells, plan, owner, dice, temperature, moves, wandering):  # type: ignore[no-untyped-def]
    """Make some moves in place; return how much more the plan is worth.

    Parameters
    ----------
    cells : (cells, 3)
        Agent, step and task, the most promising first: those are drawn more often.
    plan : (T, n) int64
    owner : (T, m) int32
        Who holds a task, -1 for nobody.
    dice : (2,) int64
        State of the random numbers.
    temperature : float
        At 0 no loss is taken.
    moves : int
    wandering : float
        Share of the moves that try any free task in place of a good cell.
    """
    steps, n = plan.shape
    m = owner.shape[1]
    gained = 0.0
    for _ in range(moves):
        if draw(dice) < wandering:
            i, k, j = int(n * draw(dice)), int(steps * draw(dice)), int(m * draw(dice))
            for _ in range(_DRAWS):
                if owner[k, j] < 0:
                    break
                j = int(m * draw(dice))
            if owner[k, j] >= 0:
                continue
        else:
            u = draw(dice)
            c = int(len(cells) * u * u)
            i, k, j = cells[c, 0], cells[c, 1], cells[c, 2]
            if plan[k, i] == j:
                continue
        other = owner[k, j]
        first, last = _from_where(plan, i, other, j, k, dice), _till_where(plan, i, other, j, k, dice)
        if other < 0:
            gained += _shift(rule, plan, owner, i, j, k, first, last, temperature, dice)
        else:
            gained += _swap(rule, plan, owner, i, other, first, last, temperature, dice)
    return gained
