"""First tasks in sparse form: the values of the dense recursion, and the assignment of scipy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from sapopt import SAP, SwitchingCost
from sapopt.data.feasibility import InfeasibleError
from sapopt.dynamics.paths.first_rows import FirstRowsOracle


def window(seed: int) -> tuple[Any, np.ndarray]:
    """A path oracle and prices: spare tasks or none, held tasks or none, negative and forbidden pairs."""
    rng = np.random.default_rng(seed)
    T, n = int(rng.integers(1, 6)), int(rng.integers(1, 9))
    m = n + int(rng.integers(1, 12)) if seed % 2 else n
    benefits = rng.random((T, n, m)) * (rng.random((T, n, m)) < rng.choice([0.15, 0.4]))
    if seed % 5 == 0:
        benefits -= 0.3 * (rng.random(benefits.shape) < 0.1)
    if seed % 7 == 0 and n < m:
        benefits[rng.random(benefits.shape) < 0.03] = -np.inf
    held = rng.permutation(m)[:n] if seed % 3 else None
    problem = SAP(benefits, SwitchingCost(float(rng.choice([0.1, 0.5, 2.0]))), held)
    prices = rng.random((T, m)) * (rng.random((T, m)) < 0.6)
    return problem.model.path_oracle(problem.benefits, held), prices


def best_value(values: np.ndarray) -> float | None:
    """Value of the best assignment by scipy; None if there is none."""
    try:
        rows, columns = linear_sum_assignment(values, maximize=True)
    except ValueError:
        return None
    return float(values[rows, columns].sum())


def test_rows_say_what_the_dense_recursion_says() -> None:
    """Listed, waiting and forbidden pairs, with and without a table of waiting prices."""
    waiting = set()
    for seed in range(300):
        oracle, prices = window(seed)
        assert isinstance(oracle, FirstRowsOracle)
        np.testing.assert_allclose(
            oracle.first_rows(prices).toarray(), oracle.first_values(prices), atol=1e-12
        )
        waiting.add(oracle.park)
    assert waiting == {True, False}


def test_the_assignment_is_the_best_one() -> None:
    """Against scipy on the dense values; where no task is spare, from any prices."""
    for seed in range(300):
        oracle, prices = window(seed)
        values, rows = oracle.first_values(prices), oracle.first_rows(prices)
        best = best_value(values)
        n, m = values.shape
        starts = [None, prices[0]] if n == m else [None]
        for start in starts:
            if best is None:
                with pytest.raises(InfeasibleError):
                    rows.assign(start)
                continue
            tasks = rows.assign(start)
            assert len(set(tasks)) == n
            assert values[np.arange(n), tasks].sum() == pytest.approx(best, abs=1e-9)


def test_a_crowded_assignment_is_the_best_one() -> None:
    """Many agents, no spare task, long augmenting paths through the waiting places."""
    rng = np.random.default_rng(3)
    T, n = 6, 120
    benefits = rng.random((T, n, n)) * (rng.random((T, n, n)) < 0.06)
    held = rng.permutation(n)
    problem = SAP(benefits, SwitchingCost(0.3), held)
    oracle = problem.model.path_oracle(problem.benefits, held)
    for scale in (0.0, 0.2, 1.0):
        prices = scale * rng.random((T, n)) * (rng.random((T, n)) < 0.8)
        values = oracle.first_values(prices)
        for start in (None, prices[0]):
            tasks = oracle.first_rows(prices).assign(start)
            assert sorted(tasks) == list(range(n))
            assert values[np.arange(n), tasks].sum() == pytest.approx(best_value(values), abs=1e-9)


def test_narrowing_leaves_good_paths() -> None:
    """Paths within the regret keep their value, the best ones among them; the rest can only lose."""
    for seed in range(60):
        oracle, prices = window(seed)
        full = oracle.best_paths(prices)[0]
        counts = []
        for regret in (1e-9, 0.2, np.inf):
            narrow = oracle.narrowed(prices, regret)
            values, plan = narrow.best_paths(prices)
            np.testing.assert_allclose(values, full, atol=1e-12)
            assert plan.shape == (len(prices), len(full))
            counts.append(narrow.window.data.size)
        assert counts == sorted(counts)
        assert counts[-1] == oracle.window.data.size
        # prices that changed since: a bound of the narrowed problem is never above that of the whole one
        other = prices[::-1].copy()
        assert (
            oracle.narrowed(prices, 0.1).best_paths(other)[0] <= oracle.best_paths(other)[0] + 1e-12
        ).all()


def test_blocks_know_nothing_of_each_other() -> None:
    """Without handover costs nothing is lost by cutting; with them the blocks are worth at least the whole."""
    for seed in range(40):
        oracle, prices = window(seed)
        whole = oracle.best_paths(prices)[0]
        parts = oracle.blocks(2)
        assert sum(part.shape[0] for part in parts) == len(prices)
        total = sum(part.best_paths(prices[2 * b : 2 * b + part.shape[0]])[0] for b, part in enumerate(parts))
        assert (total >= whole - 1e-12).all()
        if len(parts) == 1:
            np.testing.assert_allclose(total, whole, atol=1e-12)
