"""The rule of `SwitchingCost` once more, in plain numpy: what certificates are verified with.

Shares nothing with the model but the parameters, and no kernel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Setting, Switching

_BLOCK = 2_000_000  # entries of the largest array built at once


@dataclass(frozen=True, eq=False)
class PlainSwitching:
    """Values of plans and of priced paths by the definition (a `sapopt.dynamics.base.Plain`)."""

    rule: Switching
    problem: Setting

    @property
    def largest_charge(self) -> float:
        """The dearest move."""
        return self.rule.largest_cost

    def terms(self, tasks: IntArray) -> FloatArray:
        """Benefit and handover (2, T, n) of every pair of a plan, each without a rounding error."""
        out = np.empty((2, *tasks.shape))
        agents = np.arange(self.problem.n)
        held = self.problem.initial_assignment
        for k in range(self.problem.T):
            benefit = dense_step(self.problem.benefits.step(k))[agents, tasks[k]]
            out[:, k] = benefit, -_charges(self.rule, held, tasks[k], benefit)
            held = tasks[k]
        return out

    def path_values(self, prices: FloatArray) -> FloatArray:
        """Value (n,) of every agent's best path under the prices: the maximum over all sequences of tasks."""
        return np.concatenate(
            [_best_paths(self.rule, self.problem, prices, block) for block in self._blocks()]
        )

    def _blocks(self) -> Iterator[IntArray]:
        """Groups of agents whose arrays stay small."""
        n, m = self.problem.n, self.problem.m
        size = max(1, _BLOCK // (m if self.rule.uniform_cost is not None else m**2))
        for first in range(0, n, size):
            yield np.arange(first, min(first + size, n))


def _charges(rule: Switching, held: IntArray | None, tasks: IntArray, benefit: FloatArray) -> FloatArray:
    """What every agent pays for its move: the cost if it changes task (and gains by the new one, if idling is free)."""
    if held is None:
        return np.zeros(len(tasks))
    if rule.uniform_cost is not None:
        charge = np.where(tasks != held, rule.uniform_cost, 0.0)
    else:
        charge = np.asarray(rule.cost)[held, tasks]
    return np.where(benefit > 0, charge, 0.0) if rule.idle_is_free else charge


def _best_paths(rule: Switching, problem: Setting, mu: FloatArray, agents: IntArray) -> FloatArray:
    """Value of each agent's best path under the prices: the maximum over all sequences of tasks, by recursion.

    ``best[i, j]`` is the value of the best path of agent i up to step k that ends on task j.
    """
    best = np.empty(0)
    for k in range(problem.T):
        step = problem.benefits.step(k)
        benefit = step[agents] if isinstance(step, np.ndarray) else step[agents].toarray()
        if k == 0:
            arrive = -_first_charges(rule, problem.initial_assignment, benefit, agents)
        elif rule.uniform_cost is not None:
            free = best.max(axis=1, keepdims=True)
            paid = free - rule.uniform_cost
            arrive = np.maximum(best, np.where(benefit > 0, paid, free) if rule.idle_is_free else paid)
        else:
            paid = (best[:, :, None] - np.asarray(rule.cost)[None]).max(axis=1)
            free = best.max(axis=1, keepdims=True)
            arrive = np.where(benefit > 0, paid, free) if rule.idle_is_free else paid
        best = arrive + (benefit - mu[k])
    return np.asarray(best.max(axis=1))


def _first_charges(
    rule: Switching, initial: IntArray | None, benefit: FloatArray, agents: IntArray
) -> FloatArray:
    """Charge of every agent for every task at the first step."""
    if initial is None:
        return np.zeros_like(benefit)
    held = initial[agents]
    if rule.uniform_cost is not None:
        charge = np.full_like(benefit, rule.uniform_cost)
        charge[np.arange(len(agents)), held] = 0.0
    else:
        charge = np.asarray(rule.cost)[held]
    return np.where(benefit > 0, charge, 0.0) if rule.idle_is_free else charge
