"""The controls of a run, and the progress that is shown."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sapopt import SAP, Progress, solve
from sapopt.running.control import Run
from sapopt.running.display import describe, progress_bar
from sapopt.solvers import HAA


class Clock:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock that runs look at."""
    hand = Clock()
    monkeypatch.setattr("sapopt.kernels.clock.time.perf_counter", hand)
    return hand


def test_clock_of_a_run(clock: Clock) -> None:
    """The clock starts with the run; at the limit the run expires."""
    run = Run(time_limit=2.0)
    clock.now += 1.5
    assert (run.seconds, run.seconds_left, run.expired) == (1.5, 0.5, False)
    clock.now += 0.5
    assert run.expired
    assert run.report(1, 2)
    assert not Run().expired
    assert Run().seconds_left == np.inf


def test_reports_reach_the_callback(clock: Clock) -> None:
    """The callback sees what is reported, in order, and True from it ends the run for good."""
    seen: list[Progress] = []

    def watch(progress: Progress) -> bool | None:
        seen.append(progress)
        return progress.done == 2 or None

    run = Run(callback=watch)
    clock.now += 1
    assert not run.report(1, 3, value=5.0, bound=6.0, message="phase")
    assert seen == [Progress(1, 3, 1.0, 5.0, 6.0, "phase")]
    assert run.report(2, 3)
    assert run.report(2.5, 3)
    assert run.stopped
    assert run.expired


def test_seeds() -> None:
    """Equal seeds draw equal numbers, other seeds others."""
    draws = [Run(seed).rng.random() for seed in (0, 0, 1)]
    assert draws[0] == draws[1] != draws[2]


@pytest.mark.parametrize(
    ("value", "bound", "gap"), [(None, 2.0, None), (1.0, None, None), (1.0, 2.0, 0.5), (-3.0, -2.0, 0.5)]
)
def test_gap_of_progress(value: float | None, bound: float | None, gap: float | None) -> None:
    """(bound - value) / |bound| where both are known."""
    assert Progress(0, 0, 0.0, value, bound).gap == gap


def test_description() -> None:
    """One line with what is known."""
    assert describe(Progress(1, 2, 0.5)) == ""
    line = describe(Progress(1, 2, 0.5, 1234.56, 2000.0, "sweep 3"))
    assert line == "sweep 3  value 1,234.6  bound 2,000.0  gap 38.27 %"


def test_the_bar_passes_reports_on(capsys: pytest.CaptureFixture[str]) -> None:
    """The bar calls the callback and hands its answer back; nothing is printed on standard output."""
    seen: list[Any] = []
    with progress_bar("HAA", lambda p: seen.append(p.done) or p.done > 1) as report:
        assert not report(Progress(1, 0, 0.1))  # without a total, as planners report
        assert report(Progress(2, 2, 0.2, 1.0, 2.0))
    with progress_bar("HAA", None) as report:
        assert report(Progress(1, 2, 0.1)) is None
    assert seen == [1, 2]
    assert capsys.readouterr().out == ""


def test_progress_changes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    """With and without a bar the result is the same, and standard output stays empty."""
    problem = SAP(np.random.default_rng(0).random((4, 3, 4)), 0.3)
    quiet, shown = (solve(problem, HAA(), progress=p) for p in (False, True))
    np.testing.assert_array_equal(quiet.plan, shown.plan)
    assert capsys.readouterr().out == ""
