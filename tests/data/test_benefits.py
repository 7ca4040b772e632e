"""Benefits: every form of the same numbers reads alike, and bad values are refused with their place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from strategies import FORMS, arrays, as_form, instances, quarters, sizes, sparse_quarters

from sapopt import SAP, Benefits

CUBE = np.array([[[0.0, 2.0, -1.5], [3.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.25, 0.0, 4.0]]])


def unsorted_with_duplicates(step: np.ndarray) -> sp.csr_array:
    """A CSR whose rows are in descending order, every entry split in two, with explicit zeros in between."""
    rows, columns = np.nonzero(step)
    order = np.lexsort((-columns, rows))
    rows, columns = rows[order], columns[order]
    indices = np.repeat(columns, 3)
    data = np.stack([step[rows, columns] / 2, np.zeros(len(rows)), step[rows, columns] / 2], axis=1).ravel()
    indptr = np.concatenate([[0], np.cumsum(3 * np.bincount(rows, minlength=len(step)))])
    return sp.csr_array((data, indices, indptr), shape=step.shape)


def full_of_zeros(step: np.ndarray) -> sp.csr_array:
    """A sorted CSR that stores every pair, zeros included, one of them as 1 - 1."""
    n, m = step.shape
    rows = [np.concatenate([row, [1.0, -1.0]]) for row in step]
    columns = [np.concatenate([np.arange(m), [0, 0]]) for _ in step]
    indptr = np.arange(n + 1) * (m + 2)
    return sp.csr_array((np.concatenate(rows), np.concatenate(columns), indptr), shape=step.shape)


def in_memory_map(values: np.ndarray, folder: Path) -> np.ndarray:
    """The values as a read-only map of a file."""
    np.save(folder / "values.npy", values)
    return np.load(folder / "values.npy", mmap_mode="r")


DENSE: dict[str, Any] = {
    "nested lists": lambda c: c.tolist(),
    "tuple of arrays": tuple,
    "fortran order": np.asfortranarray,
    "strided view": lambda c: np.repeat(c, 2, axis=2)[:, :, ::2],
    "float32": lambda c: c.astype(np.float32),
    "longdouble": lambda c: c.astype(np.longdouble),
    "objects": lambda c: c.astype(object),
    "big endian": lambda c: c.astype(">f8"),
    "benefits": Benefits,
}
SPARSE: dict[str, Any] = {
    name: (lambda c, make=make: [make(step) for step in c])
    for name, make in {
        "csr_array": sp.csr_array, "csr_matrix": sp.csr_matrix, "csc_array": sp.csc_array,
        "coo_array": sp.coo_array, "coo_matrix": sp.coo_matrix, "lil_array": sp.lil_array, "dok_array": sp.dok_array,
        "bsr_array": sp.bsr_array, "dia_array": sp.dia_array, "unsorted with duplicates": unsorted_with_duplicates,
        "full of zeros": full_of_zeros,
        "stored zeros": lambda step: sp.csr_array((step.ravel(), [0, 1, 2] * 2, [0, 3, 6]), shape=step.shape),
        "float32 csr": lambda step: sp.csr_array(step, dtype=np.float32),
    }.items()
}  # fmt: skip
SPARSE["dense first, then sparse"] = lambda c: [c[0], *map(sp.csr_array, c[1:])]
SPARSE["sparse first, then lists"] = lambda c: [sp.csr_array(c[0]), *(step.tolist() for step in c[1:])]
SPARSE["tuple of csr"] = lambda c: tuple(map(sp.csr_array, c))


@pytest.mark.parametrize("form", DENSE)
def test_dense_forms(form: str) -> None:
    """Whatever numpy can read as a (T, n, m) array of numbers is the same dense benefits in float64."""
    benefits = Benefits(DENSE[form](CUBE))
    assert not benefits.is_sparse
    assert benefits.dense().dtype == np.float64
    np.testing.assert_array_equal(benefits.dense(), CUBE)


@pytest.mark.parametrize("form", SPARSE)
def test_sparse_forms(form: str) -> None:
    """Every sparse format, canonical or not, is the same sorted flat CSR without zeros."""
    values = SPARSE[form](CUBE)
    benefits = Benefits(values)
    flat = benefits.flat()
    assert benefits.is_sparse
    np.testing.assert_array_equal(benefits.dense(), CUBE)
    np.testing.assert_array_equal(flat.indptr, [0, 2, 3, 3, 5])
    np.testing.assert_array_equal(flat.indices, [1, 2, 0, 0, 2])
    np.testing.assert_array_equal(flat.data, [2.0, -1.5, 3.0, 0.25, 4.0])
    assert (flat.indptr.dtype, flat.indices.dtype, flat.data.dtype) == (np.int64, np.int32, np.float64)


def test_whole_numbers_and_truth_values() -> None:
    """Integer and boolean benefits are numbers."""
    counts = np.arange(12).reshape(2, 2, 3)
    np.testing.assert_array_equal(Benefits(counts).dense(), counts)
    np.testing.assert_array_equal(Benefits([sp.csr_array(c) for c in counts]).dense(), counts)
    np.testing.assert_array_equal(Benefits(counts > 5).dense(), counts > 5)
    np.testing.assert_array_equal(Benefits([sp.csr_array(c > 5) for c in counts]).dense(), counts > 5)


def test_memory_map(tmp_path: Path) -> None:
    """A memory-mapped array is used in place, read-only."""
    mapped = in_memory_map(CUBE, tmp_path)
    benefits = Benefits(mapped)
    np.testing.assert_array_equal(benefits.dense(), CUBE)
    assert np.shares_memory(benefits.step(1), mapped)


def test_input_is_left_alone() -> None:
    """Sparse input that has to be brought to order is copied first."""
    messy = [unsorted_with_duplicates(step) for step in CUBE]
    before = [(m.indptr.copy(), m.indices.copy(), m.data.copy()) for m in messy]
    SAP(Benefits(messy), 0.5).evaluate([[1, 0], [0, 2]])
    for matrix, (indptr, indices, data) in zip(messy, before, strict=True):
        np.testing.assert_array_equal(matrix.indptr, indptr)
        np.testing.assert_array_equal(matrix.indices, indices)
        np.testing.assert_array_equal(matrix.data, data)


@given(st.data())
def test_forms_read_alike(data: st.DataObject) -> None:
    """Dense, sparse and function-backed benefits give the same numbers through every reading method."""
    shape = steps, n, m = data.draw(sizes())
    values = data.draw(arrays(shape, data.draw(st.sampled_from([quarters, sparse_quarters]))))
    start = data.draw(st.integers(0, steps - 1))
    stop = data.draw(st.integers(start + 1, steps))
    plan = np.array([data.draw(st.permutations(range(m)))[:n] for _ in range(steps)])
    held = np.array([[values[k, i, plan[k, i]] for i in range(n)] for k in range(steps)])
    for form in FORMS:
        benefits = Benefits(as_form(values, form))
        assert benefits.shape == shape
        assert benefits.is_sparse == (form in ("sparse", "sparse function"))
        np.testing.assert_array_equal(benefits.dense(), values)
        np.testing.assert_array_equal(benefits.at(plan), held)
        np.testing.assert_array_equal(benefits.slice(start, stop).dense(), values[start:stop])
        np.testing.assert_array_equal(benefits.slice(start, stop).at(plan[start:stop]), held[start:stop])
        window = benefits.window(start, stop)
        np.testing.assert_array_equal(
            window.toarray() if sp.issparse(window) else window, values[start:stop].sum(axis=0)
        )
        np.testing.assert_array_equal(benefits.task_totals(), np.maximum(values, 0).sum(axis=(0, 1)))
        wide = benefits.with_idle_tasks()
        assert wide.shape == (steps, n, m + n)
        np.testing.assert_array_equal(wide.dense(), np.concatenate([values, np.zeros((steps, n, n))], axis=2))
        flat = benefits.flat()
        again = Benefits.from_flat(flat.indptr, flat.indices, flat.data, shape)
        np.testing.assert_array_equal(again.dense(), values)
        assert (flat.data != 0).all()


@given(instances(forbid=True))
def test_forbidden_pairs_survive_every_form(instance: Any) -> None:
    """-inf is kept as it is, and `forbids` sees it."""
    for form in FORMS:
        benefits = Benefits(as_form(instance.benefits, form))
        assert benefits.forbids() == bool(np.isneginf(instance.benefits).any())
        np.testing.assert_array_equal(benefits.dense(), instance.benefits)
        assert np.isfinite(benefits.task_totals()).all()


def test_slices_of_slices() -> None:
    """A slice of a slice counts from its own first step, in every form."""
    values = np.arange(24.0).reshape(6, 2, 2)
    for form in FORMS:
        inner = Benefits(as_form(values, form)).slice(1, 6).slice(2, 4)
        np.testing.assert_array_equal(inner.dense(), values[3:5])
        np.testing.assert_array_equal(inner.window(0, 2) + np.zeros((2, 2)), values[3] + values[4])


def test_slice_is_no_copy() -> None:
    """Slices share the memory of the whole."""
    dense = Benefits(CUBE)
    assert np.shares_memory(dense.slice(1, 2).dense(), dense.dense())
    sparse = Benefits(as_form(CUBE, "sparse"))
    assert np.shares_memory(sparse.slice(1, 2).flat().data, sparse.flat().data)


def test_function_is_asked_when_needed_and_not_twice() -> None:
    """Steps of a function are computed on demand and kept."""
    asked: list[int] = []

    def step(k: int) -> np.ndarray:
        asked.append(k)
        return CUBE[k]

    benefits = Benefits.from_function(step, CUBE.shape)
    assert asked == []
    benefits.step(1)
    benefits.step(1)
    assert asked == [1]


def test_function_of_a_long_horizon_forgets() -> None:
    """Only some steps of a function stay in memory, and what was forgotten is computed again, equal."""
    benefits = Benefits.from_function(lambda k: np.full((1, 1), float(k)), (500, 1, 1))
    assert [benefits.step(k)[0, 0] for k in range(500)] == list(range(500))
    assert len(benefits._kept) < 100
    assert benefits.step(3)[0, 0] == 3


def test_idle_tasks_by_count() -> None:
    """`count` idle tasks are appended, in every form; a negative count is refused."""
    for form in FORMS:
        benefits = Benefits(as_form(CUBE, form))
        assert benefits.with_idle_tasks(0).shape == (2, 2, 3)
        np.testing.assert_array_equal(benefits.with_idle_tasks(5).dense()[:, :, 3:], 0.0)
        with pytest.raises(ValueError, match="count must not be negative"):
            benefits.with_idle_tasks(-1)


NAN, INF = float("nan"), float("inf")
BAD: dict[str, tuple[Any, str]] = {
    "NaN": ([[[0.0, NAN]]], r"NaN \(first at index \(0, 0, 1\)\)"),
    "+inf": ([[[0.0, INF]]], r"\+inf"),
    "+inf beside -inf": ([[[-INF, INF]]], r"\+inf"),
    "overflow": (np.full((2, 2, 2), 1e308), "overflow"),
    "overflow beside -inf": ([[[1e308, 1e308, -INF]]], "overflow"),
    "ragged": ([[[1.0, 2.0], [3.0]]], "same n and m at every step"),
    "ragged steps": ([[[1.0]], [[1.0], [2.0]]], "same n and m at every step"),
    "empty list": ([], "three axes"),
    "no steps": (np.zeros((0, 2, 3)), "three positive"),
    "no agents": (np.zeros((2, 0, 3)), "three positive"),
    "no tasks": (np.zeros((2, 3, 0)), "three positive"),
    "one step": (np.zeros((2, 3)), r"values\[None\]"),
    "four axes": (np.zeros((1, 1, 1, 1)), "three axes"),
    "number": (3.0, "three axes"),
    "none": (None, "three axes"),
    "text": ("abc", "real numbers"),
    "words": ([[["a", "b"]]], "real numbers"),
    "numerals": ([[["1", "2"]]], "real numbers"),
    "dates": (np.zeros((1, 1, 1), "M8[D]"), "real numbers"),
    "complex": (np.ones((1, 1, 1), complex), "real numbers"),
    "complex objects": (np.full((1, 1, 1), 1j, object), "real numbers"),
    "huge integer": ([[[2**2000]]], "real numbers"),
    "missing value": ([[[None, 1.0]]], "NaN"),
    "masked": (np.ma.masked_greater(CUBE, 1.0), "masked"),
    "generator": ((step for step in CUBE), "real numbers"),
    "one sparse matrix": (sp.csr_array(CUBE[0]), "a list with a matrix for every step"),
    "sparse shapes": ([sp.csr_array(np.ones((2, 3))), sp.csr_array(np.ones((2, 4)))], r"step 1 have shape \(2, 4\)"),
    "sparse NaN": ([sp.csr_array([[1.0]]), sp.csr_array([[NAN]])], "step 1 contain NaN"),
    "sparse +inf": ([sp.csr_array([[1.0]]), sp.csr_array([[INF]])], r"step 1 contain \+inf"),
    "sparse inf - inf": ([sp.coo_array(([INF, -INF], ([0, 0], [0, 0])), shape=(1, 2))], "NaN"),
    "sparse complex": ([sp.csr_array([[1j]])], "real numbers"),
    "sparse overflow": ([sp.csr_array([[1e308, 1e308]])], "overflow"),
    "sparse with a word": ([sp.csr_array([[1.0]]), "abc"], "step 1 must be real numbers"),
    "sparse with a row": ([sp.csr_array([[1.0]]), [1.0]], r"step 1 have shape \(1,\)"),
    "sparse with none": ([sp.csr_array([[1.0]]), None], "step 1"),
    "sparse with ragged": ([sp.csr_array([[1.0]]), [[1.0], [1.0, 2.0]]], "step 1 must be real numbers"),
    "sparse with a cube": ([np.zeros((1, 1, 1)), sp.csr_array([[1.0]])], r"all must be \(n, m\)"),
    "empty sparse": ([sp.csr_array((0, 3))], "three positive"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_values(name: str) -> None:
    """Every kind of bad input is a ValueError with a hint, also through SAP."""
    values, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        SAP(values)


BAD_STEPS: dict[str, tuple[Any, str]] = {
    "shape": (np.ones((2, 2)), r"step 3 have shape \(2, 2\), expected \(1, 2\)"),
    "sparse shape": (sp.csr_array((1, 3)), r"step 3 have shape \(1, 3\), expected \(1, 2\)"),
    "NaN": ([[NAN, 0.0]], "step 3 contain NaN"),
    "sparse NaN": (sp.csr_array([[NAN, 0.0]]), "step 3 contain NaN"),
    "none": (None, "step 3"),
    "complex": (np.ones((1, 2), complex), "step 3 must be real numbers"),
    "sparse complex": (sp.csr_array([[1j, 0.0]]), "step 3 must be real numbers"),
}


@pytest.mark.parametrize("name", BAD_STEPS)
def test_bad_steps_of_a_function(name: str) -> None:
    """A function's bad step is named by its number in the problem, also when read through a slice."""
    bad, message = BAD_STEPS[name]
    benefits = Benefits.from_function(lambda k: bad if k == 3 else np.ones((1, 2)), (5, 1, 2))
    with pytest.raises(ValueError, match=message):
        benefits.dense()
    with pytest.raises(ValueError, match=message):
        benefits.slice(2, 5).dense()


