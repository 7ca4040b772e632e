"""The torch recursions against the compiled kernels, on the processor."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, SwitchingCost, bound, solve
from sapopt.dynamics.switching.paths import StrictSwitching
from sapopt.dynamics.switching.torch_paths import TorchSwitching, path_oracle
from sapopt.formulations.dual import ascend, dual_value
from sapopt.solvers import DualDecomposition

torch = pytest.importorskip("torch")


@st.composite
def cases(draw: st.DrawFn) -> tuple[Any, float, Any, np.ndarray]:
    """Benefits, cost, state and prices: dense or sparse, with forbidden pairs, negative entries and free tasks."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    T, n = draw(st.integers(1, 6)), draw(st.integers(1, 5))
    m = n + draw(st.integers(0, 12))
    benefits = rng.random((T, n, m)) * (rng.random((T, n, m)) < draw(st.sampled_from([0.1, 0.3, 1.0])))
    if draw(st.booleans()):
        benefits[rng.random((T, n, m)) < 0.1] *= -1.0
    if draw(st.booleans()) and n < m:
        benefits[rng.random((T, n, m)) < 0.1] = -np.inf
        benefits[:, :, 0] = np.maximum(benefits[:, :, 0], 0.0)  # some task stays open
    state = rng.permutation(m)[:n] if draw(st.booleans()) else None
    prices = rng.random((T, m)) * (rng.random((T, m)) < 0.6)
    return benefits, draw(st.sampled_from([0.0, 0.2, 1.0])), state, prices


def value_of(
    benefits: np.ndarray, cost: float, state: Any, prices: np.ndarray, path: np.ndarray, i: int
) -> float:
    """Priced value of a path, from the definition."""
    total, held = 0.0, -1 if state is None else state[i]
    for k, j in enumerate(path):
        total += benefits[k, i, j] - prices[k, j] - (cost if held >= 0 and held != j else 0.0)
        held = j
    return total


@given(case=cases())
def test_hard_paths(case: Any) -> None:
    """Values and plans are those of the kernels, and the plans attain the values."""
    benefits, cost, state, prices = case
    values, plan = StrictSwitching(benefits, cost, state).best_paths(prices)
    ours, our_plan = TorchSwitching(benefits, cost, state, "torch-cpu").best_paths(prices)
    np.testing.assert_allclose(ours, values, rtol=0, atol=1e-9)
    for i in range(len(values)):
        if np.isfinite(values[i]):
            assert value_of(benefits, cost, state, prices, our_plan[:, i], i) == pytest.approx(
                values[i], abs=1e-9
            )
    assert our_plan.shape == plan.shape


@given(case=cases(), temperature=st.sampled_from([0.02, 0.1, 1.0]))
@settings(max_examples=40)
def test_soft_paths(case: Any, temperature: float) -> None:
    """Soft values and usage are those of the kernels; every agent is somewhere at every step."""
    benefits, cost, state, prices = case
    kernels = StrictSwitching(benefits, cost, state)
    temperature = max(temperature, 1.05 * kernels.coldest)
    values, usage = kernels.soft_paths(prices, temperature)
    if not np.isfinite(values).all():
        return
    ours, our_usage = TorchSwitching(benefits, cost, state, "torch-cpu").soft_paths(prices, temperature)
    np.testing.assert_allclose(ours, values, rtol=0, atol=1e-6)
    np.testing.assert_allclose(our_usage, usage, rtol=0, atol=1e-5)
    np.testing.assert_allclose(our_usage.sum(axis=1), benefits.shape[1], atol=1e-9)


@pytest.fixture(scope="module")
def sparse() -> SAP:
    """A problem with few visible tasks, so that agents park."""
    rng = np.random.default_rng(5)
    return SAP([sp.random_array((20, 60), density=0.05, rng=rng, format="csr") for _ in range(15)], 0.3)


def test_sparse_problem(sparse: SAP) -> None:
    """With parking, also the plans are the same: free parking is spread in the same way."""
    kernels = sparse.model.path_oracle(sparse.benefits, None)
    ours = path_oracle(sparse.model, sparse.benefits, None, "torch-cpu")
    assert kernels.park
    assert (ours.shape, ours.scale, ours.coldest) == (kernels.shape, kernels.scale, kernels.coldest)
    prices = ascend(kernels, max_iterations=30).prices
    for p in (prices, np.zeros_like(prices)):
        np.testing.assert_array_equal(dual_value(ours, p).plan, dual_value(kernels, p).plan)
        assert dual_value(ours, p).value == pytest.approx(dual_value(kernels, p).value, rel=1e-12)
    for p, q in zip(ours.soft_paths(prices, 0.02), kernels.soft_paths(prices, 0.02), strict=True):
        np.testing.assert_allclose(p, q, rtol=0, atol=1e-5)
    assert ours.best_path(3, prices)[0] == pytest.approx(float(kernels.best_paths(prices)[0][3]))


def test_bound_and_solver(sparse: SAP) -> None:
    """The whole ascent comes out the same on both, and the solver takes a device."""
    both = [bound(sparse, device=device).value for device in ("cpu", "torch-cpu")]
    assert both[1] == pytest.approx(both[0], rel=1e-3)
    short = DualDecomposition(iterations=40, rounds=1, sweeps=3, repricing=0, device="torch-cpu")
    result = solve(sparse, short, seed=1)
    assert result.value <= result.bound + 1e-9
    assert result.gap < 0.05


def test_unavailable(sparse: SAP, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that is not here, a rule without a recursion, and torch missing: each is said in one clear error."""
    if not torch.cuda.is_available():
        with pytest.raises(ValueError, match="device 'cuda' is not available here"):
            bound(sparse, device="cuda")
    with pytest.raises(ValueError, match="device 'gpu'"):
        bound(sparse, device="gpu")
    with pytest.raises(ValueError, match="device"):
        DualDecomposition(device=3)  # type: ignore[arg-type]
    free = SAP(sparse.benefits, SwitchingCost(0.3, idle_is_free=True))
    with pytest.raises(ValueError, match="leave device at 'cpu'"):
        bound(free, device="torch-cpu")
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ImportError, match=r"sapopt\[learn\]"):
        bound(sparse, device="cuda")
    assert bound(sparse, device="cpu", callback=lambda _: True).value > 0
