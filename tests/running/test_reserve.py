"""Runs of policies under a time limit: never worth less than HAA's plan, and left alone where they end in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from every_solver import EVERY, by_name, on_ring, problem_for
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, Limit, Status, SwitchingCost, rollout, solve
from sapopt.data.matrices import GainMatrix
from sapopt.dynamics import Battery
from sapopt.running.control import Run
from sapopt.running.outlook import Outlook, Policy
from sapopt.running.reserve import Reserve
from sapopt.solvers import HAA, HAAL, DualLookahead, Greedy, NoHandover, RolloutPolicy
from sapopt.solvers.base import untaken
from sapopt.solvers.names import NamedSolver

TICK = 1e-3
POLICIES = [named for named in EVERY if isinstance(named.solver, Policy)]


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """A clock that goes on at every look, so that a time limit cuts runs at the same place on every machine."""
    clock = Clock()
    monkeypatch.setattr("sapopt.kernels.clock.time.perf_counter", clock)
    return clock


class Clock:
    """Seconds, one tick more at every look."""

    now = 0.0

    def __call__(self) -> float:
        self.now += TICK
        return self.now

    def taken(self, work: Callable[[], Any]) -> float:
        """Seconds that some work takes."""
        began = self.now
        work()
        return self.now - began


@dataclass(frozen=True)
class Worst:
    """The worst assignment of every step, after a number of looks at the clock."""

    looks: int
    name: str = "Worst"

    def begin(self, problem: SAP, rng: np.random.Generator) -> None:
        """Nothing to remember."""

    def act(self, outlook: Outlook, memory: None) -> Any:
        """Look, and choose badly."""
        for _ in range(self.looks):
            outlook.check()
        matrix = outlook.beta_hat()
        matrix = matrix.toarray() if isinstance(matrix, GainMatrix) else matrix
        return outlook.assign(-np.where(np.isfinite(matrix), matrix, 99.0)), None


class Rested:
    """Who worked (tasks 0 and 1) two steps in a row must rest: a state of all agents that is no assignment."""

    def initial_state(self, problem: SAP) -> tuple[int, ...]:
        """Nobody has worked."""
        return (0,) * problem.n

    def handover(self, k: int, state: Any) -> np.ndarray:
        """Forbidden work."""
        eta = np.zeros((len(state), 7))
        eta[np.array(state) >= 2, :2] = -np.inf
        return eta

    def transition(self, k: int, state: Any, assignment: np.ndarray) -> tuple[int, ...]:
        """Count the steps of work."""
        return tuple(s + 1 if j < 2 else 0 for s, j in zip(state, assignment, strict=True))


def benefits(seed: int, steps: int = 12) -> np.ndarray:
    """Some benefits of five agents and seven tasks."""
    return np.random.default_rng(seed).random((steps, 5, 7))


def kinds(seed: int) -> dict[str, SAP]:
    """Problems of every kind that policies meet."""
    values = benefits(seed)
    return {
        "plain": SAP(values, SwitchingCost(0.4)),
        "begun": SAP(values, SwitchingCost(0.4), [6, 5, 4, 3, 2]),
        "matrix": SAP(values, SwitchingCost(np.abs(np.subtract.outer(np.arange(7), np.arange(7))) / 7)),
        "capacity": SAP(values, SwitchingCost(0.4), capacity=2),
        "idle": SAP(values, SwitchingCost(0.4), idle=True),
        "limits": SAP(values, SwitchingCost(0.4), idle=True, limits=[Limit.work(at_most=8)]),
        "battery": SAP(values, Battery(0.4)),
        "joint state": SAP(values, Rested()),
    }  # fmt: skip


@pytest.mark.parametrize("share", [0.15, 0.4, 0.8])
@pytest.mark.parametrize("named", POLICIES, ids=by_name)
def test_never_worth_less_than_haa(named: NamedSolver, share: float, ticking: Clock) -> None:
    """Whatever the policy, a run that is cut short is worth HAA's plan at least, and keeps its limit."""
    problem = problem_for(named, benefits(3))
    solver = on_ring(named, problem.n)
    floor = solve(problem, HAA()).value
    limit = share * ticking.taken(lambda: solve(problem, solver, time_limit=1e6))
    if solve(problem, HAA(), time_limit=limit).status is not Status.FEASIBLE:
        return  # it does not fit in itself
    taken = ticking.taken(lambda: check(problem, solver, limit, floor))
    assert taken <= limit + 100 * TICK


def check(problem: SAP, solver: Any, limit: float, floor: float) -> None:
    """A run is whole, honest about its end, and not worth less than HAA's plan."""
    result = solve(problem, solver, time_limit=limit)
    assert result.value == problem.evaluate(result.plan).value
    if result.status is not Status.FEASIBLE:
        assert result.status is Status.TIME_LIMIT
        assert result.value >= floor - 1e-9


SLOW = [HAAL(5), RolloutPolicy(HAA(), [Greedy()]), DualLookahead(4), Worst(60)]


