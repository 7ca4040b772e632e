"""Unit commitment: starts, minimum times and orders that cannot be obeyed, by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rule_problems import committing

from sapopt import SAP, bound, certify, solve, verify
from sapopt.dynamics import UnitCommitment
from sapopt.dynamics.paths.oracles import LocalOracle
from sapopt.solvers import HAA, Exact

RUN, OFF = 0, 1


def one_unit(up: int, down: int, initial: int, steps: int = 6, shut_down: float = 0.0) -> SAP:
    """One unit that gains 10 by running, pays 4 for a start and 3 for running against the order."""
    benefits = np.zeros((steps, 1, 2))
    benefits[:, 0, RUN] = 10.0
    return SAP(benefits, UnitCommitment([4.0], [up], [down], [3.0], [initial], shut_down))


@pytest.mark.parametrize(
    ("up", "down", "initial", "orders", "value"),
    [
        (1, 1, 1, "rrrrrr", 60.0),
        (1, 1, -1, "rrrrrr", 56.0),
        (1, 1, -1, "rorooo", 20.0 - 8.0),
        (3, 1, -1, "rooooo", 10.0 - 4.0 - 6.0),  # runs for two more steps against the order
        (3, 1, 1, "oooooo", -6.0),  # has been on for one step
        (3, 1, 3, "oooooo", 0.0),
        (1, 3, 1, "orrror", 10.0 - 4.0),  # two of its orders to run come too early, the last as well
        (1, 3, -2, "rrrrrr", 50.0 - 4.0),  # off for one more step
        (2, 2, -2, "rorrrr", 10.0 - 4.0 - 3.0 + 40.0),  # runs through
    ],
)
def test_by_hand(up: int, down: int, initial: int, orders: str, value: float) -> None:
    plan = [[RUN if order == "r" else OFF] for order in orders]
    assert one_unit(up, down, initial).evaluate(plan).value == pytest.approx(value)


@pytest.mark.parametrize(
    ("up", "down", "initial", "orders", "value"),
    [
        (1, 1, 1, "rrrrrr", 60.0),  # the end of the horizon is no stop
        (1, 1, 1, "oooooo", -7.0),
        (1, 1, -1, "oooooo", 0.0),
        (1, 1, -1, "rorooo", 20.0 - 8.0 - 14.0),
        (3, 1, -1, "rooooo", 10.0 - 4.0 - 6.0 - 7.0),  # stops when it may
        (3, 1, 1, "oooooo", -6.0 - 7.0),
        (1, 3, 1, "orrror", 10.0 - 4.0 - 14.0),  # the first stop, and the one after the only step it runs
        (2, 2, -2, "rorrrr", 10.0 - 4.0 - 3.0 + 40.0),
    ],
)
def test_stops_by_hand(up: int, down: int, initial: int, orders: str, value: float) -> None:
    """A stop costs 7, whenever the unit really stops."""
    plan = [[RUN if order == "r" else OFF] for order in orders]
    assert one_unit(up, down, initial, shut_down=7.0).evaluate(plan).value == pytest.approx(value)


@pytest.mark.parametrize("seed", range(12))
def test_stops_bounded_and_solved(seed: int) -> None:
    """With shut-down costs the bound lies above the optimum of brute force, the exact methods meet it, and the single
    agents' compiled paths are those of the plain local model."""
    problem = committing(seed, stops=True)
    assert problem.dynamics.shut_down.all()
    best = solve(problem, Exact(method="dp")).value
    assert bound(problem, time_limit=2.0).value >= best - 1e-9
    assert solve(problem, Exact(method="network")).value == pytest.approx(best)
    assert (
        best <= solve(committing(seed), Exact(method="dp")).value + 1e-12
    )  # a cost more, everything else equal
    prices = np.random.default_rng(seed).random((problem.T, problem.m)) * 2
    state = problem.initial_state()
    fast = problem.model.path_oracle(problem.benefits, state)
    plain = LocalOracle(problem.benefits, problem.model.local_model(problem.benefits, state))
    np.testing.assert_allclose(fast.best_paths(prices)[0], plain.best_paths(prices)[0], atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_stops_survive_a_file(seed: int, tmp_path: Path) -> None:
    """A problem with shut-down costs is written and read, with its value, its fingerprint and a certificate."""
    problem = committing(seed, stops=True)
    problem.save(tmp_path / "p.npz")
    again = SAP.load(tmp_path / "p.npz")
    np.testing.assert_array_equal(again.dynamics.shut_down, problem.dynamics.shut_down)
    assert again.fingerprint == problem.fingerprint
    assert again.fingerprint != committing(seed).fingerprint
    result = solve(problem, HAA())
    assert again.evaluate(result.plan).value == result.value
    certify(problem, result).save(tmp_path / "c.npz")
    assert verify(tmp_path / "c.npz", again)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start_up": [-1.0, 1.0]}, "start_up must be"),
        ({"idling": [np.inf, 1.0]}, "idling must be"),
        ({"shut_down": [1.0, -1.0]}, "shut_down must be"),
        ({"shut_down": [1.0]}, "one entry per unit"),
        ({"minimum_up": [0, 1]}, "minimum_up must be"),
        ({"initial": [0, 1]}, "initial must be"),
        ({"minimum_down": [1]}, "one entry per unit"),
        ({"minimum_up": [1.5, 1]}, "minimum_up must hold integers"),
    ],
)
def test_bad_input(changes: dict[str, Any], message: str) -> None:
    options: dict[str, Any] = {
        "start_up": [1.0, 1.0], "minimum_up": [1, 1], "minimum_down": [1, 1], "idling": [1.0, 1.0], "initial": [1, 1],
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        UnitCommitment(**(options | changes))


def test_a_unit_for_every_agent() -> None:
    with pytest.raises(ValueError, match="start_up has 1 entries for 2 agents"):
        SAP(np.zeros((2, 2, 2)), UnitCommitment([1.0], [1], [1], [1.0], [1]))
