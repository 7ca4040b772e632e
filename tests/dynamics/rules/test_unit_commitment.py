"""Unit commitment: starts, minimum times and orders that cannot be obeyed, by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sapopt import SAP
from sapopt.dynamics import UnitCommitment

RUN, OFF = 0, 1


def one_unit(up: int, down: int, initial: int, steps: int = 6) -> SAP:
    """One unit that gains 10 by running, pays 4 for a start and 3 for running against the order."""
    benefits = np.zeros((steps, 1, 2))
    benefits[:, 0, RUN] = 10.0
    return SAP(benefits, UnitCommitment([4.0], [up], [down], [3.0], [initial]))


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
    ("changes", "message"),
    [
        ({"start_up": [-1.0, 1.0]}, "start_up must be"),
        ({"idling": [np.inf, 1.0]}, "idling must be"),
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
