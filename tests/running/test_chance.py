"""Transitions by chance: equal luck for equal seeds, the law of the draws, and what is known in hindsight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from batteries import random_case
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, SwitchingCost, bound
from sapopt.domains.chance import Failures, RandomIncome, stochastic_instance
from sapopt.dynamics import Battery
from sapopt.running.chance import Chance, Runs, over_runs, play
from sapopt.solvers import HAA, HAAL, AssignmentPolicy, energy_price, power_constrained


@dataclass(frozen=True)
class Nothing:
    """Chance that leaves everything as it is reckoned with."""

    def transition(self, problem: SAP, k: int, state: Any, assignment: Any, rng: Any) -> Any:
        return problem.transition(k, state, assignment)


@dataclass(frozen=True)
class Swaps:
    """Two agents lose hold of what they had and find each other's task, one time in three."""

    def transition(self, problem: SAP, k: int, state: Any, assignment: Any, rng: Any) -> Any:
        return assignment[::-1].copy() if rng.random() < 1 / 3 else assignment


def small(seed: int, form: str = "dense") -> SAP:
    return random_case(seed).problem(form)


@pytest.mark.parametrize("form", ["dense", "sparse"])
@pytest.mark.parametrize("seed", range(6))
def test_without_chance_a_run_is_the_plan(seed: int, form: str) -> None:
    """What is earned without luck is what the problem itself says of the plan, and chance of nothing is none."""
    problem = small(seed, form)
    for chance in (None, Nothing(), Failures(0.0)):
        played = play(problem, HAA(), chance, seed)
        assert played.value == pytest.approx(problem.evaluate(played.plan).value)
        assert play(problem, played.plan, chance).value == pytest.approx(played.value)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["dense", "sparse"]), st.sampled_from([0.05, 0.3, 1.0]))
def test_failures_in_hindsight(seed: int, form: str, probability: float) -> None:
    """The value of a run is that of its plan in the problem of one who knew all failures, whatever was decided."""
    problem, chance = small(seed, form), Failures(probability)
    known = chance.in_hindsight(problem, (seed, 1))
    plan = np.array(
        [np.random.default_rng(seed + k).permutation(problem.m)[: problem.n] for k in range(problem.T)]
    )
    for decide in (plan, HAA()):
        played = play(problem, decide, chance, (seed, 1))
        assert played.value == pytest.approx(known.evaluate(played.plan).value, abs=1e-9)
        assert played.value <= bound(known).value + 1e-6


def test_luck_is_of_the_seed_and_the_step_alone() -> None:
    """Two policies meet the same failures in a run; another seed brings others."""
    problem, chance = SAP(np.ones((40, 20, 20)), Battery(0.0, 0.0, 0.0)), Failures(0.05)

    def dead(plan: np.ndarray, seed: int) -> np.ndarray:
        return play(problem, plan, chance, seed).rewards == 0

    still = np.tile(np.arange(20), (40, 1))
    turning = np.array([np.roll(np.arange(20), k) for k in range(40)])
    np.testing.assert_array_equal(dead(still, 3), dead(turning, 3))
    assert (dead(still, 3) != dead(still, 4)).any()


def test_failures_strike_with_their_probability() -> None:
    """After k steps a share (1 - p)^k is left, within four standard errors."""
    n, T, p = 400, 30, 0.05
    problem = SAP(np.ones((T, n, n)), Battery(0.0, 0.0, 0.0))
    alive = play(problem, np.tile(np.arange(n), (T, 1)), Failures(p)).rewards.mean(axis=1)
    wanted = (1 - p) ** np.arange(T)
    assert (np.abs(alive - wanted) <= 4 * np.sqrt(wanted * (1 - wanted) / n) + 1e-12).all()


def test_income_is_reckoned_with_on_the_mean() -> None:
    """An idle battery gains 0, 1 or 2 levels with equal chances where 1 is reckoned with; a working one does not."""
    n = 3000
    problem = SAP(np.zeros((1, n, n)), Battery(0.0, 0.2, 0.1, initial_charge=0.5))
    state = problem.initial_state()
    after = RandomIncome().transition(problem, 0, state, np.arange(n), np.random.default_rng(0))
    counts = np.bincount(after.levels - state.levels, minlength=3)
    assert counts.sum() == n
    assert len(counts) == 3
    assert (np.abs(counts / n - 1 / 3) < 4 * np.sqrt(2 / 9 / n)).all()
    busy = SAP(np.ones((1, 4, 4)), Battery(0.0, 0.2, 0.1))
    after = RandomIncome().transition(busy, 0, busy.initial_state(), np.arange(4), np.random.default_rng(0))
    np.testing.assert_array_equal(after.levels, [8, 8, 8, 8])


