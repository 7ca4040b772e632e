"""The weights that ship: they load by name, tell where they come from, and beat the greedy policies."""

from __future__ import annotations

import pytest

pytest.importorskip("torch")

from sapopt import solve
from sapopt.domains.instances import instance
from sapopt.learning import REDA, ObservationSpec
from sapopt.solvers import AssignmentPolicy, power_constrained


def test_power_weights() -> None:
    """Published sizes, the command that made them, and a quarter more than the power-constrained greedy policy."""
    reda = REDA.load("power")
    assert reda.network.spec == ObservationSpec()
    assert reda.network.hidden == (64, 64)
    assert reda.about["command"].startswith("sapopt train reda power")
    problem = instance("power", 77, steps=60)
    learned, greedy = (solve(problem, AssignmentPolicy(g)).value for g in (reda, power_constrained))
    assert learned > 1.2 * greedy


def test_other_sizes_need_no_training() -> None:
    """The same weights play a larger constellation."""
    from sapopt.domains.constellation import WalkerShell
    from sapopt.domains.power import power_constellation

    problem = power_constellation(WalkerShell(20, 20, 58.0, 550.0), 500, 40, 3).problem()
    learned, greedy = (
        solve(problem, AssignmentPolicy(g)).value for g in (REDA.load("power"), power_constrained)
    )
    assert learned > greedy
