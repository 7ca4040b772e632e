"""Outlook and rollout: what policies see, forecasts, and runs that end early with a whole feasible plan."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from strategies import FORMS, Instance, as_form, instances

from sapopt import SAP, Benefits, InfeasibleError, Outlook, Progress, Status, SwitchingCost, rollout, solve
from sapopt.data.windows import WindowSums
from sapopt.running.control import Run
from sapopt.running.outlook import Policy
from sapopt.solvers import HAA, HAAL, AssignmentPolicy, Greedy, NoHandover, myopic

POLICIES: tuple[Any, ...] = (
    HAA(),
    HAAL(2),
    HAAL(4),
    HAAL(3, "lookahead"),
    NoHandover(),
    Greedy(),
    AssignmentPolicy(myopic),
)
RNG = np.random.default_rng(0)
PROBLEM = SAP(RNG.random((8, 3, 5)), SwitchingCost(0.3), [4, 0, 2])


@dataclass(frozen=True)
class Scripted:
    """A policy that plays a function of the outlook, and counts its steps in its memory."""

    play: Callable[[Outlook, int], Any]
    name: str = "Scripted"

    def begin(self, problem: SAP, rng: np.random.Generator) -> int:
        return 0

    def act(self, outlook: Outlook, memory: int) -> tuple[Any, int]:
        return self.play(outlook, memory), memory + 1


# --- What a policy sees ---


@given(instances(forbid=True), st.data())
def test_windows(instance: Instance, data: st.DataObject) -> None:
    """Window sums count from the step they begin at, dense and sparse."""
    values = instance.benefits
    steps, n, m = values.shape
    first = data.draw(st.integers(0, 5))
    start = data.draw(st.integers(0, steps - 1))
    stop = data.draw(st.integers(start + 1, steps))
    expected = values[start:stop].sum(axis=0)
    entry = expected - 0.5 * (values[start] > 0)
    for form in FORMS:
        windows = WindowSums(Benefits(as_form(values, form)), first)
        assert windows.end == first + steps
        np.testing.assert_array_equal(windows.dense(first + start, first + stop), expected)
        for cost, sums in ((0.0, expected), (0.5, entry)):
            rows = windows.gains(first + start, first + stop, cost)
            found = np.zeros((n, m))
            for i in range(n):
                row = slice(rows.row_start[i], rows.row_start[i + 1])
                found[i, rows.tasks[row]] = rows.gains[row]
                keys = list(zip(-rows.gains[row], rows.tasks[row], strict=True))
                assert keys == sorted(keys), "rows are sorted by decreasing gain, then by task"
            np.testing.assert_allclose(found, sums, rtol=0, atol=1e-12)
            assert rows.has_negative == bool((found < 0).any())


def test_windows_forget() -> None:
    """What starts before a step is dropped; the rest is not computed again."""
    windows = WindowSums(Benefits(np.ones((4, 1, 1))))
    late = windows.gains(2, 3, 0.0)
    windows.gains(0, 2, 0.0)
    windows.dense(0, 2)
    windows.forget(before=1)
    assert windows.gains(2, 3, 0.0) is late
    assert list(windows._gains) == [(2, 3, 0.0)]
    assert windows._dense == {}


def test_what_a_policy_is_shown() -> None:
    """Step, end, state and memory at every step; benefits are cut at the horizon."""
    seen = []

    def play(outlook: Outlook, memory: int) -> Any:
        ahead = outlook.benefits(3)
        np.testing.assert_array_equal(ahead.dense(), PROBLEM.benefits.dense()[outlook.k : outlook.k + 3])
        np.testing.assert_array_equal(outlook.beta_hat(), PROBLEM.beta_hat(outlook.k, outlook.state))
        seen.append((outlook.k, outlook.end, memory, ahead.shape[0], outlook.state.tolist()))
        return np.roll([0, 1, 2], outlook.k)

    played = rollout(PROBLEM, Scripted(play))
    states = [[4, 0, 2]] + [np.roll([0, 1, 2], k).tolist() for k in range(7)]
    assert seen == [(k, 8, k, min(3, 8 - k), states[k]) for k in range(8)]
    assert played.status is Status.FEASIBLE
    assert isinstance(Scripted(play), Policy)


def test_the_trace_adds_up() -> None:
    """One record per step with equal keys; the values are those of the evaluation."""
    for policy in POLICIES:
        result = solve(PROBLEM, policy)
        score = result.evaluation
        assert [record["step"] for record in result.trace] == list(range(8))
        assert len({tuple(record) for record in result.trace}) == 1
        np.testing.assert_allclose(
            [r["value"] for r in result.trace], score.benefit + score.handover, atol=1e-12
        )
        assert result.trace[-1]["total"] == pytest.approx(result.value, abs=1e-9)
        assert all(r["seconds"] >= 0 for r in result.trace)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ([0, 0, 1], "task 0 is given to agents 0, 1 at step 0"),
        ([0, 1, 7], r"task 7 of agent 2 at step 0 is outside 0\.\.4"),
        ([0, 1], "at step 0"),
        (3, "at step 0"),
        ([0.5, 1.0, 2.0], "at step 0"),
        (None, "at step 0"),
    ],
)
def test_bad_answers_of_a_policy(answer: Any, message: str) -> None:
    """What a policy answers is checked at the step where it answers."""
    with pytest.raises(ValueError, match=message):
        solve(PROBLEM, Scripted(lambda outlook, memory: answer))


# --- Forecasts ---


@given(instances(forbid=True), st.sampled_from(FORMS))
def test_a_perfect_forecast_is_the_true_run(instance: Instance, form: str) -> None:
    """Told the truth in any form step by step, every policy plays as with the benefits themselves."""
    problem = instance.problem(form)
    values = instance.benefits
    for policy in POLICIES:
        forecast = solve(problem, policy, forecast=lambda k, steps: as_form(values[k : k + steps], form))
        np.testing.assert_array_equal(forecast.plan, solve(problem, policy).plan)


def test_forecasts_are_asked_for_the_rest() -> None:
    """At every step once, for all steps that are left."""
    asked = []

    def forecast(k: int, steps: int) -> np.ndarray:
        asked.append((k, steps))
        return PROBLEM.benefits.dense()[k:]

    solve(PROBLEM, HAAL(3), forecast=forecast)
    assert asked == [(k, 8 - k) for k in range(8)]


def test_short_horizons() -> None:
    """A forecast of fewer steps is fine: HAAL cannot look further than it, and one step makes it HAA."""
    values = PROBLEM.benefits.dense()
    for reach in (1, 2, 3):
        near = solve(PROBLEM, HAAL(5), forecast=lambda k, steps, reach=reach: values[k : k + reach])
        np.testing.assert_array_equal(near.plan, solve(PROBLEM, HAAL(reach)).plan)


def test_wrong_forecasts_are_played_on_the_truth() -> None:
    """Plans come from the forecast, values from the true benefits."""
    wrong = np.random.default_rng(1).random((8, 3, 5))
    imagined = SAP(wrong, PROBLEM.dynamics, PROBLEM.initial_assignment)
    for policy in POLICIES:
        result = solve(PROBLEM, policy, forecast=lambda k, steps: wrong[k:])
        np.testing.assert_array_equal(result.plan, solve(imagined, policy).plan)
        assert result.value == PROBLEM.evaluate(result.plan).value


def test_forecasts_change_their_mind() -> None:
    """What was forecast for a step at an earlier one is not used any more."""

    def forecast(k: int, steps: int) -> np.ndarray:
        return np.random.default_rng(k).random((steps, 3, 5))

    result = solve(PROBLEM, HAAL(3), forecast=forecast)
    state = PROBLEM.initial_assignment
    for k in range(8):
        fresh = solve(SAP(forecast(k, 8 - k), PROBLEM.dynamics, state), HAAL(3))
        np.testing.assert_array_equal(result.plan[k], fresh.plan[0])
        state = result.plan[k]


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.ones((8, 3, 4)), r"forecast\(0, 8\) returned shape \(8, 3, 4\), expected \(1\.\.8, 3, 5\)"),
        (np.ones((8, 5, 3)), r"expected \(1\.\.8, 3, 5\)"),
        (np.ones((9, 3, 5)), r"expected \(1\.\.8, 3, 5\)"),
        (np.ones((3, 5)), "three axes"),
        (np.ones((0, 3, 5)), "three positive"),
        (np.full((8, 3, 5), np.nan), "NaN"),
        (None, "three axes"),
        ([sp.csr_array((3, 4))] * 8, r"returned shape \(8, 3, 4\)"),
    ],
)
def test_bad_forecasts(answer: Any, message: str) -> None:
    """A forecast of a wrong shape or with bad values is a ValueError."""
    with pytest.raises(ValueError, match=message):
        solve(PROBLEM, HAA(), forecast=lambda k, steps: answer)


def test_a_forecast_without_an_assignment() -> None:
    """A forecast that forbids everything is reported with its step."""
    values = np.ones((3, 2, 3))

    def forecast(k: int, steps: int) -> np.ndarray:
        return values[k:] if k < 1 else np.full((steps, 2, 3), -np.inf)

    for policy in (HAA(), HAAL(2), Greedy(), NoHandover()):
        with pytest.raises(InfeasibleError, match="step 1: no full assignment exists"):
            solve(SAP(values), policy, forecast=forecast)


# --- Runs that end early ---


def stop_at(step: int) -> Callable[[Progress], bool]:
    """A callback that ends the run after a step."""
    return lambda progress: progress.done >= step


def interrupt_at(step: int) -> Callable[[Progress], None]:
    """A callback in which the user presses Ctrl-C."""

    def press(progress: Progress) -> None:
        if progress.done >= step:
            raise KeyboardInterrupt

    return press


@pytest.mark.parametrize("end", [stop_at, interrupt_at])
@pytest.mark.parametrize("step", range(1, 8))
def test_ended_by_the_user(end: Any, step: int) -> None:
    """The steps that were decided stay, the last assignment is kept for the rest, and the status says so."""
    whole = solve(PROBLEM, HAAL(2))
    cut = solve(PROBLEM, HAAL(2), callback=end(step))
    assert cut.status is Status.INTERRUPTED
    assert len(cut.trace) == step
    np.testing.assert_array_equal(cut.plan[:step], whole.plan[:step])
    np.testing.assert_array_equal(cut.plan[step:], np.repeat(whole.plan[step - 1 : step], 8 - step, axis=0))
    assert cut.value == PROBLEM.evaluate(cut.plan).value


def test_stopped_at_the_last_step() -> None:
    """A run that is told to stop when nothing is left to do has run to its end."""
    assert solve(PROBLEM, HAA(), callback=stop_at(8)).status is Status.FEASIBLE
    cut = solve(PROBLEM, HAA(), callback=interrupt_at(8))
    np.testing.assert_array_equal(cut.plan, solve(PROBLEM, HAA()).plan)


def test_other_errors_pass() -> None:
    """An error in a callback or a policy is not swallowed."""

    def fail(progress: Progress) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        solve(PROBLEM, HAA(), callback=fail)


def test_time_limit() -> None:
    """When the time is up the plan is whole, its first steps are those of the full run, and the rest is HAA's."""

    def slow(outlook: Outlook, memory: int) -> Any:
        time.sleep(0.01)
        return outlook.assign(outlook.beta_hat())

    problem = SAP(RNG.random((200, 3, 5)), 0.3)
    cut = solve(problem, Scripted(slow), time_limit=0.1)
    done = len(cut.trace)
    assert cut.status is Status.TIME_LIMIT
    assert 0 < done <= 10
    assert cut.runtime < 1.0
    np.testing.assert_array_equal(cut.plan, solve(problem, HAA()).plan)


