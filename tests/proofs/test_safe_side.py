"""Numbers of certificates are on the safe side of rational arithmetic at any scale; nothing beyond them passes."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sapopt import SAP, SwitchingCost, bound, certify, solve, verify
from sapopt.data.files import write_npz
from sapopt.dynamics import Battery
from sapopt.problem.result import Status
from sapopt.proofs.certificate import Certificate, CertificateError
from sapopt.proofs.plain import plain_bound, plain_value, sum_down
from sapopt.solvers import HAA, Exact

SCALES = {
    "1e-300": (1e-300,), "1e-12": (1e-12,), "1": (1.0,), "1e12": (1e12,), "1e150": (1e150,),
    "mixed": (1e-20, 1e-13, 1e-6, 1.0, 1e6, 1e13, 1e20), "far apart": (1e-300, 1e-12, 1.0, 1e12, 1e150),
}  # fmt: skip
"""By name; of several, every benefit has one of its own."""


def drawn(seed: int, scales: tuple[float, ...]) -> SAP:
    """A problem of two agents, with negative benefits, at one scale or with entries of all of them."""
    rng = np.random.default_rng(seed)
    size = rng.choice(scales, (3, 2, 3))
    cost = 0.3 * float(rng.choice(scales))
    initial = [0, 1] if seed % 2 else None
    return SAP(rng.uniform(-0.3, 1.0, (3, 2, 3)) * size, SwitchingCost(cost, bool(seed % 3 == 0)), initial)


def exact_value(problem: SAP, plan: Any) -> Fraction:
    """Value of a plan by the definition, in rational numbers."""
    benefits, rule = problem.benefits.dense(), problem.dynamics
    held = problem.initial_assignment
    total = Fraction(0)
    for k, row in enumerate(plan):
        for i, j in enumerate(row):
            total += Fraction(float(benefits[k, i, j]))
            pays = held is not None and held[i] != j and not (rule.idle_is_free and benefits[k, i, j] <= 0)
            total -= Fraction(float(rule.cost)) if pays else 0
        held = row
    return total


def best_value(problem: SAP) -> Fraction:
    """The optimum in rational numbers, by trying all plans."""
    rows = list(itertools.permutations(range(problem.m), problem.n))
    return max(exact_value(problem, plan) for plan in itertools.product(rows, repeat=problem.T))


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("seed", range(4))
def test_value_and_bound_against_fractions(seed: int, scale: str) -> None:
    """`evaluate` is right to the last digit, certified values are never above, bounds never below the exact ones."""
    problem = drawn(seed, SCALES[scale])
    optimum = best_value(problem)
    rows = list(itertools.permutations(range(problem.m), problem.n))
    rng = np.random.default_rng(seed)
    for _ in range(8):
        plan = np.array([rows[j] for j in rng.integers(len(rows), size=problem.T)])
        exact = exact_value(problem, plan)
        value = plain_value(problem, plan)
        assert Fraction(value) <= exact < Fraction(math.nextafter(value, math.inf))
        size = sum(abs(Fraction(float(x))) for x in problem.benefits.at(plan).ravel())
        assert abs(Fraction(problem.evaluate(plan).value) - exact) <= size / 2**50
        top = float(np.abs(problem.benefits.dense()).max())
        prices = rng.random((problem.T, problem.m)) * top * rng.integers(0, 2)
        assert Fraction(plain_bound(problem, prices)) >= optimum
    proven = bound(problem)
    assert Fraction(proven.value) >= optimum
    size = Fraction(float(np.abs(problem.benefits.dense()).max())) * problem.T * problem.n
    for method in ("network", "milp", "qap", "dp"):
        result = solve(problem, Exact(method=method, tolerance=1e-9))
        exact = exact_value(problem, result.plan)
        assert abs(Fraction(result.value) - exact) <= size / 2**50, method
        assert result.status is Status.OPTIMAL, method
        assert optimum - exact <= size / 10**9, method
        assert Fraction(result.bound) >= optimum - size / 10**12, method
        assert Fraction(result.bound) <= optimum + size / 10**9, method
    certificate = certify(problem, result, prices=proven.prices)
    assert Fraction(certificate.value) <= exact_value(problem, result.plan)
    assert Fraction(certificate.bound) >= optimum
    assert verify(certificate, problem).value == certificate.value


@pytest.mark.parametrize("scale", SCALES)
def test_not_one_bit_more(scale: str) -> None:
    """The next float64 above the value, or below the bound, is refused; whatever the scale of benefits and prices."""
    problem = drawn(1, SCALES[scale])
    result = solve(problem, HAA())
    top = float(np.abs(problem.benefits.dense()).max())
    for prices in (bound(problem).prices, np.full((3, 3), 1e15 * top)):
        honest = certify(problem, result, prices=prices)
        verify(honest, problem)
        for changed in (
            {"value": math.nextafter(honest.value, math.inf)},
            {"value": honest.value + 5e-10},
            {"value": honest.value + 1e5 * top},
            {"bound": math.nextafter(honest.bound, -math.inf)},
        ):
            if honest.value + 0.0 in changed.values():
                continue  # too small a change to be one
            with pytest.raises(CertificateError, match="claimed"):
                verify(dataclasses.replace(honest, **changed), problem)


def test_sums_are_rounded_down() -> None:
    """The greatest float64 that is not above the exact sum, also where the sum is halfway between two."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        numbers = (rng.normal(size=9) * 10.0 ** rng.uniform(-300, 300, 9)).tolist()
        exact, found = sum(map(Fraction, numbers)), sum_down(numbers)
        assert Fraction(found) <= exact < Fraction(math.nextafter(found, math.inf))
    with pytest.raises(ValueError, match="overflows"):
        sum_down([1e308, 1e308])


