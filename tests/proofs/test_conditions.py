"""Definitions 3.2.1, 3.2.2 and 3.5.1 and |H|, as the thesis writes them, against brute force."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from own_conditions import Tired

from sapopt import SAP, SwitchingCost
from sapopt.dynamics import Battery, Dictator
from sapopt.proofs.conditions import conditions, handover_range
from sapopt.proofs.promises import hamming


def assignments(problem: SAP) -> list[np.ndarray]:
    """All of X."""
    return [np.array(x) for x in itertools.permutations(range(problem.m), problem.n)]


def strict_by_definition(problem: SAP) -> bool:
    """Definition 3.2.2 over all assignments as states, with the number of moves as the distance."""
    first = 1 if problem.initial_assignment is None else 0
    for k in range(first, problem.T):
        for s in assignments(problem):
            pairs = [
                ((x != s).sum(), problem.handover(k, s)[np.arange(problem.n), x].sum())
                for x in assignments(problem)
            ]
            for (far, low), (near, high) in itertools.product(pairs, repeat=2):
                if far >= near and low > high + 1e-12:
                    return False
    return True


def size_by_definition(problem: SAP) -> float:
    """|H| over all assignments as states."""
    first = 1 if problem.initial_assignment is None else 0
    worth = [
        problem.handover(k, s)[np.arange(problem.n), x].sum()
        for k in range(first, problem.T)
        for s in assignments(problem)
        for x in assignments(problem)
    ]
    return max(worth) - min(worth) if worth else 0.0


@pytest.mark.parametrize("seed", range(60))
def test_the_switching_rule_by_brute_force(seed: int) -> None:
    """Strict penalty and |H| in closed form: uniform costs, matrices, free idling, n = m, one agent, zero costs."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    m = n + int(rng.integers(0, 3))
    benefits = rng.integers(0, 3, (2, n, m)).astype(float)
    cost: Any = float(rng.integers(0, 3))
    if seed % 3 == 0:
        cost = rng.integers(0, 3, (m, m)) * (1.0 - np.eye(m))
    elif seed % 3 == 1:
        cost = rng.integers(0, 2, (m, 1)) * (1.0 - np.eye(m))
    problem = SAP(benefits, SwitchingCost(cost, idle_is_free=bool(seed % 2)), rng.permutation(m)[:n])
    assert conditions(problem).vanishing == "yes"
    assert conditions(problem).domination == 0.0
    if conditions(problem).strict_penalty != "unknown" and seed % 2 == 0:
        assert (conditions(problem).strict_penalty == "yes") == strict_by_definition(problem)
    size = handover_range(problem).size
    if seed % 2 and np.ndim(cost):
        assert size >= size_by_definition(problem) - 1e-12  # a bound, where idling is free
    else:
        assert size == pytest.approx(size_by_definition(problem))


def test_strict_penalty_of_the_switching_rule() -> None:
    """Equal costs are strict, none at all too; unequal ones and free idling beside paid moves are not."""
    benefits = np.ones((3, 2, 4))
    matrix = np.ones((4, 4)) - np.eye(4)
    unequal = matrix.copy()
    unequal[0, 1] = 0.0
    for dynamics, answer in (
        (SwitchingCost(1.0), "yes"), (SwitchingCost(0.0), "yes"), (SwitchingCost(matrix), "yes"),
        (SwitchingCost(unequal), "no"), (SwitchingCost(1.0, idle_is_free=True), "yes"),
    ):  # fmt: skip
        assert conditions(SAP(benefits, dynamics)).strict_penalty == answer
    benefits[1:, :, 0] = 0.0
    assert conditions(SAP(benefits, SwitchingCost(1.0, idle_is_free=True))).strict_penalty == "no"
    large = [sp.random_array((40, 60), density=0.1, rng=np.random.default_rng(0)) for _ in range(2)]
    assert conditions(SAP(large, SwitchingCost(1.0, idle_is_free=True))).strict_penalty == "unknown"


def test_domination_is_a_distance() -> None:
    """A battery remembers more than the assignment, and is dominated with D > 0; a dictator's state with D = 0."""
    rng = np.random.default_rng(0)
    problem = SAP(rng.random((3, 2, 3)) * (rng.random((3, 2, 3)) < 0.6), Battery(0.5, 0.5, 0.25))
    assert conditions(problem).domination > 0
    assert conditions(problem, lambda s, t: abs(s.levels - t.levels).max()).domination == 4.0  # full and dead
    leader = SAP(rng.random((3, 2, 3)), Dictator(rng.random((3, 2, 3)), np.tile(np.arange(3), (3, 1))))
    assert conditions(leader).domination == 0.0
    assert conditions(SAP(rng.random((3, 2, 3)), Tired(True))).vanishing == "no"
    assert conditions(SAP(rng.random((3, 2, 3)), Tired(False))).vanishing == "yes"


@pytest.mark.parametrize("scale", [1e-300, 1e-13, 1.0, 1e150])
def test_the_scale_of_the_handovers_decides_nothing(scale: float) -> None:
    """Two moves of unequal cost are told apart however small both are."""
    cost = scale * (1.0 - np.eye(4)) * np.arange(1.0, 5.0)
    for matrix, strict in ((cost, "no"), (scale * (1.0 - np.eye(4)), "yes")):
        assert conditions(SAP(np.ones((2, 1, 4)), SwitchingCost(matrix)), hamming).strict_penalty == strict


def test_what_is_too_large_is_unknown() -> None:
    """A user's dynamics with too many states and assignments is not guessed at."""
    found = conditions(SAP(np.ones((3, 2, 200)), Wide()))
    assert (found.vanishing, found.strict_penalty) == ("unknown", "unknown")
    assert math.isnan(found.domination)
    assert "not known" in found.broken


class Wide:
    """Free moves."""

    def initial_state(self, problem: SAP) -> tuple[int, ...]:
        return (0,)

    def handover(self, k: int, state: tuple[int, ...]) -> np.ndarray:
        return np.zeros((2, 200))

    def transition(self, k: int, state: tuple[int, ...], assignment: np.ndarray) -> tuple[int, ...]:
        return tuple(int(j) for j in assignment)


def test_hamming_counts_agents() -> None:
    """Rows of arrays, entries of tuples, agents of states with several arrays."""
    assert hamming(np.array([1, 2, 3]), np.array([1, 0, 0])) == 2
    assert hamming(np.ones((2, 3)), np.zeros((2, 3))) == 2
    assert hamming((1, 2), (1, 3)) == 1
    assert hamming((np.array([1, 2]), 6), (np.array([1, 3]), 6)) == 1
    assert hamming((np.array([1, 2]), 6), (np.array([1, 3]), 7)) == 2
    assert hamming(None, np.array([1, 2])) == 2
    assert hamming(None, None) == 0
    assert hamming(4, 5) == 1
    assert hamming("a", "a") == 0
