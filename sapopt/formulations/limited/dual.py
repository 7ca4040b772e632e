"""The Lagrangian dual of capacities, limits and teams.

A price mu[k, j] >= 0 stands for "at most c[k, j] agents hold task j at step k", a multiplier y for every limit
(positive for its upper bound, negative for its lower one, and no larger than the penalty of a limit that may be
broken), and lambda >= 0 for what a team pays each of its helpers. Every pair is then worth its benefit less mu, less y
times what it adds to the limit, plus lambda; the agents no longer see each other, and for any such prices

    sum_i path_i + sum c mu + sum (y+ at_most - y- at_least) + sum max(0, reward - needs lambda)  >=  optimum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.limited.graph import PathGraph
from sapopt.problem.rows import Rows

_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Prices:
    """A point of the dual.

    Attributes
    ----------
    tasks : ndarray, shape (T, m)
        mu >= 0, of a core's tasks.
    limits : ndarray, shape (rows,)
        y, one for each row.
    teams : ndarray, shape (teams,)
        lambda >= 0.
    """

    tasks: FloatArray
    limits: FloatArray
    teams: FloatArray

    def effective(self, rows: Rows) -> FloatArray:
        """What holding a task at a step costs, shape (T, m): its price less what a team pays."""
        if not len(self.teams):
            return self.tasks
        out = self.tasks.copy()
        np.subtract.at(out.reshape(-1), rows.team_cell, self.teams)
        return out


@dataclass(frozen=True, eq=False)
class LimitedDual:
    """The dual at some prices.

    Attributes
    ----------
    prices : Prices
    bound : float
        A float64 that is certainly not below the optimum.
    arcs : ndarray of int64
        Of the agents' longest paths.
    """

    prices: Prices
    bound: float
    arcs: IntArray


def fitting(rows: Rows, prices: Prices) -> Prices:
    """The prices with what is out of range brought back into it, and teams paid no more than they are worth."""
    high = np.where(np.isfinite(rows.high), rows.penalty, 0.0)
    low = np.where(np.isfinite(rows.low), rows.penalty, 0.0)
    return Prices(
        np.maximum(prices.tasks, 0.0),
        np.clip(prices.limits, -low, high),
        np.clip(prices.teams, 0.0, rows.team_reward / np.maximum(rows.team_needs, 1)),
    )


def fixed_terms(rows: Rows, capacity: IntArray, prices: Prices) -> list[float]:
    """The terms of the dual beside the paths, to be added up exactly."""
    y = prices.limits
    up, down = y > 0, y < 0
    return [
        *(capacity * prices.tasks).ravel().tolist(),
        *(y[up] * rows.high[up]).tolist(),
        *(y[down] * rows.low[down]).tolist(),
        *np.maximum(rows.team_reward - rows.team_needs * prices.teams, 0.0).tolist(),
    ]


def dual_value(graph: PathGraph, prices: Prices) -> LimitedDual:
    """Evaluate the dual; prices out of range are brought back first."""
    problem, rows = graph.problem, graph.problem.rows
    assert problem.capacity is not None
    prices = fitting(rows, prices)
    weight = graph.priced(prices.effective(rows), prices.limits)
    values, arcs = graph.longest(weight)
    fixed = fixed_terms(rows, problem.capacity, prices)
    if not np.isfinite(values).all():  # an agent without any path: no plan at all
        return LimitedDual(prices, math.inf, arcs)
    total = math.fsum([*values.tolist(), *fixed])
    return LimitedDual(prices, total + rounding(graph, prices, total), arcs)


def rounding(graph: PathGraph, prices: Prices, total: float) -> float:
    """What rounding may hide from the dual's value, with the value itself known."""
    problem = graph.problem
    assert problem.capacity is not None
    fixed = fixed_terms(problem.rows, problem.capacity, prices)
    size = 2.0 * _largest(graph, prices) + sum(abs(term) for term in fixed)
    terms = 4.0 * (problem.T + 4) + graph.most_limits
    return terms * _EPS * (size + abs(total))


def _largest(graph: PathGraph, prices: Prices) -> float:
    """At least the sum of the sizes of all numbers that a path of every agent adds up."""
    problem = graph.problem
    size = graph.sizes(prices.limits)
    step = np.maximum(graph.cell, 0) // problem.m
    most = np.zeros(problem.T)
    np.maximum.at(most, step, size)
    paid = prices.tasks.max(axis=1, initial=0.0).sum() + float(prices.teams.sum())
    return problem.n * (2.0 * float(most.sum()) + float(paid))