def test_no_time_at_all() -> None:
    """Without time for a single step agents keep the initial assignment, or take the first step's best without one."""
    for initial, first in (([4, 0, 2], [4, 0, 2]), (None, None)):
        problem = SAP(PROBLEM.benefits, 0.3, initial)
        cut = solve(problem, HAAL(6), time_limit=1e-12)
        assert (cut.status, cut.trace) == (Status.TIME_LIMIT, [])
        expected = solve(problem, HAA()).plan[0] if first is None else first
        np.testing.assert_array_equal(cut.plan, np.tile(expected, (8, 1)))


def test_enough_time() -> None:
    """A limit that is not reached changes nothing."""
    assert solve(PROBLEM, HAAL(2), time_limit=1e6).status is Status.FEASIBLE


@given(instances(forbid=True), st.data())
def test_ended_among_forbidden_pairs(instance: Instance, data: st.DataObject) -> None:
    """Where the last assignment becomes forbidden, the rest of the plan gives way to it: always whole and feasible."""
    problem = instance.problem(data.draw(st.sampled_from(FORMS)))
    end = data.draw(st.sampled_from([stop_at, interrupt_at]))
    step = data.draw(st.integers(1, problem.T))
    cut = solve(problem, HAA(), callback=end(step))
    np.testing.assert_array_equal(cut.plan[:step], solve(problem, HAA()).plan[:step])
    assert np.isfinite(instance.score(cut.plan))
    assert np.isfinite(instance.score(solve(problem, HAA(), time_limit=1e-12).plan))


