"""The observations of the thesis and of its published code against plain twins, and Q-values against a dense alpha."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("torch")

from scipy.optimize import linear_sum_assignment

from sapopt import Benefits, assign
from sapopt.learning.observation import (
    ObservationSpec,
    ThesisObservation,
    dense_values,
    gain_matrix,
    observe,
)


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


def plain_thesis(
    benefits: np.ndarray, k: int, held: np.ndarray, charge: np.ndarray | None, spec: ThesisObservation
) -> tuple[np.ndarray, np.ndarray]:
    """Observations and listed tasks, straight from section 6.2.2."""
    T, n, _ = benefits.shape
    M, N, L = spec.tasks, spec.neighbours, spec.steps
    window = np.zeros((L, *benefits.shape[1:]))
    window[: min(L, T - k)] = benefits[k : k + L]
    sums = window.sum(axis=0)
    seen, listed = [], np.full((n, M), -1)
    for i in range(n):
        best = sorted(np.flatnonzero(sums[i] > 0), key=lambda j: (-sums[i, j], j))[:M]
        listed[i, : len(best)] = best
        highest = {a: max((sums[a, j] for j in best), default=0.0) for a in range(n) if a != i}
        order = sorted((a for a, top in highest.items() if top > 0), key=lambda a: (-highest[a], a))[:N]
        shown, flags, charges = np.zeros((1 + N, M, L)), np.zeros((1 + N, M)), np.zeros(1 + N)
        for q, a in enumerate([i, *order]):
            for s, j in enumerate(best):
                shown[q, s] = window[:, a, j]
                flags[q, s] = held[a] == j
            if charge is not None:
                charges[q] = charge[a]
        parts = [shown.ravel(), flags.ravel()] + ([] if charge is None else [charges])
        seen.append(np.concatenate(parts))
    return np.array(seen), listed


@given(data=st.data(), seed=st.integers(0, 2**32 - 1), charged=st.booleans())
def test_thesis_kernel_is_the_definition(data: st.DataObject, seed: int, charged: bool) -> None:
    """The compiled observation of section 6.2.2 equals the plain one, ties included, with and without a past."""
    rng = np.random.default_rng(seed)
    T, n = data.draw(st.integers(1, 5)), data.draw(st.integers(1, 6))
    m = n + data.draw(st.integers(0, 4))
    sizes = [data.draw(st.integers(1, 4)) for _ in range(3)]
    spec = ThesisObservation(*sizes, charge=charged)
    benefits = rng.integers(1, 5, (T, n, m)) * (rng.random((T, n, m)) < 0.5) / 4.0
    past = rng.permutation(m)[:n] if data.draw(st.booleans()) else None
    charge = rng.integers(0, 11, n) / 10 if charged else None
    k = data.draw(st.integers(0, T - 1))
    seen, listed = observe(Benefits(benefits).flat(), (T, n, m), k, past, charge, spec)
    held = np.full(n, -1) if past is None else past
    wanted, tasks = plain_thesis(benefits, k, held, charge, spec)
    assert seen.shape == (n, spec.size)
    np.testing.assert_array_equal(listed, tasks)
    np.testing.assert_allclose(seen, wanted, atol=1e-7)


def test_neighbours_by_the_largest_benefit() -> None:
    """Agent 1 sees one task of agent 0 well, agent 2 two of them fairly: the thesis lists 1, the published code 2."""
    benefits = np.array([[[1.0, 1.0, 0.0], [0.8, 0.0, 0.0], [0.5, 0.5, 0.0]]])
    flat, shape = Benefits(benefits).flat(), (1, 3, 3)
    for spec, expected in (
        (ThesisObservation(2, 1, 1, charge=False), [0.8, 0.0]),
        (ObservationSpec(2, 1, 1, charge=False), [0.5, 0.5]),
    ):
        seen, _ = observe(flat, shape, 0, None, None, spec)
        np.testing.assert_allclose(seen[0, 2:4], expected)


def test_sizes() -> None:
    """The published code's settings give its 501 numbers, those of the thesis' text 451; both have 11 outputs."""
    assert ObservationSpec().size == 501
    assert ThesisObservation().size == 451
    assert ObservationSpec().actions == ThesisObservation().actions == 11


@pytest.mark.parametrize(("name", "value"), [("tasks", 3), ("neighbours", 0), ("steps", 1.5)])
def test_bad_sizes_are_named(name: str, value: float) -> None:
    """A size that cannot be is refused by its name."""
    with pytest.raises(ValueError, match=name):
        ObservationSpec(**{name: value})  # type: ignore[arg-type]
    if name != "tasks":
        with pytest.raises(ValueError, match=name):
            ThesisObservation(**{name: value})  # type: ignore[arg-type]


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
    np.testing.assert_array_equal(dense_values(q, tasks, m), dense)
    chosen = assign(gain_matrix(q, tasks, m))
    assert len(set(chosen)) == n
    rows, columns = linear_sum_assignment(dense, maximize=True)
    assert dense[np.arange(n), chosen].sum() == pytest.approx(dense[rows, columns].sum())
