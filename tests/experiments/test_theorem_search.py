"""The compiled search against the exact arithmetic, and that it finds what is there to find."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from experiments import theorem
from experiments import theorem_search as search


@pytest.mark.parametrize(
    "entry", [e for e in theorem.load() if "benefits" in e], ids=lambda entry: entry["name"]
)
def test_kernels_are_exact(entry: dict[str, Any]) -> None:
    """Optimum, HAAL, HAA and HAAL+ of the kernels are those of the rational arithmetic."""
    benefits = np.array(entry["benefits"], dtype=np.int64)
    rows = search.assignments(*benefits.shape[1:])
    eta = search.moves(rows, int(entry["cost"]))
    start = [tuple(row) for row in rows.tolist()].index(tuple(entry["initial_assignment"]))
    sums = search.static(benefits, rows)
    model, lookahead = entry["model"], entry["lookahead"]
    assert search.optimum(sums, eta, start) == theorem.optimum(model)
    assert {search.haal(sums, eta, start, lookahead, False)} == theorem.haal_values(model, lookahead)
    assert {search.haal(sums, eta, start, 1, False)} == theorem.haal_values(model, 1)
    assert search.haal(sums, eta, start, lookahead, True) == model.value(
        theorem.haal_plan(model, lookahead, keep_plan=True)
    )


def test_search_finds_the_tight_loss_of_haa() -> None:
    """Annealing reaches the loss (T - 1) |H| that is proven to be the most for L = 1, and does not exceed it."""
    rows = search.assignments(2, 3)
    eta = search.moves(rows, 10)
    palette = np.array([0, 1, 9, 10, 11, 20, 21, 30, 40])
    begin = np.random.default_rng(0).choice(palette, (3, 2, 3))
    found, lost = search.anneal(begin, rows, eta, 0, 1, False, palette, 10, 60_000, 0)
    assert 0.9 * 2 * 20 <= lost <= 2 * 20
    assert search.loss(found, rows, eta, 0, 1, False) == lost
