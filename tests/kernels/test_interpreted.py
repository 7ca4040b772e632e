"""Small problems run the kernels' plain source: the same plans, to the last bit, as the compiled ones."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, SwitchingCost, solve
from sapopt.data.assignment import assign
from sapopt.domains.instances import instance
from sapopt.kernels import jit
from sapopt.solvers import HAA, HAAL, MyopicGreedy, NoHandover


@contextmanager
def interpreted() -> Iterator[None]:
    """Within the block small kernels are interpreted, whatever is compiled already and however long it takes."""
    compiled = {kernel: kernel._run for kernel in jit.KERNELS}
    patience, jit.PATIENCE = jit.PATIENCE, np.inf
    for kernel in jit.KERNELS:
        kernel._run = None
    try:
        yield
    finally:
        jit.PATIENCE = patience
        for kernel, run in compiled.items():
            kernel._run = run


@st.composite
def problems(draw: st.DrawFn) -> SAP:
    """Small sparse problems, half of them full of ties."""
    n = draw(st.integers(1, 6))
    m = n + draw(st.integers(0, 4))
    steps = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = rng.integers(0, 3, (steps, n, m)) if draw(st.booleans()) else rng.random((steps, n, m))
    values = values * (rng.random((steps, n, m)) < draw(st.sampled_from([0.2, 0.5, 0.9])))
    cost = draw(st.sampled_from([0.0, 0.5, 1.0, 2.0]))
    held = rng.permutation(m)[:n] if draw(st.booleans()) else None
    benefits: Any = [sp.csr_array(step.astype(np.float64)) for step in values]
    return SAP(benefits, SwitchingCost(cost, idle_is_free=draw(st.booleans())), held)


SOLVERS = [
    HAA(), HAA(parking="lookahead"), HAAL(1), HAAL(2), HAAL(4), HAAL(3, parking="lookahead"), HAAL(3, keep_plan=True),
    MyopicGreedy(), NoHandover(),
]  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(problems(), st.sampled_from(SOLVERS))
def test_same_plans(problem: SAP, solver: Any) -> None:
    """Plan, value and work are the same, with ties and without, whatever the solver."""
    with jit.compiled_always():
        compiled = solve(problem, solver)
    with interpreted():
        plain = solve(problem, solver)
    assert np.array_equal(plain.plan, compiled.plan)
    assert plain.value == compiled.value
    assert [row.get("assignment_problems") for row in plain.trace] == [
        row.get("assignment_problems") for row in compiled.trace
    ]


@settings(max_examples=60, deadline=None)
@given(problems(), st.sampled_from(["kernel", "scipy-sparse", "scipy-dense"]), st.integers(0, 2**32 - 1))
def test_same_assignments(problem: SAP, backend: Any, seed: int) -> None:
    """One assignment problem has one answer, whatever the backend and whether it is compiled."""
    matrix = problem.benefits.dense()[0]
    order = np.random.default_rng(seed).permutation(problem.m)
    with jit.compiled_always():
        compiled = assign(matrix, backend=backend, parking=order)
    with interpreted():
        plain = assign(matrix, backend=backend, parking=order)
    assert np.array_equal(plain, compiled)


def test_same_instance() -> None:
    """The toy constellation is the same problem, fingerprint and all, by compiled and by interpreted visibility."""
    with jit.compiled_always():
        compiled = instance("constellation-toy")
    with interpreted():
        plain = instance("constellation-toy")
    assert plain.fingerprint == compiled.fingerprint


@pytest.mark.parametrize("solver", ["HAA()", "HAAL(3)", "MyopicGreedy()", "NoHandover()"])
def test_the_first_call_compiles_nothing(solver: str) -> None:
    """A small problem is solved without numba being loaded at all."""
    code = (
        "import sys\n"
        "from sapopt import solve\n"
        "from sapopt.solvers import HAA, HAAL, MyopicGreedy, NoHandover\n"
        "from sapopt.domains.instances import instance\n"
        f"solve(instance('constellation-toy'), {solver})\n"
        "assert 'numba' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