@pytest.mark.parametrize("kind", kinds(0))
@pytest.mark.parametrize("solver", SLOW, ids=lambda solver: solver.name)
def test_every_kind_of_problem(kind: str, solver: Any, ticking: Clock) -> None:
    """The same with matrices of costs, capacities, idleness, limits, batteries, and a state that is no assignment."""
    for seed in range(3):
        problem = kinds(seed)[kind]
        if isinstance(solver, DualLookahead) and kind == "joint state":
            return
        if isinstance(solver, Worst) and untaken(problem, solver):
            return
        floor = solve(problem, HAA()).value
        for limit in (150 * TICK, 300 * TICK):
            check(problem, solver, limit, floor)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(2, 400))
def test_wherever_the_time_ends(seed: int, ticks: int) -> None:
    """However short the time: the plan is whole; with time enough for HAA it is worth HAA's at least."""
    problem = SAP(benefits(seed), 0.5)
    floor = solve(problem, HAA()).value
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sapopt.kernels.clock.time.perf_counter", Clock())
        cut = solve(problem, Worst(50), time_limit=ticks * TICK)
    assert cut.value == problem.evaluate(cut.plan).value
    if ticks >= 100:
        assert cut.value >= floor - 1e-9


def test_the_rest_is_played_by_haa(ticking: Clock) -> None:
    """Steps that were decided well stay; HAA goes on from there."""
    problem = SAP(benefits(1), 0.5)
    whole = solve(problem, HAAL(6))
    limit = 0.5 * ticking.taken(lambda: solve(problem, HAAL(6), time_limit=1e6))
    cut = solve(problem, HAAL(6), time_limit=limit)
    done = len(cut.trace)
    assert 0 < done < problem.T
    np.testing.assert_array_equal(cut.plan[:done], whole.plan[:done])
    rest = SAP(problem.benefits.slice(done, problem.T), 0.5, cut.plan[done - 1])
    np.testing.assert_array_equal(cut.plan[done:], solve(rest, HAA()).plan)


def test_haa_in_its_place(ticking: Clock, caplog: pytest.LogCaptureFixture) -> None:
    """Where what was decided is worth less, HAA's whole plan is returned, and the log says so."""
    problem = SAP(benefits(1), 0.5)
    cut = solve(problem, Worst(50), time_limit=300 * TICK)
    assert len(cut.trace) > 0
    assert cut.status is Status.TIME_LIMIT
    np.testing.assert_array_equal(cut.plan, solve(problem, HAA()).plan)
    assert "HAA's plan is worth more" in caplog.text


def test_a_policy_in_time_is_left_alone(ticking: Clock) -> None:
    """It is never replaced, however bad it is, and costs no step of HAA."""
    problem = SAP(benefits(1), 0.5)
    alone = solve(problem, NoHandover())
    assert alone.value < solve(problem, HAA()).value
    free = ticking.taken(lambda: rollout(problem, Worst(20), Run(time_limit=1e6)))
    played = rollout(problem, Worst(20), Run(time_limit=1.3 * free))
    assert played.status is Status.FEASIBLE
    np.testing.assert_array_equal(played.plan, rollout(problem, Worst(20)).plan)
    np.testing.assert_array_equal(solve(problem, NoHandover(), time_limit=1e6).plan, alone.plan)


def test_what_is_kept_back(ticking: Clock) -> None:
    """Nothing while the policy is not late; then time for HAA's steps, which the policy's allowance leaves alone."""
    problem = SAP(benefits(1), 0.5)
    reserve = Reserve(problem, Run(time_limit=1000 * TICK))
    reserve.check()
    assert (reserve.plan, reserve.kept_back) == (None, 0.0)
    ticking.now += 300 * TICK
    reserve.check()
    assert reserve.plan is not None
    np.testing.assert_array_equal(reserve.plan, solve(problem, HAA()).plan)
    assert 0.0 < reserve.kept_back < 200 * TICK
    reserve.done = 6
    later = reserve.kept_back
    assert reserve.allowance * 6 == pytest.approx(reserve.run.seconds_left - later, abs=3 * TICK)
    unlimited = Reserve(problem, Run())
    unlimited.check()
    assert (unlimited.plan, unlimited.kept_back, unlimited.allowance) == (None, 0.0, np.inf)


def test_forecasts_are_not_second_guessed(ticking: Clock) -> None:
    """Which plan is worth more on the truth is not known while it is played: the policy's steps stay.

    HAA goes on by the forecast too, and where that forbids everything, the last assignment is kept.
    """
    problem = SAP(benefits(1), 0.5)
    wrong = benefits(2)
    cut = solve(problem, Worst(50), time_limit=300 * TICK, forecast=lambda k, steps: wrong[k : k + steps])
    done = len(cut.trace)
    assert 0 < done < 11
    np.testing.assert_array_equal(cut.plan[:done], solve(SAP(wrong, 0.5), Worst(0)).plan[:done])
    rest = SAP(wrong[done:], 0.5, cut.plan[done - 1])
    np.testing.assert_array_equal(cut.plan[done:], solve(rest, HAA()).plan)

    def closed(k: int, steps: int) -> np.ndarray:
        return wrong[k : k + steps] if k < done else np.full((steps, 5, 7), -np.inf)

    cut = solve(problem, Worst(50), time_limit=300 * TICK, forecast=closed)
    np.testing.assert_array_equal(cut.plan[done:], np.repeat(cut.plan[done - 1 : done], 12 - done, axis=0))
