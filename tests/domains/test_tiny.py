"""The tiny problems: one of every built-in dynamics, so that nothing is forgotten when kernels are compiled ahead."""

from __future__ import annotations

import pytest

from sapopt import solve
from sapopt.domains import tiny
from sapopt.dynamics.registry import BUILT_IN
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.solvers import NoHandover


def test_every_dynamics_in_both_forms() -> None:
    """Each registered dynamics has a dense, a sparse and a begun problem, and each of them can be played."""
    seen = set()
    for name, problem in tiny.tiny_problems():
        seen.add((type(problem.dynamics), name.split(", ")[1]))
        assert solve(problem, NoHandover()).plan.shape == (problem.T, problem.n)
    assert seen == {(cls, form) for cls in BUILT_IN.values() for form in ("dense", "sparse", "begun")}


def test_a_dynamics_without_a_problem_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new dynamics that nobody wrote a problem for stops the list, with the place to mend it."""
    monkeypatch.delitem(tiny._MODELS, SwitchingCost)
    with pytest.raises(ValueError, match="no tiny problem of SwitchingCost"):
        next(tiny.tiny_problems())
