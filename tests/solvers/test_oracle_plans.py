"""Plans from prices for any agent-local dynamics."""

from __future__ import annotations

import numpy as np
import pytest
from rule_problems import riding, slewing

from sapopt import SAP, solve
from sapopt.data.windows import WindowSums
from sapopt.dynamics.rules import arcs_build
from sapopt.running.outlook import Outlook
from sapopt.solvers import HAA
from sapopt.solvers.dual_decomposition.oracle_plans import plan_by_first_values
from sapopt.solvers.dual_lookahead import assign_first


def by_fresh_graphs(problem: SAP, prices: np.ndarray) -> np.ndarray:
    """The same plan with the paths made anew at every step."""
    state, plan = problem.initial_state(), []
    for k in range(problem.T):
        rest = problem.benefits.slice(k, problem.T)
        outlook = Outlook(k, problem.T, state, problem, WindowSums(rest, first=k), np.arange(problem.m))
        plan.append(assign_first(outlook, problem.model.path_oracle(rest, state), prices[k:]))
        state = problem.transition(k, state, plan[-1])
    return np.array(plan)


@pytest.mark.parametrize("make", [slewing, riding], ids=lambda make: make.__name__)
def test_a_rolling_plan_builds_one_graph(make, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    """The moves of rule-based agents are listed once, not at every step, and the plan is the same."""
    problem, calls, plain = make(3, T=6, n=3), [], arcs_build.arc_graph
    prices = np.random.default_rng(0).random((problem.T, problem.m)) * 0.2
    expected = by_fresh_graphs(problem, prices)
    monkeypatch.setattr(arcs_build, "arc_graph", lambda *args: calls.append(args) or plain(*args))
    plan = plan_by_first_values(problem, prices)
    assert len(calls) == 1
    np.testing.assert_array_equal(plan, expected)
    assert problem.evaluate(plan).value >= solve(problem, HAA()).value - prices.sum()
