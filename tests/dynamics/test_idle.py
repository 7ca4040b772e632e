"""Idleness as a last task: the sparse way and the entries against the matrix."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, SwitchingCost
from sapopt.data.matrices import GainMatrix
from sapopt.data.windows import WindowSums
from sapopt.dynamics.base import Model


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.booleans(), st.booleans(), st.integers(1, 3))
def test_sparse_intervals(seed: int, idle_is_free: bool, closes: bool, length: int) -> None:
    """An interval in sparse form is the window sum plus the handover matrix, and entries are those of the matrix."""
    rng = np.random.default_rng(seed)
    n, m = 3, 4
    benefits = [
        sp.csr_array(np.round(rng.normal(size=(n, m)), 1) * (rng.random((n, m)) < 0.4)) for _ in range(3)
    ]
    capacity = rng.integers(0, 2, (3, m)) if closes else 1
    problem = SAP(benefits, SwitchingCost(0.3, idle_is_free), idle=True, capacity=capacity)
    model, windows = problem.model, WindowSums(problem.core.benefits)
    for state in (None, rng.permutation(m + 1)[:n]):
        found = model.interval(windows, 0, length, state)
        assert isinstance(found, GainMatrix) or not windows.is_sparse
        expected = Model.interval(model, windows, 0, length, state)
        dense = found.toarray() if isinstance(found, GainMatrix) else np.asarray(found)
        assert dense == pytest.approx(np.asarray(expected), abs=1e-12)
        if isinstance(found, GainMatrix):
            rows = np.repeat(np.arange(n), np.diff(found.row_start))
            assert (found.gains[1:] <= found.gains[:-1])[np.diff(rows) == 0].all()
        tasks = rng.permutation(m + 1)[:n]
        entries = Model.handover_at(model, 0, state, tasks)
        assert np.array_equal(model.handover_at(0, state, tasks) + 0.0, entries + 0.0)
