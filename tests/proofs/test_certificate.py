"""Certificates: what they prove is true, and nothing else gets through."""

import dataclasses
import functools
import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, CertificateError, SwitchingCost, bound, certify, solve, verify
from sapopt.proofs.certificate import Certificate, prove
from sapopt.proofs.plain import plain_bound, plain_value
from sapopt.solvers import HAAL


def brute_force(problem: SAP) -> float:
    """Optimal value by trying every plan."""
    steps = list(itertools.permutations(range(problem.m), problem.n))
    return max(problem.evaluate(np.array(plan)).value for plan in itertools.product(steps, repeat=problem.T))


@st.composite
def tiny_problems(draw: st.DrawFn) -> SAP:
    """Problems with at most 2 agents, 3 tasks, 3 steps, in all forms of the switching cost."""
    n = draw(st.integers(1, 2))
    m = draw(st.integers(n, 3))
    steps = draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    benefits = rng.integers(-1, 6, (steps, n, m)) * rng.integers(0, 2, (steps, n, m)) * 0.5
    cost: float | np.ndarray = draw(st.sampled_from([0.0, 0.3, 2.0]))
    if draw(st.booleans()):
        cost = rng.random((m, m)) * 2
        np.fill_diagonal(cost, 0)
    initial = rng.permutation(m)[:n] if draw(st.booleans()) else None
    return SAP(benefits, SwitchingCost(cost, idle_is_free=draw(st.booleans())), initial)


@settings(max_examples=60, deadline=None)
@given(tiny_problems(), st.integers(0, 10**6))
def test_any_prices_bound_the_optimum(problem: SAP, seed: int) -> None:
    """For random prices the plain bound is at least the optimum by brute force."""
    prices = np.random.default_rng(seed).exponential(0.5, (problem.T, problem.m))
    assert plain_bound(problem, prices) >= brute_force(problem) - 1e-12


@settings(max_examples=60, deadline=None)
@given(tiny_problems(), st.integers(0, 10**6))
def test_plain_paths_are_best_paths(problem: SAP, seed: int) -> None:
    """The bound is the sum of each agent's best priced sequence of tasks, found here by trying all of them."""
    prices = np.random.default_rng(seed).exponential(0.5, (problem.T, problem.m))
    total = prices.sum()
    for i in range(problem.n):
        initial = None if problem.initial_assignment is None else problem.initial_assignment[i : i + 1]
        alone = SAP(problem.benefits.dense()[:, i : i + 1] - prices[:, None], 0.0)
        paid = SAP(problem.benefits.dense()[:, i : i + 1], problem.dynamics, initial)
        total += max(
            paid.evaluate(np.array(path)[:, None]).value
            + alone.evaluate(np.array(path)[:, None]).value
            - paid.benefits.at(np.array(path)[:, None]).sum()
            for path in itertools.product(range(problem.m), repeat=problem.T)
        )
    assert plain_bound(problem, prices) == pytest.approx(total, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(tiny_problems(), st.integers(0, 10**6))
def test_plain_value_is_the_value(problem: SAP, seed: int) -> None:
    """The verifier's value is that of `evaluate`, which shares no code with it."""
    rng = np.random.default_rng(seed)
    plan = np.array([rng.permutation(problem.m)[: problem.n] for _ in range(problem.T)])
    assert plain_value(problem, plan) == pytest.approx(problem.evaluate(plan).value, abs=1e-12)


@functools.cache
def certified() -> tuple[SAP, Certificate]:
    """A problem and a certificate of a plan of it."""
    problem = SAP(np.random.default_rng(4).random((6, 4, 5)), SwitchingCost(0.3))
    return problem, certify(problem, solve(problem, HAAL(2)))


@pytest.fixture
def proven(tmp_path: Path) -> tuple[SAP, Certificate, Path]:
    """The same, and the file the certificate is in."""
    problem, certificate = certified()
    certificate.save(tmp_path / "c.npz")
    return problem, certificate, tmp_path / "c.npz"


def test_round_trip(proven: tuple[SAP, Certificate, Path]) -> None:
    """A saved certificate verifies with the same numbers."""
    problem, certificate, path = proven
    again = verify(path, problem)
    for item in dataclasses.fields(Certificate):
        np.testing.assert_array_equal(getattr(again, item.name), getattr(certificate, item.name))
    assert certificate.value <= certificate.bound
    assert certificate.bound <= bound(problem).value + 1e-6


def test_dense_and_sparse_forms_share_certificates(proven: tuple[SAP, Certificate, Path]) -> None:
    """The same problem given as sparse matrices accepts the certificate."""
    import scipy.sparse as sp

    problem, certificate, path = proven
    sparse = SAP([sp.csr_array(step) for step in problem.benefits.dense()], problem.dynamics)
    assert verify(path, sparse).bound == certificate.bound


@pytest.mark.parametrize("offset", [0, 200, 900, -300, -40])
def test_damaged_files_are_refused(proven: tuple[SAP, Certificate, Path], offset: int) -> None:
    """A flipped byte anywhere in the file is noticed, or harmless."""
    problem, certificate, path = proven
    data = bytearray(path.read_bytes())
    data[offset] ^= 0x10
    path.write_bytes(bytes(data))
    try:
        again = verify(path, problem)
    except CertificateError:
        return
    assert (again.value, again.bound) == (certificate.value, certificate.bound)


@pytest.mark.parametrize("keep", [0, 10, 500, -1])
def test_truncated_files_are_refused(proven: tuple[SAP, Certificate, Path], keep: int) -> None:
    """A file that is cut short is refused."""
    problem, _, path = proven
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(CertificateError):
        verify(path, problem)


def test_changed_arrays_are_refused(proven: tuple[SAP, Certificate, Path]) -> None:
    """A file whose prices or plan were replaced under the old digest is refused."""
    problem, _, path = proven
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    for name, change in (("prices", 1e-3), ("plan", 1)):
        forged = dict(arrays)
        forged[name] = forged[name].copy()
        forged[name].flat[3] += change
        np.savez(path, **forged)
        with pytest.raises(CertificateError, match="changed"):
            verify(path, problem)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 29), st.sampled_from([-1e-3, 1e-3]))
