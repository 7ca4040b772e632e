"""The dictator's dynamics: eta and transition are the tables, files round-trip, bad input is refused."""

from __future__ import annotations

from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import arrays, quarters

from sapopt import SAP, bound, solve
from sapopt.dynamics import Dictator, Dynamics
from sapopt.solvers import HAA, HAAL, Exact, Greedy, NoHandover


@st.composite
def problems(draw: Any) -> SAP:
    """Small problems with two or three states."""
    S, n = draw(st.integers(2, 3)), draw(st.integers(1, 3))
    m, steps = draw(st.integers(n, 3)), draw(st.integers(1, 3))
    leads_to = np.array([[draw(st.integers(0, S - 1)) for _ in range(m)] for _ in range(S)])
    dynamics = Dictator(
        draw(arrays((S, n, m), quarters)), leads_to, draw(st.integers(0, n - 1)), draw(st.integers(0, S - 1))
    )
    return SAP(draw(arrays((steps, n, m), quarters)), dynamics)


def worth(problem: SAP, plan: Any) -> float:
    """Value of a plan, from the tables."""
    dynamics = problem.dynamics
    state, total = dynamics.start, 0.0
    for k, row in enumerate(plan):
        total += sum(
            problem.benefits.dense()[k, i, j] + dynamics.values[state, i, j] for i, j in enumerate(row)
        )
        state = dynamics.leads_to[state, row[dynamics.leader]]
    return float(total)


@given(problems())
def test_exact_is_the_best_of_all_plans(problem: SAP) -> None:
    """Dynamic programming finds the value of the best plan; no heuristic beats it, and the bound is above."""
    rows = list(permutations(range(problem.m), problem.n))
    best = max(worth(problem, plan) for plan in product(rows, repeat=problem.T))
    found = solve(problem, Exact(method="dp"))
    assert found.value == pytest.approx(best)
    assert found.bound == pytest.approx(best)
    assert bound(problem).value >= best
    for solver in (HAA(), HAAL(2), Greedy(), NoHandover()):
        result = solve(problem, solver)
        assert result.value == pytest.approx(worth(problem, result.plan))
        assert result.value <= best + 1e-9


def test_files(tmp_path: Path) -> None:
    """A problem keeps its tables, and its fingerprint, through a file."""
    values = np.random.default_rng(0).random((2, 2, 3))
    problem = SAP(np.ones((4, 2, 3)), Dictator(values, [[0, 1, 1], [1, 0, 0]], leader=1, start=1))
    problem.save(tmp_path / "p.npz")
    again = SAP.load(tmp_path / "p.npz")
    assert again.fingerprint == problem.fingerprint
    assert (again.dynamics.leader, again.dynamics.start) == (1, 1)
    assert isinstance(again.dynamics, Dynamics)
    plan = [[0, 1], [2, 0], [1, 2], [0, 2]]
    assert again.evaluate(plan).value == problem.evaluate(plan).value == pytest.approx(worth(problem, plan))


GOOD: dict[str, Any] = {"values": np.zeros((2, 2, 3)), "leads_to": [[0, 1, 1], [1, 0, 0]]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values": np.zeros((2, 3))}, r"values must have shape \(S, n, m\)"),
        ({"values": np.full((2, 2, 3), np.nan)}, "values must be finite"),
        ({"leads_to": [[0, 1, 2], [0, 0, 0]]}, r"leads_to must hold states 0\.\.1"),
        ({"leads_to": [0, 1, 1]}, "leads_to"),
        ({"leader": 2}, r"leader must be a whole number in 0\.\.1"),
        ({"start": -1}, "start must be a whole number"),
    ],
)
def test_bad_input(change: dict[str, Any], message: str) -> None:
    """Each is a ValueError that names the argument."""
    with pytest.raises(ValueError, match=message):
        Dictator(**(GOOD | change))


def test_must_fit_the_benefits() -> None:
    """Tables for other sizes than those of the benefits are refused."""
    with pytest.raises(ValueError, match="values are for 2 agents and 3 tasks"):
        SAP(np.ones((1, 3, 3)), Dictator(**GOOD))
