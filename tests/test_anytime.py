"""Every solver gives up in the middle of its work, by the clock or by Ctrl-C, and hands back what it has."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest

import sapopt
from sapopt import SAP, Status, bound, rollout, solve
from sapopt.dynamics import Interference
from sapopt.running.control import Expired, Run, interruptible
from sapopt.solvers import (
    CBBA,
    HAA,
    HAAL,
    HAALD,
    DistributedDualLookahead,
    DualDecomposition,
    DualLookahead,
    Exact,
    Greedy,
    IteratedAssignment,
    MyopicGreedy,
    NoHandover,
)
from sapopt.solvers.names import METHODS, parse_solver

LIMIT = 1000.0
GRAPH = nx.cycle_graph(5)
SOLVERS = [
    NoHandover(), Greedy(), HAA(), HAAL(4), HAAL(4, keep_plan=True), HAAL(8), DualLookahead(3, iterations=20),
    HAALD(3, graph=GRAPH), CBBA(3, graph=GRAPH), DistributedDualLookahead(3, graph=GRAPH, iterations=5),
    DualDecomposition(iterations=60, rounds=2, sweeps=5), Exact(),
]  # fmt: skip
SOLVERS += [
    parse_solver(method.name).solver
    for method in METHODS
    if method.class_name not in {type(solver).__name__ for solver in SOLVERS}
]
"""With the options above where they matter; every other solver that has a name on the command line, as it is there."""


@pytest.fixture(scope="module")
def problem() -> SAP:
    """A problem on which nothing is trivial."""
    return SAP(np.random.default_rng(3).random((9, 5, 7)), 0.4)


def fitting(problem: SAP, solver: Any) -> SAP:
    """The problem; for a solver of interacting tasks alone, the same with losses between two pairs of them."""
    if isinstance(solver, IteratedAssignment):
        return SAP(problem.benefits, Interference([[0, 1], [2, 3]], 0.3, 0.4))
    return problem


class Looks:
    """A clock that stands still, does something at a given look, and counts the looks after it."""

    def __init__(self, at: int, then: Callable[[Looks], None]) -> None:
        self.at, self.then = at, then
        self.now = 0.0
        self.before = self.after = 0

    def __call__(self) -> float:
        if self.before < self.at:
            self.before += 1
            if self.before == self.at:
                self.then(self)
        else:
            self.after += 1
        return self.now


def time_is_up(clock: Looks) -> None:
    """The clock jumps past the limit."""
    clock.now = 2 * LIMIT


def control_c(clock: Looks) -> None:
    """The user presses Ctrl-C."""
    signal.raise_signal(signal.SIGINT)


ENDINGS = [(time_is_up, Status.TIME_LIMIT), (control_c, Status.INTERRUPTED)]


@pytest.mark.parametrize(("ending", "status"), ENDINGS, ids=["clock", "interrupt"])
@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.name)
def test_gives_up(
    problem: SAP, solver: Any, ending: Any, status: Status, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever the time ends, a feasible plan comes back, and only few looks at the clock later, so at once."""
    problem = fitting(problem, solver)
    whole = solve(problem, solver, time_limit=LIMIT)
    for at in (2, 3, 5, 8, 13, 21, 34, 55, 89, 144):
        clock = Looks(at, ending)
        with monkeypatch.context() as patched:
            patched.setattr("sapopt.kernels.clock.time.perf_counter", clock)
            result = solve(problem, solver, time_limit=LIMIT)
        if clock.after == 0 and clock.before < at:  # the solver was done before
            break
        assert result.value == problem.evaluate(result.plan).value
        assert clock.after <= 60
        if result.status is Status.FEASIBLE:  # it claims that nothing was cut off
            assert np.array_equal(result.plan, whole.plan)
        else:
            assert result.status is status or result.status is Status.OPTIMAL
    else:
        assert result.status is status or result.status is Status.OPTIMAL


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.name)
def test_looks_at_the_clock_within_a_step(problem: SAP, solver: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Methods that take long for a step look at the clock in the middle of it."""
    one = fitting(SAP(problem.benefits.slice(0, 4), problem.dynamics), solver)
    solve(one, solver, time_limit=LIMIT)
    clock = Looks(10**9, time_is_up)
    monkeypatch.setattr("sapopt.kernels.clock.time.perf_counter", clock)
    solve(one, solver, time_limit=LIMIT)
    quick = isinstance(solver, NoHandover | Greedy | MyopicGreedy | HAA)
    assert quick or clock.before > 5 * one.T


class Endless:
    """A policy whose first step never ends by itself."""

    name = "Endless"

    def begin(self, problem: SAP, rng: np.random.Generator) -> None:
        """Nothing to remember."""

    def act(self, outlook: Any, memory: None) -> Any:
        """Look at the clock for ever."""
        while True:
            outlook.check()


def test_a_step_that_does_not_end(problem: SAP, caplog: pytest.LogCaptureFixture) -> None:
    """The step is left undecided and the plan is whole; the log says so."""
    played = rollout(problem, Endless(), Run(time_limit=0.01))
    assert played.status is Status.TIME_LIMIT
    assert np.isfinite(problem.evaluate(played.plan).value)
    assert "ended at step 0" in caplog.text


def test_bound_gives_up(problem: SAP, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bound cut short is above the full one, and valid."""

    class Foreign:
        """The same costs, of which nothing is known but that they cost."""

        handover_limit = 0.0

        def __init__(self) -> None:
            self.rule = problem.dynamics.bind(problem.benefits)

        def initial_state(self, problem: SAP) -> Any:
            return None

        def handover(self, k: int, state: Any) -> Any:
            return self.rule.handover(k, state)

        def transition(self, k: int, state: Any, assignment: Any) -> Any:
            return assignment

    other = SAP(problem.benefits.dense(), Foreign())
    best = solve(problem, HAAL(3)).value
    for case in (problem, other):
        full = bound(case).value
        for at in (2, 5, 8):
            with monkeypatch.context() as patched:
                clock = Looks(at, time_is_up)
                patched.setattr("sapopt.kernels.clock.time.perf_counter", clock)
                cut = bound(case, time_limit=LIMIT).value
            assert clock.after <= 30
            assert cut >= full - 1e-9 >= best - 2e-9
        assert bound(case, callback=lambda _: True).value >= full - 1e-9


def test_parts_of_a_run() -> None:
    """A part ends with its own time, and with the run it belongs to."""
    whole = Run(time_limit=100.0)
    assert not whole.part().expired
    assert whole.part(0.0).expired
    assert whole.part().seconds_left <= 100.0
    part = whole.part()
    whole.stopped = True
    assert part.expired
    assert part.stopped
    with pytest.raises(Expired):
        part.check()


def test_second_interrupt_interrupts() -> None:
    """The first one asks, the second one is a KeyboardInterrupt; afterwards all is as before."""
    before = signal.getsignal(signal.SIGINT)
    run = Run()

    def press_twice() -> None:
        with interruptible(run):
            signal.raise_signal(signal.SIGINT)
            assert run.stopped
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        press_twice()
    assert signal.getsignal(signal.SIGINT) is before


def test_foreign_handlers_are_called() -> None:
    """Who has a handler of his own hears of the interruption; the run stops all the same."""
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    try:
        run = Run()
        with interruptible(run):
            signal.raise_signal(signal.SIGINT)
        assert run.stopped
        assert heard == [signal.SIGINT]
    finally:
        signal.signal(signal.SIGINT, before)


def test_kernel_errors_pass() -> None:
    """An interrupted kernel's SystemError becomes the KeyboardInterrupt it was; other errors stay what they are."""
    error = SystemError("from a kernel")
    error.__cause__ = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt), interruptible(Run()):
        raise error
    with pytest.raises(SystemError), interruptible(Run()):
        raise SystemError("our fault")


SCRIPT = """
import numpy as np, scipy.sparse as sp, sapopt
from sapopt.solvers import HAAL
rng = np.random.default_rng(0)
steps = [sp.random_array((300, 400), density=0.01, rng=rng, format="csr") for _ in range(20)]
problem = sapopt.SAP(steps, 0.5)
sapopt.solve(sapopt.SAP(steps[:4], 0.5), HAAL(3))
print("ready", flush=True)
result = sapopt.solve(problem, HAAL(20))
print(result.status.value, problem.evaluate(result.plan).value == result.value)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGINT to one process")
def test_interrupt_in_a_kernel() -> None:
    """A library script that is stopped in the middle of a compiled search has its result."""
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(sapopt.__file__).parents[1],
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert out == "interrupted True\n"