# --- User-defined dynamics ---


@dataclass(frozen=True)
class Tired:
    """Who worked (tasks 0 and 1) two steps in a row must rest; the state is no previous assignment."""

    n: int
    m: int

    def initial_state(self, problem: SAP) -> tuple[int, ...]:
        return (0,) * self.n

    def handover(self, k: int, state: Any) -> np.ndarray:
        eta = np.zeros((self.n, self.m))
        eta[np.array(state) >= 2, :2] = -np.inf
        return eta

    def transition(self, k: int, state: Any, assignment: np.ndarray) -> tuple[int, ...]:
        return tuple(s + 1 if j < 2 else 0 for s, j in zip(state, assignment, strict=True))


TIRED = SAP(np.where(np.arange(6) < 2, 1.0 + RNG.random((7, 3, 6)), 0.1 * RNG.random((7, 3, 6))), Tired(3, 6))


@pytest.mark.parametrize("policy", POLICIES, ids=lambda p: p.name)
def test_policies_on_user_dynamics(policy: Any) -> None:
    """Policies that look at the state keep within it; the value is that of the plan."""
    if isinstance(policy, NoHandover):
        with pytest.raises(ValueError, match="may not take"):
            solve(TIRED, policy)
        return
    result = solve(TIRED, policy)
    work = result.plan < 2
    assert work.any()
    assert not (work[2:] & work[1:-1] & work[:-2]).any()


