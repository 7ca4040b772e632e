"""The general form of section 7.2: benefits beta_hat(s, x) of the state and of all assignments of the step."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from sapopt import SAP, bound, certify, solve
from sapopt.solvers import HAA, HAAL, DualLookahead, Exact, IteratedAssignment, MyopicGreedy


@dataclass(frozen=True, eq=False)
class Practice:
    """Agents 0 and 1 earn `gain` each if they hold neighbouring tasks, and twice that if they did so a step before.

    The state is how often in succession they did, up to 2. No matrix of agents and tasks says that.
    """

    gain: float = 0.6
    handover_limit = 1.2

    def initial_state(self, problem: Any) -> int:
        return 0

    def handover(self, k: int, state: int) -> np.ndarray:
        return np.zeros((2, 4))

    def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
        return min(state + 1, 2) if abs(int(assignment[0]) - int(assignment[1])) == 1 else 0

    def interaction(self, k: int, state: int, assignments: np.ndarray) -> np.ndarray:
        near = np.abs(assignments[..., :1] - assignments[..., 1:]) == 1
        return np.broadcast_to(
            np.where(near, self.gain * (2 if state else 1), 0.0), np.shape(assignments)
        ).copy()


def problem_of(seed: int, steps: int = 3) -> SAP:
    return SAP(np.random.default_rng(seed).random((steps, 2, 4)).round(2), Practice())


def beta_hat(problem: SAP, k: int, state: int, x: tuple[int, ...]) -> np.ndarray:
    """The matrix beta_hat(s_k, x_k) itself, by the definition."""
    near = abs(x[0] - x[1]) == 1
    return problem.benefits.dense()[k] + (0.6 * (2 if state else 1) if near else 0.0)


def value(problem: SAP, plan: Any) -> float:
    """The objective of section 7.2, term by term."""
    total, state = 0.0, 0
    for k, x in enumerate(plan):
        total += sum(beta_hat(problem, k, state, x)[i, j] for i, j in enumerate(x))
        state = min(state + 1, 2) if abs(x[0] - x[1]) == 1 else 0
    return total


@pytest.mark.parametrize("seed", range(4))
def test_scored_bounded_and_solved(seed: int) -> None:
    """Every plan is worth what the definition says, the best of all is found, and nothing is above the bound."""
    problem = problem_of(seed)
    plans = list(itertools.product(itertools.permutations(range(4), 2), repeat=3))
    values = [value(problem, plan) for plan in plans]
    for plan, worth in list(zip(plans, values, strict=True))[::53]:
        assert problem.evaluate(plan).value == pytest.approx(worth)
    best = max(values)
    assert solve(problem, Exact(method="dp")).value == pytest.approx(best)
    assert bound(problem).value >= best
    for policy in (HAA(), HAAL(2), MyopicGreedy()):
        result = solve(problem, policy)
        assert result.value == pytest.approx(value(problem, result.plan.tolist()))
        assert result.value <= best + 1e-9


def test_what_cannot_know_of_it_refuses() -> None:
    """Prices need independent agents; the iterated assignment needs to be told what a pair meets with."""
    problem = problem_of(1)
    with pytest.raises(ValueError, match=r"agent-local|path_oracle"):
        solve(problem, DualLookahead(2))
    with pytest.raises(ValueError, match="not agent-local"):
        certify(problem, solve(problem, HAA()))
    with pytest.raises(ValueError, match=r"no method marginal\(k, state, activity\)"):
        solve(problem, IteratedAssignment())


def test_learners_are_paid_for_it() -> None:
    """An environment's rewards hold the interaction, so that a learned policy can find out about it."""
    pytest.importorskip("torch")
    from sapopt.learning import Environment

    problem = problem_of(2)
    env = Environment(problem)
    rewards = [env.step(np.array(x)) for x in ((0, 1), (1, 2), (0, 3))]
    assert float(np.sum(rewards)) == pytest.approx(value(problem, ((0, 1), (1, 2), (0, 3))))
    assert rewards[1][0] == pytest.approx(problem.benefits.dense()[1][0, 1] + 1.2)
