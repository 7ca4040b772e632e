"""Decisions within a budget: there always is one, it is never worse than HAA's, and its bound is one."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from session_windows import RULES, benefits_of

from sapopt import InfeasibleError, Session, SwitchingCost
from sapopt.live.decision import Outcome
from sapopt.live.thinking import Times
from sapopt.running.outlook import Outlook
from sapopt.solvers import HAA, DualLookahead


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.sampled_from(sorted(RULES)), st.sampled_from([0.0, 1e-9, 1e-3, 5e-3, 10.0]))
def test_never_worse_than_the_best_of_the_step(seed: int, rule: str, budget: float) -> None:
    """Whatever the budget, a decision that it cut short is worth at least HAA's plan of the window; bounds hold."""
    session = Session(DualLookahead(3, iterations=10), RULES[rule]())
    for k in range(4):
        window = benefits_of(seed + k, (3, 3, 5))
        twin = Session(HAA(), RULES[rule]())
        twin._standing = session._standing
        sure = twin.step(window)
        with (
            pytest.MonkeyPatch.context() as patch
        ):  # however slow the machine, plans are compared to their end
            patch.setattr(Times, "has_time", lambda self, seconds=0.0: True)
            decision = session.step(window, budget_s=budget)
        if decision.status is Outcome.FALLBACK:
            assert decision.assignment == sure.assignment
        if decision.status is not Outcome.COMPLETE:
            assert decision.value >= sure.value - 1e-9
        if decision.bound is not None:
            assert decision.value <= decision.bound + 1e-9
        assert len(set(decision.assignment.values())) == 3


@dataclass(frozen=True)
class Slow:
    """A policy that takes its time, listening or not."""

    seconds: float
    listens: bool

    @property
    def name(self) -> str:
        return "Slow"

    def begin(self, problem: Any, rng: Any) -> None:
        return None

    def act(self, outlook: Outlook, memory: None) -> tuple[np.ndarray, None]:
        until = time.perf_counter() + self.seconds
        while time.perf_counter() < until:
            if self.listens:
                outlook.check()
            time.sleep(0.001)
        return np.arange(outlook.problem.n)[::-1].copy(), None


@pytest.mark.parametrize("listens", [True, False])
def test_nobody_waits_for_a_slow_policy(listens: bool) -> None:
    """A policy that has no answer in time is not waited for, even if it never looks at the clock."""
    session = Session(Slow(1.5, listens), 0.1, prove=False)
    window = benefits_of(1, (2, 3, 4))
    expected = Session(HAA(), 0.1).step(window).assignment
    for _ in range(3):
        began = time.perf_counter()
        decision = session.step(window, budget_s=0.1)
        assert decision.status is Outcome.FALLBACK
        assert decision.assignment == expected
        assert time.perf_counter() - began < 1.4  # it did not wait for the policy to end


def test_errors_of_a_policy_come_out() -> None:
    """What a policy raises in its thread is raised by the call, and the session stays as it was."""

    class Wrong(Slow):
        def act(self, outlook: Outlook, memory: None) -> tuple[np.ndarray, None]:
            raise ZeroDivisionError("the policy is wrong")

    session = Session(Wrong(0.0, True), 0.1)
    with pytest.raises(ZeroDivisionError, match="the policy is wrong"):
        session.step(benefits_of(1, (2, 3, 4)), budget_s=10.0)
    assert session.steps == 0


def test_enough_time_changes_nothing() -> None:
    """With time to spare a session with a budget decides what one without it decides."""
    free, timed = Session(DualLookahead(3), SwitchingCost(0.3)), Session(DualLookahead(3), SwitchingCost(0.3))
    for k in range(3):
        window = benefits_of(k, (3, 3, 5))
        decision = timed.step(window, budget_s=60.0)
        assert decision.status is Outcome.COMPLETE
        assert decision.assignment == free.step(window).assignment


def test_frozen_steps_and_budgets_together() -> None:
    """Announced steps that are frozen stay so under any budget."""
    session = Session(DualLookahead(3), 0.1, announce=2)
    first = session.step(benefits_of(1, (3, 3, 5)))
    second = session.step(benefits_of(2, (3, 3, 5)), frozen=1, budget_s=0.0)
    assert second.assignment == first.plan[1]


def test_a_policy_without_a_way_on_is_not_needed() -> None:
    """Where the policy finds no way on, a session with a budget plays the step; without one the error comes out."""

    class Lost(Slow):
        def act(self, outlook: Outlook, memory: None) -> tuple[np.ndarray, None]:
            raise InfeasibleError("no way on")

    window = benefits_of(1, (2, 3, 4))
    decision = Session(Lost(0.0, True), 0.1).step(window, budget_s=10.0)
    assert decision.status is Outcome.FALLBACK
    assert decision.assignment == Session(HAA(), 0.1).step(window).assignment
    with pytest.raises(InfeasibleError, match="no way on"):
        Session(Lost(0.0, True), 0.1).step(window)


def test_bounds_of_windows_longer_than_the_policy_looks() -> None:
    """A window may be longer than what the policy looks at; its bound is one for all of it."""
    session = Session(DualLookahead(2), 0.1)
    for k in range(3):
        decision = session.step(benefits_of(k, (5, 3, 4)))
        assert decision.bound is not None
        assert decision.value <= decision.bound + 1e-9
