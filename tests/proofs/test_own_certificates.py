"""Certificates of problems with a dynamics of the user's own: by a fingerprint, and never for another problem."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rule_problems import Learning

from sapopt import SAP, CertificateError, SwitchingCost, bound, certify, solve, verify
from sapopt.solvers import HAA, DualDecomposition, Exact

BENEFITS = np.random.default_rng(4).random((4, 2, 4)).round(2)


class Told(Learning):
    """A rule of the user's that says what decides it."""

    def fingerprint(self) -> list[Any]:
        return ["Told 1", self.bonus]


class Ladder:
    """Local states written out by hand; `told` is what the class says of itself, `slip` an error in its states."""

    def __init__(self, told: Any = "Ladder 1", slip: float = 0.0, rung: float = 0.1) -> None:
        self.told, self.slip, self.rung = told, slip, rung

    def fingerprint(self) -> Any:
        return self.told

    def initial_state(self, problem: SAP) -> np.ndarray:
        return np.zeros(problem.n, dtype=np.int64)

    def handover(self, k: int, state: np.ndarray) -> np.ndarray:
        return np.asarray(-self.rung * np.abs(state[:, None] - np.arange(4)))

    def transition(self, k: int, state: np.ndarray, assignment: np.ndarray) -> np.ndarray:
        return state + np.sign(assignment - state)

    def local_model(self, benefits: Any, state: np.ndarray) -> Any:
        return Rungs(state, self.rung + self.slip)


class Rungs:
    """The states of a `Ladder`."""

    def __init__(self, state: np.ndarray, rung: float) -> None:
        self.state, self.rung = state, rung

    def state_count(self) -> int:
        return 4

    def start(self, agent: int) -> int:
        return int(self.state[agent])

    def step(self, k: int, agent: int, benefit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rung, task = np.indices((4, 4))
        return rung + np.sign(task - rung), -self.rung * np.abs(rung - task)


@pytest.mark.parametrize("dynamics", [Told(0.3), Ladder(), Ladder(["Ladder", 1, np.arange(3)])])
def test_certified_and_verified(dynamics: Any, tmp_path: Path) -> None:
    """Value and bound enclose the optimum, and the file is accepted for the problem made anew."""
    problem = SAP(BENEFITS, dynamics)
    certify(problem, solve(problem, HAA())).save(tmp_path / "c.npz")
    proven = verify(tmp_path / "c.npz", SAP(BENEFITS, dynamics))
    optimum = solve(problem, Exact(method="dp")).value
    assert proven.value <= optimum + 1e-9
    assert optimum <= proven.bound
    assert proven.fingerprint == problem.fingerprint


@pytest.mark.parametrize(
    "other",
    [
        Told(0.2), Told(0.3 + 1e-12), Ladder("Told 1"), SwitchingCost(0.3),
        type("Told", (Learning,), {"fingerprint": lambda self: ["Told 2", self.bonus]})(0.3),
        type("Other", (Learning,), {"fingerprint": lambda self: ["Told 1", self.bonus]})(0.3),
    ],
)  # fmt: skip
def test_other_problems_are_refused(other: Any) -> None:
    """Other parameters, another version, another class, other benefits: another problem."""
    problem = SAP(BENEFITS, Told(0.3))
    certificate = certify(problem, solve(problem, HAA()))
    for stranger in (SAP(BENEFITS, other), SAP(BENEFITS + 1e-9, Told(0.3))):
        with pytest.raises(CertificateError, match="another problem"):
            verify(certificate, stranger)


def test_a_careless_fingerprint_proves_nothing_false() -> None:
    """Where two problems share a fingerprint, the claims are still recomputed from the one at hand."""

    class Careless(Learning):
        def fingerprint(self) -> str:
            return "always the same"

    rich, poor = SAP(BENEFITS, Careless(0.9)), SAP(BENEFITS, Careless(0.0))
    assert rich.fingerprint == poor.fingerprint
    best = certify(rich, solve(rich, Exact(method="dp")))
    with pytest.raises(CertificateError, match="is worth"):
        verify(best, poor)
    tight = certify(poor, solve(poor, HAA()), prices=bound(poor).prices)
    claim = dataclasses.replace(tight, value=0.0)
    with pytest.raises(CertificateError, match="prove a bound"):
        verify(claim, rich)


@pytest.mark.parametrize("scale", [1e-300, 1e-13, 1.0, 1e150])
def test_a_dynamics_that_contradicts_itself_is_refused(scale: float) -> None:
    """Local states with other handovers than the matrices would bound another problem, at any scale."""
    problem = SAP(BENEFITS * scale, Ladder(slip=0.05 * scale, rung=0.1 * scale))
    with pytest.raises(CertificateError, match="contradicts itself"):
        certify(problem, solve(problem, HAA()))


def test_subclasses_of_built_in_dynamics_get_no_bound_of_their_base() -> None:
    """A subclass may charge anything; the plain recursion of its base knows nothing of it."""

    class Half(SwitchingCost):
        def fingerprint(self) -> str:
            return "Half 1"

        def handover(self, k: int, state: Any) -> np.ndarray:
            return np.asarray(0.5 * super().handover(k, state))

    problem = SAP(BENEFITS, Half(0.5))
    with pytest.raises(ValueError, match="Half changes handover of SwitchingCost"):
        certify(problem, solve(problem, HAA()))
    with pytest.raises(ValueError, match="Half changes handover of SwitchingCost"):
        bound(problem)
    with pytest.raises(ValueError, match="Half changes handover of SwitchingCost"):
        solve(problem, DualDecomposition())


@pytest.mark.parametrize("told", [None, [], 3.0j, [object()], {"loss": 1}, [np.array(["a"])]])
def test_bad_fingerprints(told: Any) -> None:
    """Only text, numbers and arrays of numbers; the message names the class."""
    with pytest.raises(ValueError, match=r"Ladder\.fingerprint\(\)"):
        SAP(BENEFITS, Ladder(told)).fingerprint  # noqa: B018


def test_without_a_fingerprint() -> None:
    """The message says what to add."""
    problem = SAP(BENEFITS, Learning(0.3))
    with pytest.raises(CertificateError, match=r"give it a method fingerprint\(\)"):
        certify(problem, solve(problem, HAA()))
