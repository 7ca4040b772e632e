"""Plans of copies as those of single agents: the same value near the plan, the same sets of tasks, the best order."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from sapopt import SAP, SwitchingCost, solve
from sapopt.formulations.synthetic import synthetic_agents
from sapopt.solvers import HAAL, DualDecomposition
from sapopt.solvers.dual_decomposition.copied_plans import CopiedPlans

SEEDS = range(12)


def builder(seed: int) -> CopiedPlans:
    """Of a small random problem, with groups of one to three copies."""
    rng = np.random.default_rng(seed)
    T, n, m = 5, 3, 6
    benefits = [sp.csr_array(rng.random((n, m)) * (rng.random((n, m)) < 0.6)) for _ in range(T)]
    rule = SwitchingCost(0.3, idle_is_free=bool(seed % 2))
    base = SAP(benefits, rule, rng.permutation(m)[:n] if seed % 3 == 0 else None)
    problem = synthetic_agents(base, [1, 2, 3], float(rng.choice([1.0, 0.7]))).problem
    oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
    return CopiedPlans(problem, oracle, threads=1)


def some_plan(problem: SAP, seed: int) -> np.ndarray:
    """A random plan that serves some of what is in sight."""
    rng = np.random.default_rng(seed)
    plan = solve(problem, HAAL(2)).plan.copy()
    for k in range(problem.T):
        one, other = rng.integers(0, problem.n, 2)
        plan[k, [one, other]] = plan[k, [other, one]]
    return plan


@pytest.mark.parametrize("seed", SEEDS)
def test_alike_at_the_plan(seed: int) -> None:
    """At the plan in its best order single agents are worth the same; any other plan at least what it is worth."""
    made = builder(seed)
    plan = made.tidied(some_plan(made.problem, seed))
    arrays, places = made.alike(plan), made._place_prices(plan)
    sizes = made._paths.groups.size
    least = (places.min(axis=2) * sizes).sum()
    constant = places[np.isfinite(places)].sum() - least
    assert arrays.value(made.kept(plan)) + constant == pytest.approx(made.problem.evaluate(plan).value)
    for other in range(5):
        different = some_plan(made.problem, 100 * seed + other)
        promised = arrays.value(made.kept(different)) + constant
        assert promised >= made.problem.evaluate(different).value - 1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_orders_keep_the_sets(seed: int) -> None:
    """Both orders hold the sets of tasks of every group; the best one is never worth less."""
    made = builder(seed)
    plan = some_plan(made.problem, seed)
    group = made._paths.group
    for ordered in (made.tidied(plan), made.kept(plan)):
        for g in range(3):
            np.testing.assert_array_equal(
                np.sort(ordered[:, group == g], axis=1), np.sort(plan[:, group == g], axis=1)
            )
    value = made.problem.evaluate(plan).value
    assert made.problem.evaluate(made.tidied(plan)).value >= value - 1e-9
    assert (
        made.problem.evaluate(made.kept(plan)).value <= made.problem.evaluate(made.tidied(plan)).value + 1e-9
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_better_than_lookahead(seed: int) -> None:
    """The whole search finds at least what HAAL finds, and its bound is not far."""
    problem = builder(seed).problem
    found = solve(problem, DualDecomposition(rounds=4))
    assert found.value >= solve(problem, HAAL(3)).value
    assert found.gap is not None
    assert found.gap < 0.03