FLAT: dict[str, Any] = {
    "indptr": [0, 2, 3],
    "indices": [0, 2, 1],
    "data": [1.0, 2.0, 3.0],
    "shape": (1, 2, 3),
}
BAD_FLAT: dict[str, tuple[str, Any]] = {
    "too few rows": ("indptr", [0, 2]),
    "falling offsets": ("indptr", [0, 3, 2]),
    "offsets past the end": ("indptr", [0, 2, 9]),
    "first offset": ("indptr", [1, 2, 3]),
    "no offsets": ("indptr", None),
    "task too high": ("indices", [0, 3, 1]),
    "negative task": ("indices", [0, -1, 1]),
    "broken task": ("indices", [0, 1.5, 1]),
    "too few tasks": ("indices", [0, 1]),
    "words": ("data", ["a", "b", "c"]),
    "NaN": ("data", [1.0, NAN, 2.0]),
    "+inf": ("data", [1.0, INF, 2.0]),
    "too few values": ("data", [1.0]),
    "two numbers": ("shape", (2, 3)),
    "zero": ("shape", (1, 2, 0)),
    "negative": ("shape", (-1, 2, 3)),
    "broken": ("shape", (1.5, 2, 3)),
    "none": ("shape", None),
    "text": ("shape", "abc"),
}


