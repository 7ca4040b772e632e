"""The two greedy rules against their definitions."""

from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import given
from strategies import FORMS, Instance, instances, random_instances

from sapopt import SAP, SwitchingCost, solve
from sapopt.solvers import Greedy, MyopicGreedy

# --- Greedy: the thesis' GA ---


def ga_by_definition(benefits: np.ndarray, initial: Any) -> np.ndarray:
    """Section 4.1 in plain Python: who sees its task keeps it, the others choose by index, the rest wait."""
    steps, n, m = benefits.shape
    plan = np.full((steps, n), -1)
    before = [-1] * n if initial is None else list(initial)
    for k in range(steps):
        now = [before[i] if before[i] >= 0 and benefits[k, i, before[i]] > 0 else -1 for i in range(n)]
        for i in range(n):
            free = [j for j in range(m) if j not in now and benefits[k, i, j] > 0]
            if now[i] < 0 and free:
                now[i] = max(free, key=lambda j, i=i, k=k: benefits[k, i, j])
        for i in range(n):
            if now[i] < 0 and before[i] >= 0 and before[i] not in now:
                now[i] = before[i]
        for i in range(n):
            if now[i] < 0:
                now[i] = min(set(range(m)) - set(now))
        plan[k] = before = now
    return plan


def test_greedy_is_the_definition() -> None:
    """Dense and sparse, with tasks in and out of view and an initial assignment, ties to the lowest task."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n, m = int(rng.integers(1, 5)), int(rng.integers(5, 8))
        values = rng.integers(0, 4, (6, n, m)) * (rng.random((6, n, m)) < 0.5).astype(float)
        initial = rng.permutation(m)[:n] if seed % 2 else None
        expected = ga_by_definition(values, initial)
        for form in (values, [sp.csr_array(step) for step in values]):
            problem = SAP(form, SwitchingCost(0.5, idle_is_free=bool(seed % 3)), initial)
            np.testing.assert_array_equal(solve(problem, Greedy()).plan, expected)


def test_greedy_stays_until_out_of_view() -> None:
    """A much better task does not tempt an agent that still sees its own; handovers are not looked at."""
    values = np.array([[[1.0, 0.0, 0.5]], [[0.1, 9.0, 0.0]], [[0.0, 2.0, 3.0]]])
    for form in (values, [sp.csr_array(step) for step in values]):
        assert solve(SAP(form, 5.0), Greedy()).plan.tolist() == [[0], [0], [2]]


def test_greedy_counts_the_initial_assignment() -> None:
    """An agent that starts on a task in view keeps it."""
    assert solve(SAP([[[1.0, 9.0]]], 0.5, [0]), Greedy()).plan.tolist() == [[0]]
    assert solve(SAP([[[0.0, 9.0]]], 0.5, [0]), Greedy()).plan.tolist() == [[1]]


def test_greedy_gives_a_conflict_to_the_lower_index() -> None:
    """The first agent takes the task although the second needs it more."""
    assert solve(SAP([[[1.0, 0.9], [10.0, 0.1]]]), Greedy()).plan.tolist() == [[0, 1]]


@given(instances(forbid=True))
def test_greedy_stays_feasible(instance: Instance) -> None:
    """Where the rule would leave an agent without an allowed task, some choice gives way."""
    for form in FORMS:
        result = solve(instance.problem(form), Greedy())
        assert np.isfinite(instance.score(result.plan))


def test_greedy_out_of_a_dead_end() -> None:
    """Agent 1 may only take the task that agent 0 prefers; agent 2's choice stands."""
    values = np.array([[5.0, 1.0, 0.0, 0.0], [0.0, -np.inf, -np.inf, -np.inf], [0.0, 0.0, 0.0, 7.0]])
    for form in (values[None], [sp.csr_array(values)]):
        plan = solve(SAP(form), Greedy()).plan[0]
        assert plan[1] == 0
        assert plan[2] == 3


# --- MyopicGreedy ---


def myopic_by_definition(instance: Instance) -> np.ndarray:
    """Agents in ascending index take the free task of greatest beta_hat; without ties."""
    steps, n, m = instance.benefits.shape
    plan = np.empty((steps, n), dtype=np.int64)
    before: Any = [None] * n if instance.initial is None else instance.initial
    for k in range(steps):
        free = set(range(m))
        for i in range(n):
            plan[k, i] = max(
                free, key=lambda j: instance.benefits[k, i, j] - instance.charge(k, i, before[i], j)
            )
            free.remove(int(plan[k, i]))
        before = plan[k]
    return plan


def test_myopic_is_the_definition() -> None:
    """Without ties, in every form of benefits and cost, the initial assignment included."""
    for instance in random_instances(24, seed=1, steps=5, n=4, m=6):
        expected = myopic_by_definition(instance)
        for form in FORMS:
            np.testing.assert_array_equal(solve(instance.problem(form), MyopicGreedy()).plan, expected)


def test_myopic_honours_the_initial_assignment() -> None:
    """The initial task is kept when leaving costs more than it brings."""
    values = np.array([[[1.0, 1.2, 0.0]]])
    for form in ([sp.csr_array(values[0])], values):
        assert solve(SAP(form, 0.5, [0]), MyopicGreedy()).plan.tolist() == [[0]]
        assert solve(SAP(form, 0.1, [0]), MyopicGreedy()).plan.tolist() == [[1]]
        assert solve(SAP(form, 0.5), MyopicGreedy()).plan.tolist() == [[1]]


def test_myopic_is_greedy() -> None:
    """The first agent takes its best task although the second needs it more."""
    values = np.array([[[1.0, 0.9], [10.0, 0.1]]])
    result = solve(SAP(values), MyopicGreedy())
    assert result.plan.tolist() == [[0, 1]]
    assert result.value == 1.1


def test_myopic_idle_agents_give_way() -> None:
    """In a sparse problem an agent without a benefit does not take the task of a later one."""
    values = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert solve(SAP([sp.csr_array(values)], 0.5), MyopicGreedy()).plan.tolist() == [[1, 0]]


@given(instances(forbid=True))
def test_myopic_stays_feasible(instance: Instance) -> None:
    """Where greed would leave an agent without an allowed task, it gives way."""
    for form in FORMS:
        result = solve(instance.problem(form), MyopicGreedy())
        assert np.isfinite(instance.score(result.plan))


def test_myopic_out_of_a_dead_end() -> None:
    """Agent 0 prefers the only task that agent 1 may take."""
    values = np.array([[5.0, 1.0, 0.0], [1.0, -np.inf, -np.inf]])
    for form in (values[None], [sp.csr_array(values)]):
        assert solve(SAP(form), MyopicGreedy()).plan.tolist() == [[1, 0]]
