"""Robust and recoverable robust assignment against enumeration."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from sapopt import InfeasibleError
from sapopt.formulations.robust import RecoverableAssignment, RobustAssignment


def rows(n: int, m: int) -> list[np.ndarray]:
    """All assignments."""
    return [np.array(row) for row in itertools.permutations(range(m), n)]


@pytest.mark.parametrize("seed", range(6))
def test_robust(seed: int) -> None:
    """The worst value over the scenarios is the greatest possible."""
    rng = np.random.default_rng(seed)
    n, m = (3, 3) if seed % 2 else (2, 4)
    model = RobustAssignment(rng.normal(size=(3, n, m)))
    tasks, value = model.solve()
    assert value == pytest.approx(max(model.value(row) for row in rows(n, m)), abs=1e-6)
    assert value == model.value(tasks)


@pytest.mark.parametrize("shared", range(4))
@pytest.mark.parametrize("scenarios", [1, 2])
def test_recoverable(shared: int, scenarios: int) -> None:
    """First and recovered assignments share at least k pairs and are the best to do so."""
    rng = np.random.default_rng(shared)
    model = RecoverableAssignment(rng.random((3, 4)), rng.random((scenarios, 3, 4)), shared)
    now, recovered, value = model.solve()
    every = rows(3, 4)
    best = max(
        model.first[np.arange(3), x].sum()
        + min(
            max(matrix[np.arange(3), y].sum() for y in every if (x == y).sum() >= shared)
            for matrix in model.second
        )
        for x in every
    )
    assert value == pytest.approx(best, abs=1e-6)
    assert all((now == y).sum() >= shared for y in recovered)


@pytest.mark.parametrize("shared", [0, 1, 2, 3])
def test_the_second_stage_alone(shared: int) -> None:
    """With a given first assignment: the best one that shares enough pairs with it, by enumeration."""
    rng = np.random.default_rng(shared)
    previous, benefits = rng.permutation(4)[:3], rng.random((3, 4))
    now, (again,), value = RecoverableAssignment.after(previous, benefits, shared).solve()
    assert np.array_equal(now, previous)
    best = max(benefits[np.arange(3), x].sum() for x in rows(3, 4) if (x == previous).sum() >= shared)
    assert value == pytest.approx(best)
    assert (again == previous).sum() >= shared
    with pytest.raises(ValueError, match="previous must hold"):
        RecoverableAssignment.after([0, 1], benefits, shared)


def test_all_shared_is_one_assignment() -> None:
    """With k = n the recovered assignment is the first one: alpha of the sum."""
    rng = np.random.default_rng(0)
    first, second = rng.random((2, 3, 3))
    now, (again,), value = RecoverableAssignment(first, second, 3).solve()
    assert np.array_equal(now, again)
    assert value == pytest.approx(max((first + second)[np.arange(3), row].sum() for row in rows(3, 3)))


def test_infeasible() -> None:
    """Forbidden pairs that leave nothing are named."""
    closed = np.full((2, 2), -np.inf)
    closed[:, 0] = 1.0
    with pytest.raises(InfeasibleError, match="agents 0, 1"):
        RobustAssignment([np.ones((2, 2)), closed]).solve()
    with pytest.raises(InfeasibleError, match=r"second\[0\]: no full assignment"):
        RecoverableAssignment(np.ones((2, 2)), closed, 0).solve()
    one = np.where(np.eye(2) > 0, 1.0, -np.inf)
    with pytest.raises(InfeasibleError, match="share"):
        RecoverableAssignment(one, one[::-1], 1).solve()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RobustAssignment(np.ones((2, 3))), "matrices must be"),
        (lambda: RobustAssignment(np.ones((1, 3, 2))), "matrices must be"),
        (lambda: RobustAssignment(np.full((1, 2, 2), np.nan)), "NaN"),
        (lambda: RecoverableAssignment(np.ones((2, 2)), np.ones((2, 3)), 1), "second holds"),
        (lambda: RecoverableAssignment(np.ones((2, 2)), np.ones((2, 2)), 3), "shared must be"),
        (lambda: RobustAssignment(np.ones((1, 2, 2))).value([0, 0]), "two agents"),
        (
            lambda: RecoverableAssignment(np.ones((2, 2)), np.ones((2, 2)), 2).value([0, 1], [[1, 0]]),
            "shares 0",
        ),
    ],
)
def test_bad_arguments(make: Any, message: str) -> None:
    """One clear line each."""
    with pytest.raises(ValueError, match=message):
        make()
