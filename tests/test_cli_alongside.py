"""Helpers that compile along: they start only when there is something to compile, and a failure costs nothing."""

from __future__ import annotations

import time
from collections import deque
from multiprocessing import active_children

import pytest

from sapopt import warming
from sapopt.cli import alongside, work
from sapopt.cli.progress import Reporter
from sapopt.domains.instances import instance
from sapopt.problem.sap import SAP
from sapopt.solvers import HAA, HAAL, DualDecomposition, DualLookahead
from sapopt.solvers.names import NamedSolver


def _jobs() -> deque[alongside.Job]:
    return deque([("haa", HAA()), ("haal", HAAL(2)), ("bound", None)])


def _small() -> SAP:
    return warming.first_steps(instance("constellation-toy"))


def _compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    began = time.perf_counter()
    monkeypatch.setattr(alongside, "compile_seconds", lambda: time.perf_counter() - began)
    monkeypatch.setattr(alongside, "thread_count", lambda: 2)


def _wait_until_one_is_taken(todo: deque[alongside.Job]) -> None:
    until = time.monotonic() + 120.0
    while len(todo) == 3 and time.monotonic() < until:
        time.sleep(0.02)
    assert [name for name, _ in todo] == ["haa", "haal"]


def test_nobody_is_started_while_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """With everything in the cache all jobs are left to the caller."""
    monkeypatch.setattr(alongside, "compile_seconds", lambda: 0.0)
    todo = _jobs()
    with alongside.Helpers() as helpers, helpers.helped(_small(), todo):
        time.sleep(0.2)
        assert len(todo) == 3


def test_helpers_take_from_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once this process compiles, a helper takes the last job, and the others when the common kernels are there."""
    _compiling(monkeypatch)
    todo = _jobs()
    with alongside.Helpers() as helpers, helpers.helped(_small(), todo) as common:
        _wait_until_one_is_taken(todo)
        common.set()
    assert not todo
    assert not active_children()


def test_a_helper_is_called_up_before_there_is_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """As soon as anything is compiled a process starts; it ends with the command if there is never anything to do."""
    _compiling(monkeypatch)
    with alongside.Helpers():
        until = time.monotonic() + 60.0
        while not active_children() and time.monotonic() < until:
            time.sleep(0.02)
        assert len(active_children()) == 1
    assert not active_children()


def test_an_interrupt_waits_for_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the block ends by Ctrl-C, what helpers have taken is given up and nothing more is begun."""
    _compiling(monkeypatch)
    todo = _jobs()

    def interrupted() -> None:
        with alongside.Helpers() as helpers, helpers.helped(_small(), todo):
            _wait_until_one_is_taken(todo)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not todo
    assert not active_children()


def test_a_helper_that_dies_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A helper that is killed leaves its job undone, and the block ends all the same."""
    _compiling(monkeypatch)
    todo = _jobs()
    with alongside.Helpers() as helpers, helpers.helped(_small(), todo):
        _wait_until_one_is_taken(todo)
        for child in active_children():
            child.kill()
    assert len(todo) >= 1


def test_a_problem_that_cannot_be_sent_gets_no_help(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a process cannot be started, everything is left to the caller, without a word."""
    _compiling(monkeypatch)
    todo = _jobs()
    with alongside.Helpers() as helpers, helpers.helped(lambda: None, todo):  # type: ignore[arg-type]
        time.sleep(1.5)
    assert len(todo) == 3


def test_windows_are_a_job_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """What DualDecomposition does last is compiled apart from it, and begun before the job ahead of it."""
    done: list[str] = []

    def note(problem: SAP, part: warming.Part) -> None:
        done.append(type(part).__name__)

    monkeypatch.setattr(warming, "warm_up", note)
    solvers = [
        NamedSolver("haa", HAA()),
        NamedSolver("lookahead", DualLookahead(3)),
        NamedSolver("dual", DualDecomposition()),
    ]
    with Reporter() as reporter, alongside.Helpers() as helpers:
        work.warm_up(instance("constellation-toy"), solvers, reporter, helpers)
    assert done == ["HAA", "Windows", "DualDecomposition", "DualLookahead", "NoneType"]


def test_windows_alone() -> None:
    """Windows are made without what comes before them, also where there are no networks to make them of."""
    for name in ("constellation-toy", "attitude"):
        small = warming.first_steps(instance(name))
        warming.warm_up(small, warming.Windows(DualDecomposition()))