@pytest.mark.parametrize("name", BAD_FLAT)
def test_bad_flat_arrays(name: str) -> None:
    """Arrays that are no CSR of the given shape are refused before any kernel reads past them."""
    np.testing.assert_array_equal(Benefits.from_flat(**FLAT).dense(), [[[1.0, 0.0, 2.0], [0.0, 3.0, 0.0]]])
    part, value = BAD_FLAT[name]
    with pytest.raises(ValueError):
        Benefits.from_flat(**(FLAT | {part: value}))


@pytest.mark.parametrize("form", FORMS)
def test_steps_out_of_range(form: str) -> None:
    """Steps and slices outside the horizon are refused, negative ones as well."""
    benefits = Benefits(as_form(CUBE, form))
    for k in (-1, 2):
        with pytest.raises(ValueError, match=r"outside 0\.\.1"):
            benefits.step(k)
    for start, stop in ((0, 3), (-1, 1), (1, 1), (2, 2), (1, 0)):
        with pytest.raises(ValueError, match=r"not within 0\.\.1"):
            benefits.slice(start, stop)


def test_repr_names_the_form() -> None:
    """The form is part of the text."""
    assert [repr(Benefits(as_form(CUBE, form))) for form in ("dense", "sparse", "function")] == [
        f"Benefits(T=2, n=2, m=3, {form})" for form in ("dense", "sparse", "function")
    ]
