"""SwitchingCost: its matrix by the definition, its short forms equal to its matrix, and the costs it takes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import FORMS, Instance, as_form, instances

from sapopt import SAP, Benefits, GainMatrix, SwitchingCost
from sapopt.data.windows import WindowSums
from sapopt.dynamics import Dynamics


def definition(instance: Instance, k: int, state: Any) -> np.ndarray:
    """Handover matrix, entry by entry."""
    _, n, m = instance.benefits.shape
    return np.array(
        [[-instance.charge(k, i, None if state is None else state[i], j) for j in range(m)] for i in range(n)]
    )


@st.composite
def situations(draw: Any, **options: Any) -> tuple[Instance, int, int, np.ndarray | None]:
    """An instance, a window of it, and the state before the window."""
    instance = draw(instances(**options))
    steps, n, m = instance.benefits.shape
    start = draw(st.integers(0, steps - 1))
    stop = draw(st.integers(start + 1, steps))
    state = draw(st.none() | st.permutations(range(m)).map(lambda p: np.array(p[:n])))
    return instance, start, stop, state


@given(situations(forbid=True), st.data())
def test_handover_is_the_definition(situation: Any, data: st.DataObject) -> None:
    """The matrix, and its entries along an assignment, in every form of the benefits."""
    instance, k, _, state = situation
    _, n, m = instance.benefits.shape
    tasks = np.array(data.draw(st.permutations(range(m))))[:n]
    eta = definition(instance, k, state)
    for form in FORMS:
        problem = instance.problem(form)
        np.testing.assert_array_equal(problem.handover(k, state), eta)
        np.testing.assert_array_equal(problem.model.handover_at(k, state, tasks), eta[np.arange(n), tasks])
        np.testing.assert_array_equal(problem.beta_hat(k, state), instance.benefits[k] + eta)


@given(situations(forbid=True))
def test_interval_is_window_plus_handover(situation: Any) -> None:
    """The matrix of an interval is the sum of its benefits plus the handover at its first step, sparse or dense."""
    instance, start, stop, state = situation
    expected = instance.benefits[start:stop].sum(axis=0) + definition(instance, start, state)
    for form in FORMS:
        problem = instance.problem(form)
        windows = WindowSums(
            Benefits(as_form(instance.benefits, form))
        )  # in just this form, whatever suits it
        matrix = problem.model.interval(windows, start, stop, state)
        if form.startswith("sparse") and np.ndim(instance.cost) == 0:
            assert isinstance(matrix, GainMatrix), "a sparse problem with one cost must never become dense"
        values = matrix.toarray() if isinstance(matrix, GainMatrix) else matrix
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-12)


@given(situations(forbid=True))
def test_interval_looks_at_the_windows_only(situation: Any) -> None:
    """What counts as idle in an interval follows the benefits that are seen, not the true ones (forecasts)."""
    instance, start, stop, state = situation
    blind = dataclasses.replace(instance, benefits=np.zeros_like(instance.benefits))
    for form in ("dense", "sparse"):
        seen = instance.problem(form)
        matrices = [
            problem.model.interval(WindowSums(seen.benefits), start, stop, state)
            for problem in (seen, blind.problem(form))
        ]
        first, second = (m.toarray() if isinstance(m, GainMatrix) else m for m in matrices)
        np.testing.assert_array_equal(first, second)


def test_states_and_their_keys() -> None:
    """The state is the previous assignment; equal states have equal keys, others other keys."""
    problem = SAP(np.ones((2, 2, 3)), 0.5, [1, 2])
    state = problem.initial_state()
    np.testing.assert_array_equal(state, [1, 2])
    after = problem.transition(0, state, np.array([0, 2]))
    np.testing.assert_array_equal(after, [0, 2])
    key = problem.model.key
    assert key(state) == key(np.array([1, 2]))
    assert len({key(None), key(state), key(after), key(np.array([2, 1]))}) == 4
    assert SAP(np.ones((2, 2, 3)), 0.5).initial_state() is None


def test_strict_and_free_idling() -> None:
    """Strict: every change is charged. Free: only a change to a task that is worth something at that step."""
    values = np.array([[[0.0, 2.0, -1.0]]])
    for cost, to_worth, to_idle in ((0.5, -0.5, -0.5), ([[0, 1, 2], [3, 0, 4], [5, 6, 0]], -1.0, -2.0)):
        strict = SAP(values, SwitchingCost(cost), [0]).handover(0, np.array([0]))
        np.testing.assert_array_equal(strict, [[0.0, to_worth, to_idle]])
        free = SAP(values, SwitchingCost(cost, idle_is_free=True), [0]).handover(0, np.array([0]))
        np.testing.assert_array_equal(free, [[0.0, to_worth, 0.0]])


def test_a_matrix_reads_from_row_to_column() -> None:
    """Entry [a, b] is what the move from a to b costs."""
    cost = np.array([[0.0, 1.0], [10.0, 0.0]])
    problem = SAP(np.zeros((2, 1, 2)), SwitchingCost(cost))
    assert problem.evaluate([[0], [1]]).value == -1.0
    assert problem.evaluate([[1], [0]]).value == -10.0


def test_the_model_is_a_value() -> None:
    """It is frozen, belongs to no problem until it is bound, and one instance serves many problems."""
    model = SwitchingCost(0.5, idle_is_free=True)
    assert isinstance(model, Dynamics)
    with pytest.raises(dataclasses.FrozenInstanceError):
        model.cost = 1.0  # type: ignore[misc]
    with pytest.raises(ValueError, match="belongs to no problem"):
        model.handover(0, np.array([0]))
    small, large = SAP(np.ones((1, 1, 2)), model), SAP(-np.ones((1, 2, 4)), model)
    assert small.handover(0, np.array([0])).tolist() == [[0.0, -0.5]]
    assert large.handover(0, np.array([0, 1])).tolist() == [[0.0] * 4] * 2
    assert model.benefits is None
    bound = model.bind(Benefits(np.ones((1, 1, 2))))
    assert bound is not model
    assert (bound.cost, bound.idle_is_free) == (0.5, True)


def test_costs_are_normalised() -> None:
    """Numbers of any kind become floats, matrices float64 arrays; no entry is a negative zero."""
    for cost in (1, np.float32(1), np.int64(1), np.array(1.0)):
        assert type(SwitchingCost(cost).cost) is float
    assert SwitchingCost(1).is_uniform
    matrix = SwitchingCost([[0, 1], [2, 0]])
    assert not matrix.is_uniform
    assert np.asarray(matrix.cost).dtype == np.float64
    eta = SAP(np.zeros((1, 1, 2)), 0.0, [0]).handover(0, np.array([0]))
    assert not np.signbit(eta).any()


NAN, INF = float("nan"), float("inf")
BAD: dict[str, tuple[Any, str]] = {
    "negative": (-1.0, "not negative"),
    "NaN": (NAN, "finite"),
    "infinite": (INF, "finite"),
    "none": (None, "cost"),
    "text": ("0.5", "cost must be real numbers"),
    "complex": (1j, "cost must be real numbers"),
    "vector": ([1.0, 2.0], r"shape \(2,\)"),
    "not square": (np.zeros((2, 3)), r"shape \(2, 3\)"),
    "cube": (np.zeros((2, 2, 2)), r"shape \(2, 2, 2\)"),
    "ragged": ([[0.0, 1.0], [0.0]], "cost must be real numbers"),
    "diagonal": ([[1.0, 1.0], [1.0, 0.0]], "diagonal must be zero"),
    "NaN on the diagonal": ([[NAN, 1.0], [1.0, 0.0]], "diagonal|finite"),
    "negative entry": ([[0.0, -1.0], [1.0, 0.0]], "not negative"),
    "infinite entry": ([[0.0, INF], [1.0, 0.0]], "finite"),
    "huge": (2**2000, "cost must be real numbers"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_costs(name: str) -> None:
    """Each is a ValueError that names the cost."""
    cost, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        SwitchingCost(cost)
