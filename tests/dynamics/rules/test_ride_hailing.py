"""Ride-hailing: a few rides by hand, and the rule against a simulation that follows each driver by the clock."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sapopt import SAP
from sapopt.dynamics import RideHailing

# Places on a line, one step apart.
LINE = np.abs(np.arange(5)[:, None] - np.arange(5)[None])


def offers(steps: int, n: int, requests: list[tuple[int, float]]) -> np.ndarray:
    """Benefits of requests (step, worth)."""
    out = np.zeros((steps, n, len(requests) + n))
    for r, (step, worth) in enumerate(requests):
        out[step, :, r] = worth
    return out


def test_by_hand() -> None:
    """0 -> pick-up at 1 -> drop-off at 3, free at step 3; the next one waits at 4 from step 2 on."""
    rule = RideHailing(LINE, [1, 4], [3, 0], [0], patience=2, cost=0.5)
    problem = SAP(offers(6, 1, [(0, 10.0), (2, 8.0)]), rule)
    both = problem.evaluate([[0], [2], [1], [2], [2], [2]])
    # Empty to 1 (1 step), ride of 2, free at 3; takes the second at step 2 already, empty to 4 until 4 = 2 + patience.
    assert both.value == pytest.approx(10 - 0.5 + 8 - 0.5)
    late = SAP(problem.benefits, RideHailing(LINE, [1, 4], [3, 0], [0], patience=1, cost=0.5))
    # It would be there at 4 > 3: it earns nothing, and stays.
    assert late.evaluate([[0], [2], [1], [2], [2], [2]]).value == pytest.approx(10 - 0.5)
    assert late.transition(2, late.transition(0, late.initial_state(), np.array([0])), np.array([1])).local[
        0
    ] == (3 * 5 + 3)


def simulated(problem: SAP, plan: np.ndarray) -> float:
    """Value of a plan by following every driver."""
    rule: Any = problem.dynamics
    benefits = problem.benefits.dense()
    total = 0.0
    for i in range(problem.n):
        place, free = int(rule.home[i]), 0
        for k in range(problem.T):
            r = int(plan[k, i])
            fare = benefits[k, i, r]
            if fare == 0:
                continue
            start = free if free > k else k
            there = start + rule.travel[place][rule.pick_up[r]]
            if there > k + rule.patience:
                continue
            total += fare - rule.cost * rule.travel[place][rule.pick_up[r]]
            free = there + rule.travel[rule.pick_up[r]][rule.drop_off[r]]
            place = rule.drop_off[r]
    return total


def test_simulation() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n, requests, steps = 3, 12, 10
        calls = [(int(rng.integers(steps)), float(1 + rng.integers(8))) for _ in range(requests)]
        ends = rng.integers(0, 5, (2, requests))
        rule = RideHailing(LINE, *ends, rng.integers(0, 5, n), int(rng.integers(0, 4)), 0.25)
        problem = SAP(offers(steps, n, calls), rule)
        plan = np.array([rng.permutation(problem.m)[:n] for _ in range(steps)])
        for k in range(steps):  # send drivers to what is on offer, whether they can reach it or not
            now = [r for r, (step, _) in enumerate(calls) if step == k]
            idle = np.setdiff1d(np.arange(problem.m), now)
            plan[k] = np.append(rng.permutation(now), idle)[:n]
        assert problem.evaluate(plan).value == pytest.approx(simulated(problem, plan))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"travel": LINE[:3]}, "travel must be a"),
        ({"travel": np.zeros((5, 5), dtype=int)}, "at least 1 elsewhere"),
        ({"travel": LINE + 1}, "0 on the diagonal"),
        ({"pick_up": [9, 0]}, "pick_up must be"),
        ({"home": [-1]}, "home must be"),
        ({"drop_off": [1]}, "drop_off has 1"),
        ({"patience": -1}, "patience must be"),
        ({"patience": 1.5}, "patience must be"),
        ({"cost": float("nan")}, "cost must be"),
        ({"home": [0, 1]}, "home has 2 places for 1"),
    ],
)
def test_bad_input(changes: dict[str, Any], message: str) -> None:
    options: dict[str, Any] = {"travel": LINE, "pick_up": [1, 4], "drop_off": [3, 0], "home": [0]} | changes
    with pytest.raises(ValueError, match=message):
        SAP(offers(4, 1, [(0, 1.0), (1, 1.0)]), RideHailing(**options))


def test_benefits_must_be_offers() -> None:
    rule = RideHailing(LINE, [1], [3], [0])
    twice = offers(4, 1, [(0, 1.0)])
    twice[2, 0, 0] = 1.0
    with pytest.raises(ValueError, match="one step only"):
        SAP(twice, rule)
    with pytest.raises(ValueError, match="must not be negative"):
        SAP(offers(4, 1, [(0, -1.0)]), rule)
    with pytest.raises(ValueError, match="pick_up has 1 places, but task 1"):
        SAP(offers(4, 1, [(0, 1.0), (1, 1.0)]), rule)