def test_haa_on_user_dynamics_is_stepwise_best() -> None:
    """HAA takes the best assignment of beta_hat at every step of any dynamics."""
    state = TIRED.initial_state()
    for k, row in enumerate(solve(TIRED, HAA()).plan):
        beta_hat = TIRED.beta_hat(k, state)
        assert beta_hat[np.arange(3), row].sum() == pytest.approx(
            beta_hat[np.arange(3), _best(beta_hat)].sum()
        )
        state = TIRED.transition(k, state, row)


def _best(matrix: np.ndarray) -> np.ndarray:
    from scipy.optimize import linear_sum_assignment

    columns: np.ndarray = linear_sum_assignment(matrix, maximize=True)[1]
    return columns


@pytest.mark.parametrize("end", [stop_at, interrupt_at])
@pytest.mark.parametrize("step", range(1, 8))
def test_ended_on_user_dynamics(end: Any, step: int) -> None:
    """The rest of a plan that is cut off obeys the state, wherever the interruption strikes."""
    cut = solve(TIRED, HAA(), callback=end(step))
    np.testing.assert_array_equal(cut.plan[:step], solve(TIRED, HAA()).plan[:step])


def test_a_run_may_be_handed_in() -> None:
    """rollout alone takes the controls as a Run."""
    played = rollout(PROBLEM, HAA(), Run(callback=stop_at(3)))
    assert played.status is Status.INTERRUPTED
    assert played.plan.shape == (8, 3)
    assert rollout(PROBLEM, HAA()).status is Status.FEASIBLE