def test_dead_satellites_stay_dead() -> None:
    """Neither chance brings an empty satellite back."""
    problem = SAP(np.zeros((50, 3, 3)), Battery(0.0, 0.2, 0.1, initial_charge=[0.0, 0.1, 1.0]))
    for chance in (RandomIncome(), Failures(0.0)):
        state = problem.initial_state()
        for k in range(50):
            state = chance.transition(problem, k, state, np.arange(3), np.random.default_rng(k))
        assert state.levels[0] == 0
        assert state.levels[1] > 0


def test_chance_of_any_dynamics() -> None:
    """Any class with a transition by chance will do; the policy sees what was drawn and pays for it."""
    benefits = np.tile(np.eye(2), (60, 1, 1))
    problem = SAP(benefits, SwitchingCost(0.25), [0, 1])
    assert isinstance(Swaps(), Chance)
    played = play(problem, HAA(), Swaps(), 5)
    lucky = played.rewards.sum(axis=1)
    assert set(np.round(lucky, 9)) == {2.0, 1.5}  # held what it wanted, or had to take it up again
    assert 5 <= (lucky < 2).sum() <= 35


def test_policies_compared_over_runs() -> None:
    """Means and standard errors are those of the values; the paired difference has the error of the differences."""
    problem = small(4)
    greedy, ahead = over_runs(problem, [HAA(), HAAL(3)], RandomIncome(), runs=12, seed=1)
    assert greedy.name == HAA().name
    assert greedy.values.shape == (12,)
    assert greedy.mean == pytest.approx(np.mean(greedy.values))
    assert greedy.error == pytest.approx(np.std(greedy.values, ddof=1) / np.sqrt(12))
    mean, error = ahead.less(greedy)
    assert mean == pytest.approx(ahead.mean - greedy.mean)
    assert error == pytest.approx(np.std(ahead.values - greedy.values, ddof=1) / np.sqrt(12))
    assert greedy.less(greedy) == (0.0, 0.0)
    again, _ = over_runs(lambda run: problem, [HAA(), HAAL(3)], RandomIncome(), runs=12, seed=1)
    np.testing.assert_array_equal(again.values, greedy.values)


def test_the_built_in_stochastic_instances() -> None:
    """Failures and clouds cost something, and the rule that prices energy still earns more than the greedy one."""
    policies = [AssignmentPolicy(power_constrained), AssignmentPolicy(energy_price)]
    for name in ("power-failing", "power-cloudy"):
        problem, chance = stochastic_instance(name, steps=30)
        greedy, price = over_runs(problem, policies, chance, runs=3)
        mean, error = price.less(greedy)
        assert mean > 2 * error
        assert greedy.error > 0


def test_bad_input() -> None:
    with pytest.raises(ValueError, match="probability must lie"):
        Failures(1.5)
    with pytest.raises(ValueError, match="unknown stochastic instance 'sunny'"):
        stochastic_instance("sunny")
    problem = SAP(np.ones((2, 2, 2)), SwitchingCost(0.5))
    for chance in (Failures(), RandomIncome()):
        with pytest.raises(ValueError, match="batteries"):
            play(problem, HAA(), chance)
    with pytest.raises(ValueError, match="no capacities, idleness or limits"):
        play(SAP(np.ones((2, 2, 2)), SwitchingCost(0.5), idle=True), HAA())
    with pytest.raises(ValueError, match="runs must be at least 2"):
        over_runs(problem, [HAA()], None, runs=1)
    with pytest.raises(ValueError, match="none to compare"):
        over_runs(problem, [], None)
    with pytest.raises(ValueError, match="other has 2 runs"):
        Runs("a", np.ones(3)).less(Runs("b", np.ones(2)))
    with pytest.raises(ValueError, match="plan must have shape"):
        play(problem, np.zeros((3, 2), dtype=int))
