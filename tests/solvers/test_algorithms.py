"""Algorithms 1 to 3 of the thesis, transcribed line by line, against HAA, HAAL and the twin of HAAL-D."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from local_dynamics import Dictator as Leader
from local_dynamics import Tiring
from rule_problems import Learning
from scipy.optimize import linear_sum_assignment

from sapopt import SAP, SwitchingCost, solve
from sapopt.data.benefits import dense_step
from sapopt.data.matrices import GainMatrix
from sapopt.data.windows import WindowSums
from sapopt.dynamics import Battery, Dictator, RideHailing, SlewCost, SyntheticSwitching, UnitCommitment
from sapopt.running.outlook import Outlook
from sapopt.solvers import HAA, HAAL, CentralHAALD

RULES: dict[str, Callable[[np.random.Generator, int, int, int], Any]] = {
    "switching": lambda rng, T, n, m: SwitchingCost(rng.random()),
    "idle is free": lambda rng, T, n, m: SwitchingCost(rng.random(), idle_is_free=True),
    "matrix": lambda rng, T, n, m: SwitchingCost(rng.random((m, m)) * (1 - np.eye(m))),
    "battery": lambda rng, T, n, m: Battery(rng.random(), 0.4, 0.2),
    "battery entries": lambda rng, T, n, m: Battery(rng.random(), 0.4, 0.2, pay_for="entries"),
    "copies": lambda rng, T, n, m: SyntheticSwitching(rng.random(), 0.5, task_of=np.arange(m) // 2),
    "sight": lambda rng, T, n, m: SyntheticSwitching(rng.random(), 1.0, needs_sight=True),
    "slewing": lambda rng, T, n, m: SlewCost(
        rng.random(), 7000 + 1000 * rng.normal(size=(T, n, 3)), 3000 * rng.normal(size=(m, 3))
    ),
    "rides": lambda rng, T, n, m: RideHailing(
        rng.integers(1, 3, (4, 4)) * (1 - np.eye(4, dtype=int)), *rng.integers(0, 4, (2, m)),
        rng.integers(0, 4, n), 2, 0.3,
    ),
    "units": lambda rng, T, n, m: UnitCommitment(
        3 * rng.random(n), *rng.integers(1, 3, (2, n)), rng.random(n), rng.choice([-3, -1, 1, 3], n)
    ),
    "own rule": lambda rng, T, n, m: Learning(0.3),
    "own local": lambda rng, T, n, m: Tiring(0.4),
    "own global": lambda rng, T, n, m: Leader(0.5),
    "dictator": lambda rng, T, n, m: Dictator(rng.random((3, n, m)), rng.integers(0, 3, (3, m))),
}  # fmt: skip
"""Every kind of dynamics, drawn at random for T steps, n agents and m tasks."""


def random_problem(rule: str, seed: int) -> SAP:
    """A small dense problem without ties: benefits may be negative, none is zero."""
    rng = np.random.default_rng(seed)
    T, n = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    m = n + int(rng.integers(0, 3))
    benefits = rng.normal(0.6, 1.0, (T, n, m))
    if rule in ("slewing", "rides"):  # where a benefit means that a task is there
        benefits = np.abs(benefits)
    if rule == "rides":  # a request is on offer at one step
        benefits *= (np.arange(T)[:, None] == rng.integers(0, T, m))[:, None]
    return SAP(benefits, RULES[rule](rng, T, n, m), rng.permutation(m)[:n] if seed % 2 else None)


def partitions(length: int) -> Iterator[list[tuple[int, int]]]:
    """Q_L: all ways to cut ``0 .. length - 1`` into intervals (first, one past the last)."""
    for mask in range(2 ** (length - 1)):
        ends = [t + 1 for t in range(length - 1) if mask >> t & 1] + [length]
        yield list(zip([0, *ends[:-1]], ends, strict=True))


def alpha(matrix: np.ndarray) -> np.ndarray | None:
    """The optimal assignment of a matrix, None if there is none."""
    try:
        return linear_sum_assignment(matrix, maximize=True)[1]
    except ValueError:
        return None


def haal_by_the_letter(problem: SAP, lookahead: int, *, from_the_start: bool) -> np.ndarray:
    """Algorithm 2, or with `from_the_start` Algorithm 3, with L' = min(L, T - k + 1) for k = 1 .. T."""
    agents = np.arange(problem.n)
    beta = [dense_step(problem.benefits.step(k)) for k in range(problem.T)]
    state = problem.initial_state()
    plan = []
    for k in range(problem.T):
        best, chosen = -np.inf, None
        for q in partitions(min(lookahead, problem.T - k)):
            s, v, first = state, 0.0, None
            for a, b in q:
                eta = problem.handover(k + a, state if from_the_start else s)
                x = alpha(sum(beta[k + a : k + b]) + eta)
                if x is None:
                    v = -np.inf
                    break
                first = x if first is None else first
                for t in range(k + a, k + b):
                    v += (beta[t] + problem.handover(t, s))[agents, x].sum()
                    s = problem.transition(t, s, x)
            if first is not None and v > best + 1e-9:
                best, chosen = v, first
        assert chosen is not None
        plan.append(chosen)
        state = problem.transition(k, state, chosen)
    return np.array(plan)


