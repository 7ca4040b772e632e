"""The bound that prices prove where agents are copies of one another, from the definition alone: plain numpy.

Every copy of a real agent has the same choice at every step: a task, at the greatest benefit less price of place that a
copy of the agent has for it. Why that bounds the value of all plans is written in `sapopt.dynamics.copies.groups`;
nothing of its code is used here.
"""

from __future__ import annotations

import math

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.copies.model import SyntheticSwitching
from sapopt.problem.sap import SAP

_EPS = float(np.finfo(np.float64).eps)


def groups_bound(problem: SAP, prices: FloatArray) -> float:
    """Upper bound of the optimal value that prices prove, rounded to the safe side.

    Parameters
    ----------
    problem : SAP
        With a `SyntheticSwitching`.
    prices : (T, m + n) float array
        Finite, not negative: of every task, and of every agent's place among the copies of its real agent.

    Raises
    ------
    ValueError
        If the dynamics is another one, or the numbers overflow.
    """
    rule = problem.model.copies()
    if rule is None:
        raise ValueError(f"dynamics: {problem.model.called} has no plain path recursion to verify with")
    agent_of = rule.real_agents(problem.n)
    total, size = [*prices.ravel().tolist()], 0.0
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below
        for real_agent in np.unique(agent_of):
            copies = np.flatnonzero(agent_of == real_agent)
            total += _path_values(problem, rule, copies, prices).tolist()
        for k in range(problem.T):
            entries = dense_step(problem.benefits.step(k))
            most = float(np.abs(entries[np.isfinite(entries)]).max(initial=0.0))
            size += (1.0 + rule.forfeit) * most + rule.cost + 2.0 * float(prices[k].max())
    bound = math.fsum(total) if np.isfinite(total).all() else math.inf
    # A path's value is the result of at most 8 T roundings of numbers no larger than `size`.
    rounding = 8 * problem.T * _EPS * problem.n * size + _EPS * abs(bound)
    if not math.isfinite(bound + rounding):
        raise ValueError("prices and benefits are so large that the bound overflows")
    return math.nextafter(math.nextafter(bound + rounding, math.inf), math.inf)


def _path_values(problem: SAP, rule: SyntheticSwitching, copies: IntArray, prices: FloatArray) -> FloatArray:
    """Values of the longest paths of the copies of one real agent; all but where they begin is the same for them."""
    m = problem.m
    real = rule.real_tasks(m)
    none = int(real.max()) + 1
    # Who has several copies enters a task that has several copies without paying: see the module that is named above.
    never_pays = np.bincount(real)[real] > 1 if len(copies) > 1 else np.zeros(m, dtype=bool)
    to_go = np.zeros(none + 2)  # by the real task held; then: nothing held; the first step is free
    for k in range(problem.T - 1, -1, -1):
        benefit = dense_step(problem.benefits.step(k))[copies]
        place = prices[k, m + copies][:, None]
        charge = rule.cost + rule.forfeit * np.maximum(benefit, 0.0)
        if rule.idle_is_free:
            charge = np.where(benefit > 0, charge, 0.0)
        kept = (benefit - place).max(axis=0)
        moved = np.where(never_pays, kept, (benefit - charge - place).max(axis=0))
        counts = (benefit > 0).any(axis=0) if rule.needs_sight else np.ones(m, dtype=bool)
        onward = to_go[np.where(counts, real, none)] - prices[k, :m]
        before = np.full(none + 2, (moved + onward).max())
        np.maximum.at(before, real, kept + onward)
        before[none + 1] = (kept + onward).max()
        to_go = before
    start = problem.initial_assignment
    if start is None:
        return np.full(len(copies), to_go[none + 1])
    held = np.where(start >= 0, real[start], none)[copies]
    return to_go[held]
