"""Assignments to tasks with room: the sparse way of large problems against scipy over copies of the tasks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from sapopt.data import transport
from sapopt.data.matrices import GainMatrix
from sapopt.data.transport import beside_rest, transported


@given(st.integers(0, 10**6), st.integers(1, 7), st.integers(2, 7), st.booleans())
def test_sparse_beside_a_place_of_rest(seed: int, n: int, m: int, forbids: bool) -> None:
    """Where one task has room for all and the others for one, both ways find the same value, and nobody too many."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(n, m)) * (rng.random((n, m)) < 0.6)
    if forbids:
        matrix[rng.random((n, m)) < 0.2] = -np.inf
    rest = int(rng.integers(m))
    matrix[:, rest] = rng.normal(size=n)
    room = np.ones(m, dtype=np.int64)
    room[rest] = n
    plain = transported(matrix, room)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(transport, "LARGE", 0)
        sparse = transported(matrix, room)
    agents = np.arange(n)
    if not forbids:
        gains = GainMatrix.from_matrix(sp.csr_array(matrix))
        held = rng.integers(-1, m, n)
        gains = replace(gains, held=held, held_gain=rng.normal(size=n), rest=float(rng.normal()))
        whole = gains.toarray()
        found = beside_rest(gains, rest)
        assert whole[agents, found].sum() == pytest.approx(
            whole[agents, transported(whole, room)].sum(), abs=1e-9
        )
        assert (np.bincount(found, minlength=m) <= room).all()
    assert matrix[agents, sparse].sum() == pytest.approx(matrix[agents, plain].sum(), abs=1e-9)
    assert (np.bincount(sparse, minlength=m) <= room).all()
