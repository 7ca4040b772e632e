"""Problems with a user's own dynamics travel: as data, with a fingerprint, and never as code."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import error_line, run
from local_dynamics import Tiring

from sapopt import SAP, SwitchingCost, solve
from sapopt.solvers import HAA
from sapopt.sweeps import read_config, solve_job

CUBE = np.random.default_rng(0).random((4, 2, 3))


@dataclass(frozen=True, eq=False)
class Weary(Tiring):
    """Agents that tire, and tell what decides it."""

    weights: Any = field(default_factory=lambda: np.ones(2))

    def bind(self, benefits: Any) -> Weary:
        return replace(self, benefits=benefits)

    def fingerprint(self) -> list[Any]:
        return ["weary 1", self.price, self.first, self.weights]


class Plain:
    """A class that keeps its parameters to itself."""

    def __init__(self, cost: float) -> None:
        self._cost = cost

    def fingerprint(self) -> list[Any]:
        return ["plain 1", self._cost]

    def initial_state(self, problem: Any) -> tuple[int, int]:
        return problem.n, problem.m

    def handover(self, k: int, state: Any) -> np.ndarray:
        return np.full(state, -self._cost)

    def transition(self, k: int, state: Any, assignment: Any) -> Any:
        return state


class Other(Plain):
    """Another class."""


def test_a_class_is_handed_over(tmp_path: Path) -> None:
    """Numbers and arrays of a dataclass come back; the problem has the same fingerprint, names and plans."""
    problem = SAP(CUBE, Weary(0.25, 2, weights=np.array([0.5, 1.5])), agents=["a", "b"])
    problem.save(tmp_path / "p.npz")
    again = SAP.load(tmp_path / "p.npz", dynamics=Weary)
    assert type(again.dynamics) is Weary
    assert again.dynamics.weights.tolist() == [0.5, 1.5]
    assert again.fingerprint == problem.fingerprint
    assert again.agents == ("a", "b")
    assert (solve(again, HAA()).plan == solve(problem, HAA()).plan).all()
    assert SAP.load(tmp_path / "p.npz", dynamics=problem.dynamics).fingerprint == problem.fingerprint


def test_an_object_is_handed_over(tmp_path: Path) -> None:
    """What cannot be made anew from the file is brought as an object, and checked by its fingerprint."""
    SAP(CUBE, Plain(0.5)).save(tmp_path / "p.npz")
    assert SAP.load(tmp_path / "p.npz", dynamics=Plain(0.5)).fingerprint == SAP(CUBE, Plain(0.5)).fingerprint
    with pytest.raises(ValueError, match="hand over an object instead of the class"):
        SAP.load(tmp_path / "p.npz", dynamics=Plain)
    for stranger in (Plain(0.25), Other(0.5), SwitchingCost(0.5)):
        with pytest.raises(ValueError, match="tells another fingerprint"):
            SAP.load(tmp_path / "p.npz", dynamics=stranger)


def test_a_file_never_brings_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that a file names is imported, and without the class it is refused with what to do."""
    monkeypatch.setattr(Weary, "__module__", "a_module_that_must_not_be_imported")
    SAP(CUBE, Weary(0.25)).save(tmp_path / "p.npz")
    before = set(sys.modules)
    monkeypatch.setattr("builtins.__import__", _refuse(__import__))
    with pytest.raises(
        ValueError, match=r"brings no code; hand the class over: SAP.load\(path, dynamics=Weary\)"
    ):
        SAP.load(tmp_path / "p.npz")
    assert "a_module_that_must_not_be_imported" not in set(sys.modules) - before


def _refuse(real: Any) -> Any:
    def importing(name: str, *args: Any, **kwargs: Any) -> Any:
        assert name != "a_module_that_must_not_be_imported"
        return real(name, *args, **kwargs)

    return importing