def test_the_theorem_needs_agents_that_can_stay() -> None:
    """HAA has -7.9 of 2: with forbidden pairs nothing is promised, and the certificate says why."""
    problem = SAP([[[1, 1.1]], [[1, -np.inf]]], 10.0)
    result = solve(problem, HAA())
    certificate = verify(certify(problem, result), problem)
    assert result.value == pytest.approx(-7.9)
    assert (certificate.ratio, certificate.guarantee.refined_ratio) == (0.0, 0.0)
    assert not certificate.guarantee.covers(HAA())
    assert "forbidden" in certificate.theorem


def test_equal_problems_have_equal_fingerprints(tmp_path: Path) -> None:
    """Scalars of numpy, whole numbers and negative zeros count by value, before and after a file."""
    values = np.random.default_rng(0).random((2, 2, 3))
    pairs = [
        (SwitchingCost(0.0, True), SwitchingCost(-0.0, np.True_)),
        (SwitchingCost(np.float64(0.5)), SwitchingCost(0.5)),
        (SwitchingCost(np.float32(0.5)), SwitchingCost(0.5)),
        (Battery(1), Battery(1.0)),
        (Battery(np.int64(1)), Battery(1.0)),
    ]
    for one, other in pairs:
        problem = SAP(values, one)
        problem.save(tmp_path / "p.npz")
        prints = {
            problem.fingerprint,
            SAP(values, other).fingerprint,
            SAP.load(tmp_path / "p.npz").fingerprint,
        }
        assert len(prints) == 1, one


class Told(SwitchingCost):
    """A dynamics that tells what it is by some arrays."""

    parts: tuple[np.ndarray, ...] = ()

    def fingerprint(self) -> list[Any]:
        """The arrays."""
        return ["version 1", *self.parts]


def test_shapes_are_part_of_the_fingerprint() -> None:
    """Arrays that hold the same bytes in other shapes, or cut elsewhere, are another problem."""
    values = np.random.default_rng(0).random((2, 2, 3))
    one = np.arange(6.0)
    prints = set()
    for parts in ((one,), (one.reshape(2, 3),), (one.reshape(3, 2),), (one[:2], one[2:]), (one[:3], one[3:])):
        dynamics = Told(0.5)
        object.__setattr__(dynamics, "parts", parts)
        prints.add(SAP(values, dynamics).fingerprint)
    assert len(prints) == 5
    matrix = np.ones((3, 3)) - np.eye(3)
    assert SAP(values, SwitchingCost(matrix)).fingerprint != SAP(values, SwitchingCost(1.0)).fingerprint


FORGED: dict[str, dict[str, Any]] = {
    "huge value": {"value": 10**400},
    "text": {"value": "x"},
    "no number": {"bound": None},
    "truth": {"value": True},
    "NaN": {"bound": float("nan")},
    "infinite": {"bound": float("-inf")},
    "ratio": {"guarantee": {"ratio": "x"}},
    "no guarantee": {"guarantee": None},
    "nested guarantee": {"guarantee": {"conditions": [1]}},
    "solver": {"solver": {"a": 1}},
    "fingerprint": {"fingerprint": None},
    "digest": {"digest": 7},
}


@pytest.mark.parametrize("name", FORGED)
def test_forged_headers(tmp_path: Path, name: str) -> None:
    """Whatever a header claims, the refusal is a CertificateError."""
    problem = drawn(1, (1.0,))
    path = tmp_path / "c.npz"
    certify(problem, solve(problem, HAA())).save(path)
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    meta = json.loads(str(arrays.pop("meta")))
    del meta["arrays"]
    for key, value in FORGED[name].items():
        both = isinstance(value, dict) and isinstance(meta[key], dict)
        meta[key] = meta[key] | value if both else value
    write_npz(path, meta, arrays)
    for check in (Certificate.load, lambda p: verify(p, problem)):
        with pytest.raises(CertificateError):
            check(path)


@pytest.mark.parametrize(
    "change",
    [
        {"prices": np.full((3, 3), 1e308)}, {"prices": np.full((3, 3), -1.0)}, {"prices": [["a"]]},
        {"prices": None}, {"prices": np.full((3, 3), None)}, {"plan": np.zeros((3, 2))}, {"plan": None},
        {"plan": np.zeros((3, 2), int)}, {"plan": [["a"]]}, {"plan": np.full((3, 2), 2**63, np.uint64)},
        {"value": 10**400}, {"value": "x"}, {"value": None}, {"bound": None}, {"fingerprint": None},
        {"guarantee": None},
    ],
    ids=lambda change: next(iter(change)),
)  # fmt: skip
def test_forged_objects(change: dict[str, Any]) -> None:
    """A certificate that was made by hand is refused in the same way."""
    problem = drawn(1, (1.0,))
    honest = certify(problem, solve(problem, HAA()))
    with pytest.raises(CertificateError):
        verify(dataclasses.replace(honest, **change), problem)
