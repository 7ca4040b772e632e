"""One problem has one plan and one stored form, whatever the form its benefits were given in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from every_solver import EVERY, by_name, problem_for
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from strategies import arrays, sizes

from sapopt import SAP, Benefits, solve
from sapopt.solvers.names import NamedSolver

FORMS: dict[str, Callable[[np.ndarray], Any]] = {
    "dense": np.array,
    "lists": lambda values: values.tolist(),
    "csr": lambda values: [sp.csr_array(step) for step in values],
    "coo": lambda values: [sp.coo_array(step) for step in values],
    "function": lambda values: Benefits.from_function(lambda k: values[k], values.shape),
    "function of csr": lambda values: Benefits.from_function(lambda k: sp.csr_array(values[k]), values.shape),
    "mixed function": lambda values: Benefits.from_function(
        lambda k: sp.csr_array(values[k]) if k % 2 else values[k], values.shape
    ),
    "benefits": Benefits,
    "part of a longer array": lambda values: Benefits(np.concatenate([values, 0 * np.isnan(values)])).slice(
        0, len(values)
    ),
    "part of a sparse list": lambda values: Benefits(
        [sp.csr_array(step) for step in np.concatenate([values, 1.0 + np.isnan(values)])]
    ).slice(0, len(values)),
}
tied = st.sampled_from([0.0, 0.0, 1.0, 2.0, -1.0])


@pytest.mark.parametrize("named", EVERY, ids=by_name)
@settings(max_examples=8)
@given(data=st.data())
def test_forms_play_one_plan(named: NamedSolver, data: st.DataObject) -> None:
    """Ties everywhere: each method plays the same plan for every form of one problem, at any share of zeros."""
    shape = data.draw(sizes(plans=3000, most=(3, 3, 4)))
    assume(named.name != "iterated" or shape[2] > 1)  # interference is between two tasks
    benefits = data.draw(arrays(shape, tied))
    cost = data.draw(st.sampled_from([0.0, 1.0]))
    initial = data.draw(st.none() | st.just(list(range(shape[1]))))
    plans = {}
    for form, make in FORMS.items():
        plans[form] = solve(problem_for(named, make(benefits), cost, initial), named.solver, seed=3).plan
    for form, plan in plans.items():
        np.testing.assert_array_equal(plan, plans["dense"], err_msg=form)


@settings(max_examples=25)
@given(data=st.data())
def test_forms_are_held_alike(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Forbidden pairs, negative and zero entries: one stored form, one fingerprint, and one file, bit for bit."""
    shape = data.draw(sizes(most=(3, 3, 5)))
    benefits = data.draw(arrays(shape, st.sampled_from([0.0, 0.0, 0.0, -0.0, 1.0, -2.0, -np.inf])))
    benefits[:, np.arange(shape[1]), np.arange(shape[1])] = 0.5
    problems = {form: SAP(make(benefits), 0.5) for form, make in FORMS.items()}
    folder = tmp_path_factory.mktemp("forms")
    files = {}
    for form, problem in problems.items():
        assert problem.benefits.is_sparse == (np.count_nonzero(benefits) <= benefits.size / 2), form
        assert sp.issparse(problem.benefits.step(0)) == problem.benefits.is_sparse, form
        np.testing.assert_array_equal(problem.benefits.dense(), benefits)
        problem.save(folder / "p.npz")
        files[form] = (folder / "p.npz").read_bytes()
    assert len({problem.fingerprint for problem in problems.values()}) == 1
    assert len(set(files.values())) == 1


def test_half_of_the_pairs_decides() -> None:
    """Sparse up to half of the pairs, over all steps together; a step of the other kind changes nothing."""
    half = np.zeros((2, 2, 4))
    half[0] = 1.0
    for make in FORMS.values():
        problem = SAP(make(half))
        assert all(sp.issparse(problem.benefits.step(k)) for k in range(2))
    half[1, 0, 0] = 1.0
    for make in FORMS.values():
        problem = SAP(make(half))
        assert not any(sp.issparse(problem.benefits.step(k)) for k in range(2))


def test_a_function_is_called_once_for_every_step_of_a_short_horizon() -> None:
    """Settling on a form looks at every step; steps that stay in memory are not computed again."""
    values = np.random.default_rng(0).random((20, 3, 4)) * np.eye(3, 4)
    asked: list[int] = []

    def step(k: int) -> np.ndarray:
        asked.append(k)
        return values[k]

    problem = SAP(Benefits.from_function(step, values.shape), 0.5)
    solve(problem, EVERY[2].solver)
    SAP(problem.benefits.slice(3, 9), 0.5)
    assert asked == list(range(20))


def test_a_large_array_is_not_copied(tmp_path: Path) -> None:
    """What stays dense is used in place, what becomes sparse costs the memory of its entries."""
    dense = np.ones((3, 40, 50))
    assert np.shares_memory(SAP(dense).benefits.dense(), dense)
    dense[:, :, 3:] = 0
    flat = SAP(dense).benefits.flat()
    assert (len(flat.data), flat.indices.dtype) == (360, np.int32)