def test_other_mistakes(tmp_path: Path) -> None:
    """A class where none is wanted, a class of other parameters, and one without a fingerprint are told."""
    SAP(CUBE, 0.5).save(tmp_path / "ours.npz")
    with pytest.raises(ValueError, match="holds a SwitchingCost of sapopt; leave dynamics out"):
        SAP.load(tmp_path / "ours.npz", dynamics=Weary)
    SAP(CUBE, Weary(0.25)).save(tmp_path / "p.npz")
    with pytest.raises(ValueError, match="Plain does not take what"):
        SAP.load(tmp_path / "p.npz", dynamics=Plain)
    with pytest.raises(ValueError, match="has no fingerprint; give it a method"):
        SAP(CUBE, Tiring(0.5)).save(tmp_path / "q.npz")
    assert not (tmp_path / "q.npz").exists()


MODULE = '''
from dataclasses import dataclass
import numpy as np

@dataclass(frozen=True)
class Toll:
    """Every step costs."""
    toll: float = 0.5
    size: int = 2
    handover_limit = 0.0
    def fingerprint(self):
        return ["toll 1", self.toll]
    def initial_state(self, problem):
        return problem.n, problem.m
    def handover(self, k, state):
        return np.full(state, -self.toll)
    def transition(self, k, state, assignment):
        return state
'''


@pytest.fixture
def toll(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a module of a user's own, and a problem saved with it."""
    (tmp_path / "own_toll.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.delitem(sys.modules, "own_toll", raising=False)
    from own_toll import Toll  # type: ignore[import-not-found]

    SAP(CUBE, Toll(0.25)).save(tmp_path / "p.npz")
    return tmp_path


@pytest.mark.parametrize("place", [0, 3])
def test_on_the_command_line(toll: Path, place: int) -> None:
    """`--dynamics MODULE:CLASS`, before or behind the command; without it one line says what to hand over."""
    args = ["solve", "p.npz", "--json", "--solver", "haa", "--no-bound"]
    args[place:place] = ["--dynamics", "own_toll:Toll"]
    outcome = run(*args)
    assert outcome.exit_code == 0, outcome.output
    told = json.loads(outcome.stdout)
    assert told["dynamics"].startswith("Toll(toll=0.25")
    assert told["handover"] == pytest.approx(-0.25 * 8)
    outcome = run("solve", "p.npz", "--solver", "haa", "--no-bound")
    assert outcome.exit_code == 2
    assert "--dynamics own_toll:Toll" in outcome.stderr.splitlines()[-1]


def test_bad_names(toll: Path) -> None:
    """Modules and classes that do not exist are told in one line, before any work."""
    for name, words in (
        ("own_toll", "must be MODULE:CLASS"), ("own_tool:Toll", "No module named 'own_tool'"),
        ("own_toll:Tool", "there is no Tool in own_toll"), ("own_toll:MODULE", "there is no MODULE"),
        ("own_toll:np", "np is no class"), ("--json", "--dynamics"),
    ):  # fmt: skip
        assert words in error_line("solve", "p.npz", "--dynamics", name)


def test_in_a_sweep(toll: Path) -> None:
    """The workers import the class that the command line names, beside instances of sapopt's own."""
    SAP(CUBE, 0.5).save(toll / "ours.npz")
    (toll / "sweep.toml").write_text(
        'instances = ["p.npz", "ours.npz"]\nsolvers = ["haa"]\nout = "results"\n'
    )
    plan = read_config(toll / "sweep.toml", "own_toll:Toll")
    values = [solve_job(job.spec)["value"] for job in plan.jobs]
    assert values[0] == pytest.approx(solve(SAP.load(toll / "p.npz", _toll()), HAA()).value)
    assert values[1] == pytest.approx(solve(SAP(CUBE, 0.5), HAA()).value)
    outcome = run("sweep", "sweep.toml", "--workers", 1, "--dynamics", "own_toll:Toll", "--json")
    assert outcome.exit_code == 0, outcome.output
    assert json.loads(outcome.stdout)["done"] == 2


def _toll() -> Any:
    return sys.modules["own_toll"].Toll
