"""The rules of `Battery` once more, in plain numpy: what certificates are verified with.

Shares nothing with `sapopt.dynamics.battery.model` but the parameters, and no kernel.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Setting

if TYPE_CHECKING:
    from sapopt.dynamics.battery.model import Battery

_BLOCK = 4_000_000  # entries of the largest array built at once


@dataclass(frozen=True, eq=False)
class PlainBattery:
    """Values of plans and of priced paths by the definition (a `sapopt.dynamics.base.Plain`)."""

    rule: Battery
    problem: Setting

    @property
    def largest_charge(self) -> float:
        """The cost of a handover."""
        return self.rule.cost

    def terms(self, tasks: IntArray) -> FloatArray:
        """Benefit and handover (2, T, n) of every pair of a plan, each without a rounding error."""
        return plain_terms(self.rule, self.problem, tasks)

    def path_values(self, prices: FloatArray) -> FloatArray:
        """Value (n,) of every agent's best path under the prices: the maximum over all sequences of tasks."""
        n = self.problem.n
        size = max(1, _BLOCK // ((self.rule.units.capacity + 1) * self.problem.m))
        blocks = (np.arange(first, min(first + size, n)) for first in range(0, n, size))
        return np.concatenate([_block(self.rule, self.problem, prices, block) for block in blocks])


def plain_terms(dynamics: Battery, problem: Setting, tasks: IntArray) -> FloatArray:
    """What every pair of a plan yields and what it pays (2, T, n): every agent is followed, its charge a fraction."""
    drain, charge, capacity = (
        Fraction(x).limit_denominator(10**4) for x in (dynamics.drain, dynamics.charge, dynamics.capacity)
    )
    first = dynamics.capacity if dynamics.initial_charge is None else dynamics.initial_charge
    level = [Fraction(float(x)).limit_denominator(10**4) for x in np.broadcast_to(first, problem.n)]
    held = None if problem.initial_assignment is None else problem.initial_assignment.tolist()
    worked = [held is not None] * problem.n
    terms = np.zeros((2, *tasks.shape))
    for k in range(problem.T):
        benefits = dense_step(problem.benefits.step(k))[np.arange(problem.n), tasks[k]].tolist()
        for i, (task, benefit) in enumerate(zip(tasks[k].tolist(), benefits, strict=True)):
            works = benefit > 0 and level[i] > 0
            if works:
                stays = held is None or (held[i] == task and (worked[i] or dynamics.pay_for == "moves"))
                terms[:, k, i] = benefit, 0.0 if stays else -dynamics.cost
                level[i] = max(level[i] - drain, Fraction(0))
            else:
                terms[0, k, i] = min(benefit, 0.0)
                if level[i] > 0:
                    level[i] = min(level[i] + charge, capacity)
            worked[i] = works
        held = tasks[k].tolist()
    return terms


def _block(dynamics: Battery, problem: Setting, mu: FloatArray, agents: IntArray) -> FloatArray:
    """Values of the paths of some agents, by recursion forwards in time.

    ``best[i, level]`` is the value of the best path of agent i so far that leaves it at that level, wherever it is;
    ``ready[i, level, j]`` that of those after which it may work on task j without paying.
    """
    drain, charge, capacity = dynamics.units[1:]
    count, m = len(agents), problem.m
    start = dynamics.initial_state(problem)
    best = np.full((count, capacity + 1), -np.inf)
    best[np.arange(count), start.levels[agents]] = 0.0
    ready = np.full((count, capacity + 1, m), -np.inf)
    if problem.initial_assignment is None:
        ready[np.arange(count), start.levels[agents]] = 0.0
    else:
        ready[np.arange(count), start.levels[agents], problem.initial_assignment[agents]] = 0.0
    for k in range(problem.T):
        step = problem.benefits.step(k)
        benefit = step[agents] if isinstance(step, np.ndarray) else step[agents].toarray()
        works = benefit > 0
        rest = np.minimum(benefit, 0.0) - mu[k]
        after = np.full_like(best, -np.inf)
        ready_after = np.full_like(ready, -np.inf)
        for level in range(capacity + 1):
            here = best[:, level, None]
            idle = here + rest
            if level == 0:  # dead: no task is work
                after[:, 0] = np.maximum(after[:, 0], idle.max(axis=1))
                continue
            idle = np.where(works, -np.inf, idle)
            work = np.where(
                works, np.maximum(ready[:, level], here - dynamics.cost) + (benefit - mu[k]), -np.inf
            )
            charged, drained = min(level + charge, capacity), max(level - drain, 0)
            after[:, charged] = np.maximum(after[:, charged], idle.max(axis=1))
            after[:, drained] = np.maximum(after[:, drained], work.max(axis=1))
            ready_after[:, drained] = np.maximum(ready_after[:, drained], work)
            if dynamics.pay_for == "moves":
                ready_after[:, charged] = np.maximum(ready_after[:, charged], idle)
        best, ready = after, ready_after
    return np.asarray(best.max(axis=1))