@pytest.mark.parametrize("rule", RULES)
def test_haal_is_algorithm_2(rule: str) -> None:
    """Two hundred random problems: the value of HAAL (and of HAA, for L = 1) is that of the transcription."""
    for seed in range(200):
        problem, lookahead = random_problem(rule, seed), 1 + seed % 3
        expected = problem.evaluate(haal_by_the_letter(problem, lookahead, from_the_start=False)).value
        solver = HAA() if lookahead == 1 else HAAL(lookahead)
        assert solve(problem, solver).value == pytest.approx(expected, abs=1e-9), (seed, lookahead)


@pytest.mark.parametrize("rule", RULES)
def test_the_twin_of_haal_d_is_algorithm_3(rule: str) -> None:
    """Two hundred random problems: all intervals are entered from the first state, sequences are played truly."""
    for seed in range(200):
        problem, lookahead = random_problem(rule, seed), 1 + seed % 3
        expected = problem.evaluate(haal_by_the_letter(problem, lookahead, from_the_start=True)).value
        assert solve(problem, CentralHAALD(lookahead)).value == pytest.approx(expected, abs=1e-9), seed


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("form", ["dense", "sparse"])
def test_what_intervals_are_chosen_by(rule: str, form: str) -> None:
    """Line 9 in every form of the benefits: the sum over the interval plus eta of its first state."""
    for seed in range(12):
        dense = random_problem(rule, seed)
        values = dense.benefits.dense() * (np.random.default_rng(seed).random(dense.benefits.shape) < 0.6)
        benefits = values if form == "dense" else list(map(sp.csr_array, values))
        problem = SAP(benefits, dense.dynamics, dense.initial_assignment)
        state = problem.initial_state()
        windows = WindowSums(problem.benefits)
        outlook = Outlook(0, problem.T, state, problem, windows, np.arange(problem.m))
        for start in range(problem.T):
            for stop in range(start + 1, problem.T + 1):
                matrix = outlook.entered(start, stop, state)
                found = matrix.toarray() if isinstance(matrix, GainMatrix) else matrix
                expected = values[start:stop].sum(axis=0) + problem.handover(start, state)
                # A matrix may differ by what an agent gets for any task: that changes no assignment.
                shift = (found - expected)[:, :1]
                np.testing.assert_allclose(found - shift, expected, atol=1e-12)
            state = problem.transition(start, state, np.arange(problem.n))


def test_exact_intervals_are_another_rule() -> None:
    """Where the dynamics tells what an interval really yields, it may choose otherwise, and better on average."""
    gained = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        benefits = rng.random((8, 3, 6)) * (rng.random((8, 3, 6)) < 0.6)
        problem = SAP(benefits, Battery(0.3, 0.5, 0.25))
        gained.append(solve(problem, HAAL(3, exact_intervals=True)).value - solve(problem, HAAL(3)).value)
    assert sum(1 for gain in gained if abs(gain) > 1e-9) >= 10
    assert np.mean(gained) > 0
    assert HAAL(3, exact_intervals=True).name == "HAAL(L=3, exact intervals)"
    with pytest.raises(ValueError, match="exact_intervals must be True or False"):
        HAAL(3, exact_intervals=1)  # type: ignore[arg-type]
