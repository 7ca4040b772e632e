"""The value of charge after the window: exact on small cases, shifts nothing when it is constant, survives its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sapopt import SAP, SwitchingCost, solve
from sapopt.domains.instances import instance
from sapopt.dynamics import Battery
from sapopt.solvers import DualLookahead
from sapopt.solvers.charge_value import ChargeValue


def small(seed: int, T: int = 3) -> SAP:
    """Three agents on batteries of five levels."""
    rng = np.random.default_rng(seed)
    benefits = rng.random((T, 3, 5)) * (rng.random((T, 3, 5)) < 0.6)
    return SAP(benefits, Battery(0.3, drain=0.4, charge=0.2), [0, 1, 2])


def best(problem: SAP, agent: int, end: np.ndarray) -> float:
    """Best path of one agent and the value of the charge it ends with, over all paths."""
    battery = problem.dynamics
    units = battery.units

    def from_step(k: int, level: int, held: int) -> float:
        if k == problem.T:
            return float(end[level])
        options = []
        for j in range(problem.m):
            benefit = problem.benefits.step(k)[agent, j]
            if benefit > 0 and level > 0:
                after, gain = max(level - units.drain, 0), benefit - battery.cost * (j != held)
            else:
                after, gain = (min(level + units.charge, units.capacity) if level else 0), 0.0
            options.append(gain + from_step(k + 1, after, j))
        return max(options)

    return from_step(0, units.capacity, agent)


@pytest.mark.parametrize("seed", range(4))
def test_paths_count_the_charge_at_the_end(seed: int) -> None:
    """Without prices the longest paths are the best of all paths with the value of what is left."""
    problem = small(seed)
    end = np.sort(np.random.default_rng(seed).random(6)) * 2
    oracle = problem.model.path_oracle(problem.benefits, problem.initial_state(), end)
    values, _ = oracle.best_paths(np.zeros((problem.T, problem.m)))
    wanted = [best(problem, i, end) for i in range(3)]
    np.testing.assert_allclose(values, wanted)
    np.testing.assert_allclose(oracle.first_values(np.zeros((problem.T, problem.m))).max(axis=1), wanted)
    soft, _ = oracle.soft_paths(np.zeros((problem.T, problem.m)), 4e-3)
    np.testing.assert_allclose(soft, wanted, atol=0.02)


def test_constant_value_changes_nothing() -> None:
    """Only differences between levels matter."""
    problem = small(9, T=8)
    plans = [
        solve(problem, DualLookahead(3, end_value=ChargeValue(np.full((9, 6), value)))).plan
        for value in (0.0, 4.0)
    ]
    np.testing.assert_array_equal(*plans)


def test_a_dear_charge_is_kept() -> None:
    """Nobody works while charge is worth more than any task, but at the last steps, which have no later."""
    benefits = np.random.default_rng(5).random((6, 3, 6))
    benefits[:, :, 3:] = 0.0  # there is always a place to idle
    problem = SAP(benefits, Battery(0.3, drain=0.4, charge=0.2), [0, 1, 2])
    dear = ChargeValue(np.linspace(0, 100, 6)[None] * np.array([[0.0]] + [[1.0]] * 6))
    plan = solve(problem, DualLookahead(2, end_value=dear)).plan
    worth = problem.benefits.at(plan)
    assert (worth[:-2] == 0).all()
    assert worth[-1].any()


def test_learned_table() -> None:
    """The value grows with the charge and with the steps that are left, and is nothing at the end."""
    table = ChargeValue.learn([small(1, T=10), small(2, T=10)], iterations=40).table
    assert table.shape == (11, 6)
    assert (np.diff(table, axis=1) >= -1e-9).all()
    assert (np.diff(table[:, 1:], axis=0) >= -1e-9).all()
    assert (table[0] == 0).all()


def test_scaling_keeps_the_value_of_life() -> None:
    """Differences between living levels are scaled; what it is worth to be alive is not."""
    value = ChargeValue([[0.0, 4.0, 5.0, 7.0]]).scaled(0.5)
    np.testing.assert_allclose(value.table, [[0.0, 4.0, 4.5, 5.5]])
    with pytest.raises(ValueError, match="factor"):
        value.scaled(-1.0)


def test_file(tmp_path: Path) -> None:
    """A table comes back as it was; the shipped one is there; damage and strangers are refused."""
    value = ChargeValue(np.arange(6.0).reshape(2, 3), "by hand")
    value.save(tmp_path / "v.json")
    back = ChargeValue.load(tmp_path / "v.json")
    np.testing.assert_array_equal(back.table, value.table)
    assert back.about == "by hand"
    assert ChargeValue.load("power").table.shape == (101, 11)
    (tmp_path / "v.json").write_text('{"format": ' + "[" * 10_000)
    with pytest.raises(ValueError, match="not a table of charge values"):
        ChargeValue.load(tmp_path / "v.json")
    (tmp_path / "v.json").write_text("{}")
    with pytest.raises(ValueError, match="not a table of charge values"):
        ChargeValue.load(tmp_path / "v.json")


def test_bad_arguments() -> None:
    """What has no charge has no value of it; tables and end values must have the right form."""
    plain = SAP(np.ones((2, 2, 2)), SwitchingCost(0.1))
    with pytest.raises(ValueError, match="charge"):
        solve(plain, DualLookahead(2, end_value=ChargeValue.load("power")))
    with pytest.raises(ValueError, match="charge"):
        ChargeValue.learn([plain])
    with pytest.raises(ValueError, match="at least one"):
        ChargeValue.learn([])
    with pytest.raises(ValueError, match="same number of steps"):
        ChargeValue.learn([small(0), small(0, T=4)])
    with pytest.raises(ValueError, match="table"):
        ChargeValue([[1.0, np.nan]])
    problem = small(0)
    with pytest.raises(ValueError, match="end_value"):
        problem.model.path_oracle(problem.benefits, problem.initial_state(), np.zeros(3))


@pytest.mark.slow
def test_power() -> None:
    """With a window of 3 on the power environment, the learned value gains 3 % on the rule of the window.

    Against a window that knows no value of charge it is 2.8 times as much (docs/learning.md has the whole episodes).
    """
    problem = instance("power", 11, steps=40)
    ruled, blind, valued = (
        solve(problem, DualLookahead(3, iterations=20, end_value=end)).value
        for end in (None, ChargeValue(np.zeros((1, 2))), ChargeValue.load("power"))
    )
    assert valued > 1.03 * ruled
    assert valued > 2.5 * blind
