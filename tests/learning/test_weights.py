"""The weights that ship: they load by name, tell where they come from, and beat the greedy policies."""

from __future__ import annotations

import pytest

pytest.importorskip("torch")

from sapopt import solve
from sapopt.domains.instances import instance
from sapopt.learning import REDA, ObservationSpec, ThesisObservation
from sapopt.solvers import HAAL, AssignmentPolicy, power_constrained


def test_power_weights() -> None:
    """Published sizes, the command that made them, and a quarter more than the power-constrained greedy policy."""
    reda = REDA.load("power")
    assert reda.network.spec == ObservationSpec()
    assert reda.network.hidden == (64, 64)
    assert reda.about["command"].startswith("sapopt train reda power")
    problem = instance("power", 77, steps=60)
    learned, greedy = (solve(problem, AssignmentPolicy(g)).value for g in (reda, power_constrained))
    assert learned > 1.2 * greedy


def test_power_weights_of_the_thesis_observation() -> None:
    """Observation of section 6.2.2, and a quarter more than the power-constrained greedy policy."""
    reda = REDA.load("power-thesis")
    assert reda.network.spec == ThesisObservation(steps=5)
    assert reda.network.per_task
    assert reda.about["command"].startswith("sapopt train reda power --preset per-task")
    problem = instance("power", 77_000_000, steps=60)
    learned, greedy = (solve(problem, AssignmentPolicy(g)).value for g in (reda, power_constrained))
    assert learned > 1.25 * greedy


def test_earth_coverage_weights() -> None:
    """Observation of the thesis, one function for all tasks, more than HAAL on an episode that was not trained on."""
    reda = REDA.load("earth-coverage-thesis")
    assert reda.network.spec == ThesisObservation(steps=5, charge=False)
    assert reda.network.per_task
    assert reda.about["command"].startswith("sapopt train reda earth-coverage-thesis --preset per-task")
    problem = instance("earth-coverage-thesis", 77_000_000, steps=30)
    assert solve(problem, AssignmentPolicy(reda)).value > solve(problem, HAAL(3)).value


def test_other_sizes_need_no_training() -> None:
    """The same weights play a larger constellation."""
    from sapopt.domains.constellation import WalkerShell
    from sapopt.domains.power import power_constellation

    problem = power_constellation(WalkerShell(20, 20, 58.0, 550.0), 500, 40, 3).problem()
    learned, greedy = (
        solve(problem, AssignmentPolicy(g)).value for g in (REDA.load("power"), power_constrained)
    )
    assert learned > greedy
