"""Why a plan does not hold a pair: what the prices prove about every plan that does."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sapopt.data.naming import Naming
from sapopt.data.types import IntArray
from sapopt.formulations.bounds import cancellation
from sapopt.formulations.limited.ascent import Ascent
from sapopt.formulations.limited.building import path_graph
from sapopt.formulations.limited.disturbed import untangled
from sapopt.formulations.limited.dual import Prices, dual_value, rounding
from sapopt.kernels import clock
from sapopt.problem.limit import chosen
from sapopt.problem.result import Result
from sapopt.problem.sap import SAP


@dataclass(frozen=True)
class Explanation:
    """What is proven about plans in which an agent holds a task at a step.

    Attributes
    ----------
    agent, task, step : int
    bound : float
        No plan with this pair is worth more; -inf if there is none at all.
    value : float
        Of the plan it is compared with.
    holders : tuple of int
        Agents that hold the task at this step in the plan.
    held : int
        Task that the agent holds there in the plan; -1 for nothing.
    limits : tuple of str
        Limits with a price that the pair would use up.
    naming : Naming
        What the text calls agents, tasks and steps.
    """

    agent: int
    task: int
    step: int
    bound: float
    value: float
    holders: tuple[int, ...]
    held: int
    limits: tuple[str, ...]
    naming: Naming = field(default_factory=Naming)

    @property
    def is_settled(self) -> bool:
        """Whether it is proven that no plan with the pair is better than this one."""
        return self.bound <= self.value

    def __str__(self) -> str:
        names = self.naming
        pair = f"{names.agent(self.agent)} on {names.task(self.task)} at {names.step(self.step)}"
        if self.held == self.task:
            return f"The plan has {pair}."
        if self.bound == -math.inf:
            return f"No plan has {pair}."
        said = f"Any plan with {pair} is worth at most {self.bound:.6g}; yours is worth {self.value:.6g}."
        if self.holders:
            who = names.agent(self.holders[0]) if len(self.holders) == 1 else names.several(self.holders)
            said += f" The task is held by {who}."
        if self.limits:
            said += f" In its way: {', '.join(self.limits)}."
        return said


def why_not(
    problem: SAP,
    result: Result,
    agent: int | str,
    task: int | str,
    step: int,
    *,
    time_limit: float | None = None,
) -> Explanation:
    """Say what any plan is worth at most in which an agent holds a task at a step.

    The prices of the result are taken, or else minimised anew. A plan with the pair is worth at most the bound, less
    what the agent's best priced path loses by going through the pair.

    Parameters
    ----------
    problem : SAP
        With agent-local dynamics.
    result : Result
        The plan to compare with.
    agent, task : int or str
        Index or label.
    step : int
    time_limit : float, optional
        Seconds for the prices, if they have to be found.

    Returns
    -------
    Explanation

    Raises
    ------
    ValueError
        If there is no such agent, task or step, or the dynamics is not agent-local.
    """
    i = _one(agent, problem.n, problem.agents, "agent")
    j = _one(task, problem.m, problem.tasks, "task")
    k = _one(step, problem.T, None, "step")
    return explanations(problem, result, [(i, j, k)], time_limit=time_limit)[0]


def explanations(
    problem: SAP, result: Result, pairs: Sequence[tuple[int, int, int]], *, time_limit: float | None = None
) -> list[Explanation]:
    """The same for several pairs (agent, task, step) by index, from one set of prices.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local.
    """
    plan = problem.check_plan(result.plan)
    value = problem.evaluate(plan).value
    core = untangled(problem.core, exact=True)
    if core.capacity is None:
        core = copy.copy(core)
        core.core, core.capacity = core, np.ones((core.T, core.m), dtype=np.int64)
    graph = path_graph(core, also=[(i, j) for i, j, _ in pairs])
    prices = _prices(problem, core, result)
    if prices is None:
        stop_at = np.inf if time_limit is None else clock.now() + time_limit
        prices = Ascent(graph, stop_at, target=value).run().prices
    dual = dual_value(graph, prices)
    weight = graph.priced(dual.prices.effective(core.rows), dual.prices.limits)
    loss = graph.through(weight)
    allowance = 2.0 * rounding(graph, dual.prices, dual.bound) + cancellation(core)
    out = []
    for i, j, k in pairs:
        arcs = np.flatnonzero((graph.cell == k * core.m + j) & (graph.agent == i))
        proven = dual.bound - float(loss[arcs].min(initial=np.inf))
        if math.isfinite(proven):
            proven += allowance
        holders: IntArray = np.flatnonzero(plan[k] == j)
        touched = np.zeros(core.rows.count, dtype=bool)
        if core.rows.count and len(arcs):
            touched = (abs(graph.weights[:, arcs]).sum(axis=1) > 0) & (dual.prices.limits != 0)
        names = tuple(core.rows.names[r] for r in np.flatnonzero(touched))
        others = tuple(int(a) for a in holders if a != i)
        held = int(plan[k, i])
        out.append(Explanation(i, j, k, float(proven), value, others, held, names, problem.naming))
    return out


def _one(value: int | str, count: int, labels: tuple[str, ...] | None, name: str) -> int:
    found = chosen(value, count, labels, name)
    if len(found) != 1:
        raise ValueError(f"{name} must be one index or label, got {value!r}")
    return int(found[0])


def _prices(problem: SAP, core: SAP, result: Result) -> Prices | None:
    """Those of the result, where it has all that the problem needs."""
    count, teams = core.rows.count, len(core.rows.team_cell)
    if result.prices is None or np.shape(result.prices) != (problem.T, problem.m):
        return None
    limits = np.zeros(count) if result.limit_prices is None else result.limit_prices
    helpers = np.zeros(teams) if result.team_prices is None else result.team_prices
    if np.shape(limits) != (count,) or np.shape(helpers) != (teams,):
        return None
    wide = np.zeros((core.T, core.m))
    wide[:, : problem.m] = result.prices
    return Prices(wide, limits, helpers)
