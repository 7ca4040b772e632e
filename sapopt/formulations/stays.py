"""Stays: one 0/1 number for every time that an agent may hold a task without a break.

A *stay* is an agent on a task over the steps ``first .. stop - 1``. With one cost for every move, a stay is worth the
benefits of its steps less the cost of entering it, whatever came before; so the problem is to cover every agent's steps
exactly once, and every task's steps at most once. As a linear programme this is as tight as the time-expanded network,
with a tenth of its rows; there are ``n m T (T + 1) / 2`` stays, of which only those matter that prices leave in play.

A `sapopt.formulations.reduction.Formulation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import Programme
from sapopt.problem.sap import SAP

LIMIT = 1_000_000
"""Stays that are written down; beyond that the network is the right form."""


@dataclass(frozen=True, eq=False)
class Stays:
    """Stays as flat arrays, sorted by agent, first step and stop.

    Attributes
    ----------
    shape : (T, n, m)
    agent, task, first, stop : ndarray of int64, shape (stays,)
        Agent i holds task j over the steps ``first .. stop - 1``.
    gain : ndarray, shape (stays,)
        Benefits less the cost of entering.
    """

    shape: tuple[int, int, int]
    agent: IntArray
    task: IntArray
    first: IntArray
    stop: IntArray
    gain: FloatArray

    def __len__(self) -> int:
        return len(self.gain)

    @cached_property
    def _group(self) -> tuple[IntArray, IntArray]:
        """Where a new (agent, first, stop) begins, and the number of that triple."""
        T, _, _ = self.shape
        key = (self.agent * T + self.first) * (T + 1) + self.stop
        start = np.flatnonzero(np.diff(key, prepend=-1))
        return start, key[start]

    def only(self, keep: np.ndarray) -> Stays:
        """The stays of a mask."""
        return Stays(
            self.shape, self.agent[keep], self.task[keep], self.first[keep], self.stop[keep], self.gain[keep]
        )

    def priced(self, prices: FloatArray) -> FloatArray:
        """Gains less the prices (T, m) of the steps held."""
        total = np.concatenate([np.zeros((1, self.shape[2])), np.cumsum(prices, axis=0)])
        out: FloatArray = self.gain - (total[self.stop, self.task] - total[self.first, self.task])
        return out

    def less_wages(self, weight: FloatArray, wages: FloatArray) -> FloatArray:
        """Weights less the wages (T, n) of the agent's steps."""
        total = np.concatenate([np.zeros((1, self.shape[1])), np.cumsum(wages, axis=0)])
        out: FloatArray = weight - (total[self.stop, self.agent] - total[self.first, self.agent])
        return out

    def through(self, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values of the agents' best ways through all steps (n,), and of the best way through every stay."""
        T, n, _ = self.shape
        start, key = self._group
        flat = np.full(n * T * (T + 1), -np.inf)
        if len(start):
            flat[key] = np.maximum.reduceat(weight, start)
        best = flat.reshape(n, T, T + 1)
        before, after = np.full((n, T + 1), -np.inf), np.full((n, T + 1), -np.inf)
        before[:, 0] = after[:, T] = 0.0
        for k in range(1, T + 1):
            before[:, k] = (before[:, :k] + best[:, :k, k]).max(axis=1)
        for k in range(T - 1, -1, -1):
            after[:, k] = (after[:, k + 1 :] + best[:, k, k + 1 :]).max(axis=1)
        return before[:, T], before[self.agent, self.first] + weight + after[self.agent, self.stop]

    def rows(self, chosen: IntArray) -> sp.csc_array:
        """Which steps of agents (rows ``k + T i``) and of tasks (rows ``T n + k + T j``) the chosen stays fill."""
        T, n, m = self.shape
        first, length = self.first[chosen], self.stop[chosen] - self.first[chosen]
        ends = np.cumsum(length)
        column = np.repeat(np.arange(len(chosen)), length)
        step = np.arange(int(length.sum())) - np.repeat(ends - length, length) + np.repeat(first, length)
        whose = np.repeat(self.agent[chosen], length) * T + step
        what = (n + np.repeat(self.task[chosen], length)) * T + step
        return sp.csc_array(
            (np.ones(2 * len(column)), (np.concatenate([whose, what]), np.concatenate([column, column]))),
            shape=((n + m) * T, len(chosen)),
        )

    @property
    def sides(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest number of stays in every row of `rows`."""
        T, n, m = self.shape
        return np.concatenate([np.ones(n * T), np.full(m * T, -np.inf)]), np.ones((n + m) * T)

    def programme(self, keep: np.ndarray | None = None) -> Programme:
        """Cover every agent's steps once and every task's at most once, with the stays of the mask `keep`."""
        chosen = np.arange(len(self)) if keep is None else np.flatnonzero(keep)
        count = len(chosen)
        low, high = self.sides
        return Programme(
            self.gain[chosen], self.rows(chosen), low, high, np.ones(count), np.ones(count, dtype=bool)
        )

    def follow(self, plan: IntArray) -> np.ndarray:
        """Mask of the stays that a plan (T, n) consists of."""
        T, n, _ = self.shape
        breaks = np.ones((T + 1, n), dtype=bool)
        breaks[1:T] = plan[1:] != plan[:-1]
        whole = self.compatible(plan, np.zeros(plan.shape, dtype=bool))
        mask: np.ndarray = whole & breaks[self.first, self.agent] & breaks[self.stop, self.agent]
        return mask

    def compatible(self, plan: IntArray, free: np.ndarray) -> np.ndarray:
        """Mask of the stays that agree with a plan (T, n) on all steps of the agent that are not in (T, n) `free`."""
        T, n, m = self.shape
        fixed = np.zeros((T + 1, n), dtype=np.int64)
        fixed[1:] = np.cumsum(~free, axis=0)
        agreeing = np.zeros((T + 1, n, m), dtype=np.int64)
        held = np.zeros((T, n, m), dtype=np.int64)
        np.put_along_axis(held, plan[:, :, None], (~free)[:, :, None].astype(np.int64), axis=2)
        agreeing[1:] = np.cumsum(held, axis=0)
        i, j = self.agent, self.task
        mask: np.ndarray = (
            fixed[self.stop, i] - fixed[self.first, i]
            == agreeing[self.stop, i, j] - agreeing[self.first, i, j]
        )
        return mask

    def plan_of(self, chosen: IntArray) -> IntArray:
        """The plan (T, n) that chosen stays make up."""
        T, n, _ = self.shape
        plan = np.full((T, n), -1)
        for c in chosen:
            plan[self.first[c] : self.stop[c], self.agent[c]] = self.task[c]
        return plan


def refusal(problem: SAP) -> str | None:
    """None, or the reason why the problem is not written in stays."""
    rule = problem.model.switching()
    if rule is None or rule.uniform_cost is None:
        return "only a SwitchingCost with one cost makes a stay worth the same whatever came before"
    T, n, m = problem.benefits.shape
    count = n * m * T * (T + 1) // 2
    if count > LIMIT:
        return f"{count} stays are too many"
    return None


def formulate(problem: SAP) -> Stays:
    """All stays of a problem, without those that are forbidden.

    Raises
    ------
    ValueError
        If the problem is not accepted.
    """
    reason = refusal(problem)
    if reason:
        raise ValueError(f"dynamics: {reason}")
    T, n, m = problem.benefits.shape
    benefit = problem.benefits.dense()
    rule = problem.model.switching()
    assert rule is not None
    assert rule.uniform_cost is not None
    forbidden = np.isneginf(benefit)
    worth = np.where(forbidden, 0.0, benefit)
    entering = np.full((T, n, m), -rule.uniform_cost)
    if rule.idle_is_free:
        entering *= benefit > 0
    entering[0] = problem.handover(0, problem.initial_state())
    total, closed = np.zeros((T + 1, n, m)), np.zeros((T + 1, n, m), dtype=np.int64)
    total[1:], closed[1:] = np.cumsum(worth, axis=0), np.cumsum(forbidden, axis=0)
    first, stop = np.triu_indices(T)
    stop = stop + 1
    gain = total[stop] - total[first] + entering[first]
    gain[closed[stop] > closed[first]] = -np.inf
    by_agent = gain.transpose(1, 0, 2)  # (n, spans, m)
    agent, span, task = np.nonzero(by_agent > -np.inf)
    return Stays((T, n, m), agent, task, first[span], stop[span], by_agent[agent, span, task])


def recover(stays: Stays, x: FloatArray, keep: np.ndarray | None = None) -> IntArray:
    """Plan (T, n) of an integral point of ``stays.programme(keep)``."""
    chosen = np.arange(len(stays)) if keep is None else np.flatnonzero(keep)
    return stays.plan_of(chosen[np.asarray(x) > 0.5])
