"""The observation kernel against the words of section 6.2, and Q-values against a dense alpha."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("torch")

from scipy.optimize import linear_sum_assignment

from sapopt import Benefits, assign
from sapopt.learning.observation import ObservationSpec, gain_matrix, observe


def plain(
    benefits: np.ndarray, k: int, held: np.ndarray, charge: np.ndarray | None, spec: ObservationSpec
) -> tuple[np.ndarray, np.ndarray]:
    """Observations and listed tasks, straight from the definition."""
    T, n, m = benefits.shape
    M, N, L = spec.tasks, spec.neighbours, spec.steps
    window = np.zeros((L, n, m))
    window[: min(L, T - k)] = benefits[k : k + L]
    sums = window.sum(axis=0)
    ranked = [sorted(np.flatnonzero(sums[i] > 0), key=lambda j: (-sums[i, j], j)) for i in range(n)]
    seen, listed = [], np.full((n, M), -1)
    for i in range(n):
        best = ranked[i][:M]
        listed[i, : len(best)] = best
        rivalry = {a: sum(sums[a, j] for j in best) for a in range(n) if a != i}
        order = sorted((a for a, r in rivalry.items() if r > 0), key=lambda a: (-rivalry[a], a))[:N]
        own, rivals, others = np.zeros((M, L)), np.zeros((N, M, L)), np.zeros((N, M // 2, L))
        flags, charges = np.zeros(M), np.zeros(N + 1)
        for s, j in enumerate(best):
            own[s] = window[:, i, j]
            flags[s] = held[i] == j
            for q, a in enumerate(order):
                rivals[q, s] = window[:, a, j]
        for q, a in enumerate(order):
            for s, j in enumerate([j for j in ranked[a] if j not in best][: M // 2]):
                others[q, s] = window[:, a, j]
        parts = [own.ravel(), rivals.ravel(), others.ravel(), flags]
        if charge is not None:
            charges[0], charges[1 : len(order) + 1] = charge[i], charge[order]
            parts.append(charges)
        seen.append(np.concatenate(parts))
    return np.array(seen), listed


@given(data=st.data(), seed=st.integers(0, 2**32 - 1), charged=st.booleans())
def test_kernel_is_the_definition(data: st.DataObject, seed: int, charged: bool) -> None:
    """The compiled observation equals the plain one, ties included."""
    rng = np.random.default_rng(seed)
    T, n = data.draw(st.integers(1, 5)), data.draw(st.integers(1, 6))
    m = n + data.draw(st.integers(0, 4))
    spec = ObservationSpec(
        2 * data.draw(st.integers(1, 3)), data.draw(st.integers(1, 4)), data.draw(st.integers(1, 3)), charged
    )
    benefits = rng.integers(1, 5, (T, n, m)) * (rng.random((T, n, m)) < 0.5) / 4.0
    held = rng.permutation(m)[:n]
    charge = rng.integers(0, 11, n) / 10 if charged else None
    k = data.draw(st.integers(0, T - 1))
    seen, listed = observe(Benefits(benefits).flat(), (T, n, m), k, held, charge, spec)
    wanted, tasks = plain(benefits, k, held, charge, spec)
    assert seen.shape == (n, spec.size)
    np.testing.assert_array_equal(listed, tasks)
    np.testing.assert_allclose(seen, wanted, atol=1e-7)


def test_published_size() -> None:
    """The thesis' settings give its 501 numbers and 11 outputs."""
    assert ObservationSpec().size == 501
    assert ObservationSpec().actions == 11


@pytest.mark.parametrize(("name", "value"), [("tasks", 3), ("neighbours", 0), ("steps", 1.5)])
def test_bad_sizes_are_named(name: str, value: float) -> None:
    """A size that cannot be is refused by its name."""
    with pytest.raises(ValueError, match=name):
        ObservationSpec(**{name: value})  # type: ignore[arg-type]


@given(seed=st.integers(0, 2**32 - 1))
def test_gains_are_alpha_of_the_dense_matrix(seed: int) -> None:
    """alpha of the sparse gains is worth as much as alpha of the full matrix of Q-values."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    m, M = n + int(rng.integers(0, 5)), 4
    tasks = np.full((n, M), -1)
    for i in range(n):
        count = int(rng.integers(0, min(M, m) + 1))
        tasks[i, :count] = rng.permutation(m)[:count]
    q = np.round(rng.normal(size=(n, M + 1)), 1)
    dense = np.repeat(q[:, -1:], m, axis=1)
    for i in range(n):
        for s in range(M):
            if tasks[i, s] >= 0:
                dense[i, tasks[i, s]] = q[i, s]
    chosen = assign(gain_matrix(q, tasks, m))
    assert len(set(chosen)) == n
    rows, columns = linear_sum_assignment(dense, maximize=True)
    assert dense[np.arange(n), chosen].sum() == pytest.approx(dense[rows, columns].sum())
