"""The power environment: its published settings, its generators, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from batteries import random_case

from sapopt import SwitchingCost, solve
from sapopt.domains.instances import instance, scenario
from sapopt.domains.power import power_constellation
from sapopt.dynamics import Battery
from sapopt.solvers import HAA, AssignmentPolicy, energy_price, power_constrained

CONSTRAINED = AssignmentPolicy(power_constrained)
PRICED = AssignmentPolicy(energy_price)


def test_the_published_settings() -> None:
    """Sizes, priorities, rule and a random initial assignment that the seed decides."""
    built = scenario("power", 3, steps=5)
    problem = built.problem()
    assert (problem.T, problem.n, problem.m) == (5, 324, 450)
    assert built.constellation.step_s == 63.76
    values, counts = np.unique(built.constellation.tasks.priority, return_counts=True)
    assert values.tolist() == [1.0, 5.0]
    assert 0.15 < counts[1] / 450 < 0.35
    assert isinstance(problem.dynamics, Battery)
    assert problem.dynamics.units[1:] == (2, 1, 10)
    assert len(set(problem.initial_assignment.tolist())) == 324  # type: ignore[union-attr]
    assert problem.fingerprint == instance("power", 3, steps=5).fingerprint
    assert problem.fingerprint != instance("power", 4, steps=5).fingerprint
    assert built.graphs(steps=[0])[0].number_of_nodes() == 324


def test_earth_coverage_by_the_text() -> None:
    """Section 6.3: the satellites and places of 4.2.1, every task worth 1, idling free, an orbit in minutes."""
    built, other = scenario("earth-coverage-thesis", 3), scenario("constellation-mid", 3)
    problem = built.problem()
    assert (problem.T, problem.n, problem.m) == (93, 324, 450)
    assert built.constellation.step_s == 60.0
    assert (built.constellation.tasks.priority == 1.0).all()
    np.testing.assert_array_equal(built.constellation.tasks.latitude_deg, other.tasks.latitude_deg)
    assert isinstance(problem.dynamics, SwitchingCost)
    assert (problem.dynamics.cost, problem.dynamics.idle_is_free) == (0.5, True)
    assert problem.initial_assignment is None


def test_rules_can_be_chosen() -> None:
    """What pays, other battery figures, and no battery at all."""
    assert instance("power", steps=2, pay_for="entries").dynamics.pay_for == "entries"
    built = power_constellation(steps=2)
    assert built.problem(0.25, drain=0.5, pay_for="entries").dynamics.drain == 0.5
    coverage = instance("earth-coverage", steps=2)
    assert isinstance(coverage.dynamics, SwitchingCost)
    assert coverage.dynamics.idle_is_free
    assert not instance("earth-coverage", steps=2, idle_is_free=False).dynamics.idle_is_free
    with pytest.raises(ValueError, match="idle_is_free"):
        instance("power", steps=2, idle_is_free=True)
    with pytest.raises(ValueError, match="tasks"):
        power_constellation(tasks=300, steps=2)


def test_generators_keep_satellites_alive() -> None:
    """At the full size nobody dies, and looking after the battery pays many times over."""
    problem = instance("power", 0)
    blind = solve(problem, HAA())
    values = {}
    for policy in (CONSTRAINED, PRICED):
        result = solve(problem, policy)
        values[policy.name] = result.value
        state = problem.initial_state()
        for k in range(problem.T):
            state = problem.transition(k, state, result.plan[k])
            assert state.levels.min() > 0
    assert values[CONSTRAINED.name] > 3 * blind.value
    assert values[PRICED.name] > 1.2 * values[CONSTRAINED.name]


@pytest.mark.parametrize("policy", [CONSTRAINED, PRICED], ids=lambda policy: policy.name)
@pytest.mark.parametrize("seed", range(12))
def test_generators_agree_on_dense_and_sparse(policy: AssignmentPolicy, seed: int) -> None:
    """Two forms of one problem, one matrix, with negative benefits and dead agents among them."""
    case = random_case(seed, steps=5, n=3, m=6)
    values = []
    for form in ("dense", "sparse"):
        seen = []

        def spy(outlook, seen=seen):  # type: ignore[no-untyped-def]
            matrix = policy.generator(outlook)
            seen.append(matrix if isinstance(matrix, np.ndarray) else matrix.toarray())
            return seen[-1]

        solve(case.problem(form), AssignmentPolicy(spy))
        values.append(np.array(seen))
    np.testing.assert_allclose(values[0], values[1], atol=1e-12)


def test_generators_need_batteries() -> None:
    """Elsewhere there is no charge."""
    with pytest.raises(ValueError, match="Battery"):
        solve(instance("constellation-toy"), CONSTRAINED)