def test_changed_price_never_proves_too_much(entry: int, change: float) -> None:
    """With a forged digest, a changed price is refused or leads to a bound that is proven anew."""
    problem = SAP(np.random.default_rng(5).random((6, 3, 5)), SwitchingCost(0.3))
    good = prove(problem, solve(problem, HAAL(2)).plan, np.random.default_rng(6).exponential(0.2, (6, 5)))
    prices = good.prices.copy()
    prices.flat[entry] = max(0.0, prices.flat[entry] + change)
    forged = dataclasses.replace(good, prices=prices)
    if plain_bound(problem, prices) > good.bound + 1e-6:
        with pytest.raises(CertificateError, match="prove a bound"):
            verify(forged, problem)
    else:
        assert verify(forged, problem).bound == plain_bound(problem, prices)


def test_claims_beyond_the_proof_are_refused(proven: tuple[SAP, Certificate, Path]) -> None:
    """A higher value, a lower bound, NaN, negative or infinite prices, an infeasible plan: refused."""
    problem, good, _ = proven
    change = dataclasses.replace
    twice = good.plan.copy()
    twice[2, 0] = twice[2, 1]
    for forged in (
        change(good, value=good.value + 1e-3),
        change(good, bound=good.bound - 1e-3),
        change(good, value=float("nan")),
        change(good, bound=float("nan")),
        change(good, prices=good.prices - 1.0),
        change(good, prices=np.where(good.prices > 0, np.inf, 0.0)),
        change(good, prices=good.prices[:-1]),
        change(good, guarantee=change(good.guarantee, ratio=0.999)),
        change(good, plan=twice),
        change(good, plan=good.plan[:, :-1]),
        change(good, plan=good.plan.astype(float)),
    ):
        with pytest.raises(CertificateError):
            verify(forged, problem)


def test_weaker_claims_are_corrected(proven: tuple[SAP, Certificate, Path]) -> None:
    """A claim below what is proven comes back as what is proven."""
    problem, good, _ = proven
    modest = dataclasses.replace(good, value=good.value - 1.0, bound=good.bound + 1.0)
    again = verify(modest, problem)
    assert (again.value, again.bound) == (good.value, good.bound)


def test_other_problems_are_refused(proven: tuple[SAP, Certificate, Path]) -> None:
    """One benefit changed by 1e-3, another cost, an initial assignment: another problem."""
    problem, good, path = proven
    other = problem.benefits.dense().copy()
    other[1, 2, 3] += 1e-3
    for different in (
        SAP(other, problem.dynamics),
        SAP(problem.benefits, SwitchingCost(0.301)),
        SAP(problem.benefits, SwitchingCost(0.3, idle_is_free=True)),
        SAP(problem.benefits, problem.dynamics, [0, 1, 2, 3]),
    ):
        with pytest.raises(CertificateError, match="another problem"):
            verify(path, different)


def test_problem_files_are_no_certificates(proven: tuple[SAP, Certificate, Path], tmp_path: Path) -> None:
    """A file of another kind is named as such."""
    problem, _, _ = proven
    problem.save(tmp_path / "p.npz")
    with pytest.raises(CertificateError, match="expected 'sapopt-certificate"):
        verify(tmp_path / "p.npz", problem)


def test_global_dynamics_have_no_prices() -> None:
    """A state that belongs to all agents together cannot be certified by prices; the message says so."""

    class Shared:
        handover_limit = 0.0

        def initial_state(self, problem: SAP) -> int:
            return 0

        def handover(self, k: int, state: int) -> np.ndarray:
            return np.zeros((2, 3)) - state

        def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
            return int(assignment[0])

    problem = SAP(np.ones((3, 2, 3)), Shared())
    result = solve(problem, HAAL(2))
    assert bound(problem).value >= result.value
    with pytest.raises(CertificateError, match="not agent-local"):
        certify(problem, result)
    with pytest.raises(CertificateError, match="not agent-local"):
        prove(problem, result.plan, np.zeros((3, 3)))
