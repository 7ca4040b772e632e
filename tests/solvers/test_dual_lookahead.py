"""DualLookahead: what it sees, that it is valid, and that it pays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from sapopt import SAP, Status, SwitchingCost, bound, solve
from sapopt.solvers import HAA, HAAL, DualLookahead


def moving_field(seed: int, *, idle_is_free: bool = False, cost: Any = 0.4, initial: bool = False) -> SAP:
    """Agents on a ring that pass over tasks; each sees the tasks near it."""
    rng = np.random.default_rng(seed)
    T, n, m = 24, 10, 14
    agents = rng.random(n)[None, :, None] + 0.02 * np.arange(T)[:, None, None]
    distance = np.abs((agents - rng.random(m)[None, None, :] + 0.5) % 1.0 - 0.5)
    benefits = np.where(distance < 0.12, np.exp(-((distance / 0.07) ** 2)), 0.0) * rng.uniform(1, 2, m)
    return SAP(benefits, SwitchingCost(cost, idle_is_free), np.arange(n) if initial else None)


def equal_costs() -> np.ndarray:
    """The cost of 0.4 as a matrix."""
    return np.full((14, 14), 0.4) - 0.4 * np.eye(14)


@pytest.mark.parametrize("cost", [0.4, equal_costs()], ids=["number", "matrix"])
def test_a_window_of_one_step_is_haa(cost: Any) -> None:
    """Nothing to price: every step is an alpha of beta_hat, in the state that the steps before it led to."""
    for seed in range(3):
        problem = moving_field(seed, cost=cost)
        state = problem.initial_state()
        for k, tasks in enumerate(solve(problem, DualLookahead(1)).plan):
            matrix = problem.beta_hat(k, state)
            best = matrix[linear_sum_assignment(matrix, maximize=True)].sum()
            assert matrix[np.arange(problem.n), tasks].sum() == pytest.approx(best, abs=1e-9)
            state = problem.transition(k, state, tasks)


@pytest.mark.parametrize("idle_is_free", [False, True])
@pytest.mark.parametrize("initial", [False, True])
def test_looking_further_pays(idle_is_free: bool, initial: bool) -> None:
    """On average over seeds: window 6 beats window 2, and HAAL of the same lookahead."""
    far = near = haal = 0.0
    for seed in range(4):
        problem = moving_field(seed, idle_is_free=idle_is_free, initial=initial)
        far += solve(problem, DualLookahead(6)).value
        near += solve(problem, DualLookahead(2)).value
        haal += solve(problem, HAAL(6)).value
    assert far > near
    assert far > haal


def test_runs_repeat() -> None:
    """Nothing is random."""
    problem = moving_field(1)
    first, second = (solve(problem, DualLookahead(4), seed=s).plan for s in (0, 1))
    np.testing.assert_array_equal(first, second)


def test_a_matrix_of_costs_and_sparse_benefits_work() -> None:
    """Equal costs as a matrix are the number: plans are worth the same in both forms, and one bound holds for both."""
    number, matrix = moving_field(2), moving_field(2, cost=equal_costs())
    plans = [solve(problem, DualLookahead(4)).plan for problem in (number, matrix)]
    top = bound(number).value
    for plan in plans:
        assert number.evaluate(plan).value == matrix.evaluate(plan).value
        assert solve(number, HAA()).value < number.evaluate(plan).value <= top
    assert bound(matrix).value == pytest.approx(top, rel=1e-3)


def test_it_knows_no_more_than_its_window() -> None:
    """Changing what lies beyond the window changes no decision before."""
    problem = moving_field(3)
    changed = problem.benefits.dense().copy()
    changed[12:] = changed[12:][:, ::-1]
    other = SAP(changed, SwitchingCost(0.4))
    a, b = (solve(p, DualLookahead(4)).plan for p in (problem, other))
    np.testing.assert_array_equal(a[:9], b[:9])


def test_it_works_on_forecasts() -> None:
    """A perfect forecast changes nothing; one that sees nothing ahead still gives a valid plan."""
    problem = moving_field(4)
    dense = problem.benefits.dense()
    plain = solve(problem, DualLookahead(4))
    told = solve(problem, DualLookahead(4), forecast=lambda k, steps: dense[k : k + steps])
    np.testing.assert_array_equal(plain.plan, told.plan)
    blind = solve(problem, DualLookahead(4), forecast=lambda k, steps: dense[k : k + 1])
    assert blind.value <= plain.value


def test_what_it_needs_is_said() -> None:
    """A window of less than one step; a dynamics that is not agent-local."""
    with pytest.raises(ValueError, match="window"):
        DualLookahead(0)

    class Opaque:
        def initial_state(self, problem: SAP) -> int:
            return 0

        def handover(self, k: int, state: int) -> np.ndarray:
            return np.zeros((2, 2))

        def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
            return 0

    with pytest.raises(ValueError, match="agent-local"):
        solve(SAP(np.ones((2, 2, 2)), Opaque()), DualLookahead(2))


def test_a_short_limit_is_shared_by_all_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a clock that ticks at every look, a limit too short for all iterations ends none of the steps."""
    problem = moving_field(2)
    full = solve(problem, DualLookahead(6))
    time = [0.0]

    def tick() -> float:
        time[0] += 1e-3
        return time[0]

    monkeypatch.setattr("sapopt.kernels.clock.time.perf_counter", tick)
    solve(problem, DualLookahead(6), time_limit=1e6)
    limit = time[0] / 4
    result = solve(problem, DualLookahead(6), time_limit=limit)
    assert result.status is Status.FEASIBLE
    assert result.value >= solve(problem, HAA()).value
    assert result.value <= full.value * 1.05
