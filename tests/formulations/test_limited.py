"""The dual of capacities, limits and teams, against the linear programme whose value it approaches."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from sapopt import SAP, Limit, SwitchingCost, Team, bound
from sapopt.dynamics import AgentLocal
from sapopt.formulations.highs import maximise
from sapopt.formulations.limited import building
from sapopt.formulations.limited.building import path_graph
from sapopt.formulations.limited.descent import minimised
from sapopt.formulations.limited.programme import limited_programme
from sapopt.formulations.limited.useful import tidied


@pytest.mark.parametrize("seed", range(4))
def test_the_dual_reaches_the_linear_programme(seed: int) -> None:
    """The bound is never below the relaxation, and close to it: the ascent does not stop where it begins."""
    rng = np.random.default_rng(seed)
    limits = [
        Limit.handovers(2, each=True), Limit.cover([0], 1, penalty=0.5), Limit.work(at_least=2, penalty=0.3),
        Team(2, 2, 0.8),
    ]  # fmt: skip
    problem = SAP(
        rng.random((8, 4, 5)),
        SwitchingCost(0.2),
        capacity=[1, 1, 2, 2, 1],
        idle=bool(seed % 2),
        limits=limits,
    )
    relaxed = maximise(limited_programme(path_graph(problem.core, tight=False)).programme, relaxed=True).value
    proven = bound(problem).value
    assert relaxed - 1e-7 <= proven <= relaxed + 0.01 * abs(relaxed)


class Levels(AgentLocal):
    """Work takes a level of three, idling gives one back; at level 0 work costs, more on the first task."""

    def start(self, problem: Any) -> Any:
        return np.full(problem.n, 1)

    def rule(self, k: int, agent: Any, local: Any, task: Any, benefit: Any) -> Any:
        works = benefit != 0
        cost = np.where(works & (local == 0), 0.3 + 0.2 * (task == 0), 0.0)
        return -cost, np.clip(local + np.where(works, -1, 1), 0, 2)


def _sparse_problem(seed: int) -> SAP:
    """Agents that may idle and see few of the tasks; limits, teams, initial assignments, capacities now and then."""
    rng = np.random.default_rng(seed)
    T, n, m = int(rng.integers(1, 6)), int(rng.integers(1, 4)), int(rng.integers(3, 7))
    benefits = np.round(rng.random((T, n, m)), 2) * (rng.random((T, n, m)) < 0.3)
    capacity = int(rng.integers(1, 3))
    limits: list[Limit | Team] = [
        Limit.once(), Limit.handovers(int(rng.integers(0, 3)), each=True), Limit.cover([0], 1, penalty=0.4),
        Limit.visits(at_most=1), Limit(rng.normal(size=(1, 1, m)), at_most=2.0),
    ]  # fmt: skip
    if capacity > 1 and n > 1:
        limits.append(Team(m - 1, 2, reward=1.0))
    kept = [limit for limit in limits if rng.random() < 0.4]
    held = rng.permutation(m)[:n] if rng.random() < 0.4 else None
    rule = SwitchingCost(0.2, idle_is_free=bool(rng.random() < 0.3))
    return SAP(benefits, rule, held, idle=True, capacity=capacity, limits=kept)


@pytest.mark.parametrize("seed", range(60))
def test_tasks_that_earn_nothing_are_not_missed(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The programme over the tasks that an agent can gain from has the optimum of that over all tasks."""
    problem = _sparse_problem(seed)
    short = path_graph(problem.core)
    best = maximise(limited_programme(short).programme).value
    monkeypatch.setattr(
        building, "useful_pairs", lambda problem, benefits, *_: np.ones(benefits.shape, dtype=bool)
    )
    whole = path_graph(problem.core)
    assert short.arcs <= whole.arcs
    assert best == pytest.approx(maximise(limited_programme(whole).programme).value, abs=1e-6)


