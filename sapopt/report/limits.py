"""What the page tells of limits, and of pairs that a plan does not hold."""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.formulations.limited.why import explanations
from sapopt.problem.result import Result
from sapopt.problem.sap import SAP
from sapopt.report.moments import told_limit

_ROWS = 300
"""Sums of limits shown, the dearest and the tightest first."""
_CELLS = 200_000
"""Steps x agents x tasks up to which the page says why a plan does not hold some pairs: it takes a second or so."""
_PAIRS = 24
"""Pairs explained."""
_SECONDS = 5.0
"""For prices, where a result has none."""


def limits_of(problem: SAP, result: Result) -> dict[str, Any] | None:
    """Use, bounds, cost and price of every sum; None where there are no limits."""
    uses = result.evaluation.limits
    if not uses:
        return None
    y = result.limit_prices
    price = np.zeros(len(uses)) if y is None or len(y) != len(uses) else np.abs(y)
    known = y is not None and len(y) == len(uses)
    order = sorted(range(len(uses)), key=lambda r: (-uses[r].cost, -price[r], uses[r].slack))
    rows = [
        {
            "name": told_limit(problem, uses[r].name),
            "use": uses[r].use,
            "most": uses[r].at_most if np.isfinite(uses[r].at_most) else None,
            "least": uses[r].at_least if np.isfinite(uses[r].at_least) else None,
            "slack": uses[r].slack,
            "cost": uses[r].cost,
            "price": float(price[r]) if known else None,
        }
        for r in order[:_ROWS]
    ]
    return {"count": len(uses), "rows": rows}


def why_of(problem: SAP, result: Result) -> list[dict[str, Any]]:
    """For each agent the pair of greatest benefit that it does not hold, and what any plan with it is worth at most.

    Nothing for large problems, and for rules whose agents' paths depend on each other.
    """
    if problem.T * problem.n * problem.m > _CELLS or not problem.model.is_agent_local:
        return []
    best: list[tuple[float, tuple[int, int, int]]] = []
    benefits = np.stack([dense_step(problem.benefits.step(k)) for k in range(problem.T)])
    held = np.nonzero(result.plan >= 0)
    benefits[(*held, result.plan[held])] = -np.inf
    for agent in range(problem.n):
        k, j = divmod(int(np.argmax(benefits[:, agent])), problem.m)
        if benefits[k, agent, j] > 0:
            best.append((float(benefits[k, agent, j]), (agent, j, k)))
    best.sort(key=lambda entry: -entry[0])
    pairs = [pair for _, pair in best[:_PAIRS]]
    if not pairs:
        return []
    try:
        told = explanations(problem, result, pairs, time_limit=_SECONDS)
    except ValueError:  # too many arcs, or no finite states
        return []
    return [
        {
            "agent": one.agent, "task": one.task, "step": one.step, "held": one.held, "holders": list(one.holders),
            "bound": one.bound if np.isfinite(one.bound) else None, "value": one.value,
            "limits": [told_limit(problem, name) for name in one.limits],
        }
        for one in told
    ]  # fmt: skip
