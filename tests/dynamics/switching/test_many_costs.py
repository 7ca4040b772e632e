"""Paths of agents that pay different costs, against those of each cost alone."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import Benefits
from sapopt.dynamics.switching.many_costs import ManyCosts
from sapopt.dynamics.switching.paths import StrictSwitching


@pytest.mark.parametrize("tasks", [4, 40])
@pytest.mark.parametrize("held", [False, True])
def test_each_agent_pays_its_own_cost(tasks: int, held: bool) -> None:
    """Values, paths and soft values are those that an oracle of the agent's cost gives; usage is their sum."""
    rng = np.random.default_rng(tasks)
    T, n = 7, 4
    benefits = Benefits(rng.random((T, n, tasks)) * (rng.random((T, n, tasks)) < 0.2))
    state = rng.permutation(tasks)[:n] if held else None
    costs = np.array([0.3, 0.1, 0.3, 0.7])
    prices = np.round(rng.random((T, tasks)) * (rng.random((T, tasks)) < 0.5), 2)
    whole = StrictSwitching(benefits, 0.2, state)
    many = ManyCosts.of(whole, costs)
    values, plan = many.best_paths(prices)
    soft, usage = many.soft_paths(prices, 0.1)
    expected = np.zeros((T, tasks))
    for i, cost in enumerate(costs):
        alone = StrictSwitching(benefits, cost, state)
        assert values[i] == pytest.approx(alone.best_paths(prices)[0][i])
        assert many.best_path(i, prices)[0] == pytest.approx(values[i])
        assert soft[i] == pytest.approx(alone.soft_paths(prices, 0.1)[0][i])
        expected += whole.alone(np.array([i]), float(cost)).soft_paths(prices, 0.1)[1]
        held_before = plan[0, i] if state is None else state[i]
        moves = int((np.diff(np.append(held_before, plan[:, i])) != 0).sum())
        gained = benefits.dense()[np.arange(T), i, plan[:, i]].sum() - prices[np.arange(T), plan[:, i]].sum()
        assert gained - cost * moves == pytest.approx(values[i])
    assert usage == pytest.approx(expected, abs=1e-6)


def test_cut_and_narrowed_as_one_cost() -> None:
    """With one cost for all, blocks and narrowed paths are those of the one oracle."""
    rng = np.random.default_rng(0)
    benefits = Benefits(rng.random((8, 3, 30)) * (rng.random((8, 3, 30)) < 0.3))
    whole = StrictSwitching(benefits, 0.2, None)
    many = ManyCosts.of(whole, np.full(3, 0.2))
    prices = rng.random((8, 30)) * 0.3
    narrow = many.narrowed(prices, 0.5).soft_paths(prices, 0.05)
    for one, other in zip(narrow, whole.narrowed(prices, 0.5).soft_paths(prices, 0.05), strict=True):
        assert one == pytest.approx(other)
    for part, block in zip(many.blocks(4), whole.blocks(4), strict=True):
        assert part.best_paths(prices[:4])[0] == pytest.approx(block.best_paths(prices[:4])[0])