def test_most_of_a_sparse_problem_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where an agent sees a tenth of the tasks, its graph has a fraction of the arcs."""
    rng = np.random.default_rng(0)
    benefits = rng.random((6, 3, 60)) * (rng.random((6, 3, 60)) < 0.02)
    problem = SAP(benefits, SwitchingCost(0.2), idle=True, limits=[Limit.once()])
    arcs = path_graph(problem.core).arcs
    monkeypatch.setattr(
        building, "useful_pairs", lambda problem, benefits, *_: np.ones(benefits.shape, dtype=bool)
    )
    assert 4 * arcs < path_graph(problem.core).arcs


def test_a_restricted_graph_keeps_the_paths_of_its_arcs() -> None:
    """Without some arcs, the longest paths are those of the graph in which these arcs are worth -inf."""
    rng = np.random.default_rng(1)
    problem = SAP(rng.random((5, 3, 4)), SwitchingCost(0.3), idle=True, limits=[Limit.once()])
    whole = path_graph(problem.core)
    keep = rng.random(whole.arcs) < 0.9
    values, arcs = whole.restricted(keep).longest(whole.gain[keep])
    expected, chosen = whole.longest(np.where(keep, whole.gain, -np.inf))
    np.testing.assert_allclose(values, expected)
    np.testing.assert_array_equal(np.flatnonzero(keep)[arcs], chosen)


@pytest.mark.parametrize("seed", range(30))
def test_idling_by_a_rule_is_not_missed(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same where a rule says what moves cost, whose states are found without asking for them one by one."""
    rng = np.random.default_rng(seed)
    T, n, m = int(rng.integers(1, 6)), int(rng.integers(1, 4)), int(rng.integers(3, 6))
    benefits = np.round(rng.normal(0.7, 0.6, (T, n, m)), 2) * (rng.random((T, n, m)) < 0.4)
    limits: list[Limit | Team] = [
        Limit.once(), Limit.handovers(1, each=True), Limit.cover([0], 1, penalty=0.4), Limit.visits(at_most=1),
    ]  # fmt: skip
    kept = [limit for limit in limits if rng.random() < 0.5]
    held = rng.permutation(m)[:n] if rng.random() < 0.4 else None
    problem = SAP(benefits, Levels(), held, idle=True, limits=kept)
    short = path_graph(problem.core)
    best = maximise(limited_programme(short).programme).value
    monkeypatch.setattr(Levels, "by_rule", lambda self: None)
    whole = path_graph(problem.core)
    assert short.arcs <= whole.arcs
    assert best == pytest.approx(maximise(limited_programme(whole).programme).value, abs=1e-6)


@pytest.mark.parametrize("seed", range(30))
def test_a_tidied_plan_is_worth_no_less(seed: int) -> None:
    """Holding nothing in place of what earns nothing costs nothing, breaks no limit, and is in the graph."""
    problem = _sparse_problem(seed).core
    rng = np.random.default_rng(seed)
    for _ in range(20):
        plan = rng.integers(0, problem.m, (problem.T, problem.n))
        plan[1:][rng.random((problem.T - 1, problem.n)) < 0.5] = plan[0, 0]
        tidy = tidied(problem, plan)
        try:
            value = problem.evaluate(plan).value
        except ValueError:
            continue
        assert problem.evaluate(tidy).value >= value - 1e-12
        assert path_graph(problem).follow(tidy) is not None


@pytest.mark.parametrize("seed", range(8))
def test_descent_within_bounds(seed: int) -> None:
    """The minimum of a smooth convex function within bounds is that of scipy's method, and no bound is crossed."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 40))
    matrix, shift = rng.normal(size=(2 * size, size)), rng.normal(size=2 * size)
    high = np.where(rng.random(size) < 0.3, np.inf, rng.random(size))

    def function(x: Any) -> Any:
        rest = matrix @ x - shift
        return float(np.logaddexp(rest, -rest).sum()), matrix.T @ np.tanh(rest)

    x = minimised(function, rng.random(size) * 2.0, high, 400, 1e-13)
    assert (x >= 0).all()
    assert (x <= high).all()
    bounds = np.stack([np.zeros(size), high], axis=1)
    found = minimize(
        function, np.zeros(size), jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-14}
    )
    assert function(x)[0] <= found.fun + 1e-6 * abs(found.fun)


@pytest.mark.parametrize("scale", [1e-150, 1e-160, 1e-170, 1e-300, 1e-308])
def test_descent_where_squares_vanish(scale: float) -> None:
    """Slopes whose squares are no numbers any more end in a point no worse than the start, without an error."""
    rng = np.random.default_rng(0)
    matrix, shift = rng.normal(size=(12, 6)), rng.normal(size=12)

    def function(x: Any) -> Any:
        rest = matrix @ x - shift
        return scale * float(rest @ rest), 2.0 * scale * (matrix.T @ rest)

    start = rng.random(6)
    x = minimised(function, start, np.ones(6), 50)
    assert np.isfinite(x).all()
    assert function(x)[0] <= function(start)[0]


@pytest.mark.parametrize("seed", range(40))
def test_arcs_that_break_a_limit_alone_are_not_missed(seed: int) -> None:
    """Without them the relaxation is no higher, and the optimum is the same."""
    rng = np.random.default_rng(seed)
    T, n, m = int(rng.integers(2, 6)), int(rng.integers(1, 4)), int(rng.integers(3, 5))
    benefits = np.round(rng.random((T, n, m)), 2) * (rng.random((T, n, m)) < 0.6)
    limits = [
        Limit.once(times=int(rng.integers(0, 3))),
        Limit(rng.random((T, n, m)), 1.0),
        Limit.work(at_most=3),
    ]
    limits = [limit for limit in limits if rng.random() < 0.7]
    rule = Levels() if seed % 2 else SwitchingCost(0.3)
    core = SAP(benefits, rule, idle=True, limits=limits).core
    whole, tight = path_graph(core, tight=False), path_graph(core)
    assert tight.arcs <= whole.arcs
    best, relaxed = (
        [maximise(limited_programme(g).programme, relaxed=r).value for g in (whole, tight)] for r in (0, 1)
    )
    assert best[1] == pytest.approx(best[0], abs=1e-6)
    assert best[1] - 1e-6 <= relaxed[1] <= relaxed[0] + 1e-6
