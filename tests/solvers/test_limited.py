"""Solvers, bounds and certificates of problems with capacities, idleness, limits and teams, against brute force."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from sapopt import (
    SAP,
    CertificateError,
    InfeasibleError,
    Limit,
    Status,
    Team,
    bound,
    certify,
    solve,
    verify,
    why_not,
)
from sapopt.solvers import (
    HAA,
    HAAL,
    DistributedDualLookahead,
    DualDecomposition,
    DualLookahead,
    Exact,
    Greedy,
    MyopicGreedy,
    NoHandover,
)
from tests.limited_problems import LOCAL, Tiny, tiny
from tests.local_dynamics import Dictator

POLICIES = (
    HAA(),
    HAAL(2),
    HAAL(3, keep_plan=True),
    Greedy(),
    MyopicGreedy(),
    NoHandover(),
    DualLookahead(2, 6),
)


def check(case: Tiny) -> None:
    """Optimum, bound, certificate and plans of one problem."""
    best, plan = case.optimum()
    problem = case.problem
    if plan is None:
        with pytest.raises(InfeasibleError, match=r"no plan|no way"):
            solve(problem, Exact())
        return
    assert bound(problem).value >= best - 1e-11
    exact = solve(problem, Exact())
    assert exact.status is Status.OPTIMAL
    assert exact.value == pytest.approx(best, abs=1e-6)
    decomposed = solve(problem, DualDecomposition())
    assert decomposed.value >= best - 1e-4 * max(1.0, abs(best))
    if type(problem.dynamics).__name__ != "Tiring":  # which has no fingerprint
        certificate = certify(problem, exact)
        assert certificate.value <= best + 1e-11
        assert certificate.bound >= best - 1e-11
        verify(certificate, problem)


def check_pairs(case: Tiny) -> None:
    """Whatever `why_not` proves about a pair is true of every plan that has it."""
    problem = case.problem
    best: dict[tuple[int, int, int], float] = {}
    for plan in case.plans():
        value = case.value(plan)
        if value is not None:
            for k, row in enumerate(plan):
                for i, j in enumerate(row):
                    best[i, j, k] = max(best.get((i, j, k), -np.inf), value)
    if not best:
        return
    result = solve(problem, DualDecomposition())
    for i, j, k in itertools.product(range(problem.n), range(problem.m), range(problem.T)):
        told = why_not(problem, result, i, j, k)
        assert told.bound >= best.get((i, j, k), -np.inf) - 1e-11
        assert str(told)


def check_policies(case: Tiny) -> None:
    """Policies never break a limit; where they cannot go on, they say which limit is in the way."""
    best, _ = case.optimum()
    for policy in POLICIES:
        try:
            result = solve(case.problem, policy)
        except ValueError as error:
            assert any(word in str(error) for word in ("limit", "assignment", "agent-local"))  # noqa: PT017  # often there is no error
            continue
        value = case.value(result.plan.tolist())
        assert value is not None
        assert result.value == pytest.approx(value, abs=1e-8)
        assert value <= best + 1e-9


@pytest.mark.parametrize("seed", range(35))
def test_against_brute_force(seed: int) -> None:
    """Optimum, bound and certificate agree with trying every plan."""
    case = tiny(np.random.default_rng(seed), LOCAL[seed % len(LOCAL)], 200)
    if case is not None:
        check(case)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1000, 4000, 100))
def test_thousands_against_brute_force(first: int) -> None:
    """The same for 3000 problems, of which some cannot be built."""
    for seed in range(first, first + 100):
        case = tiny(np.random.default_rng(seed), LOCAL[seed % len(LOCAL)], 600)
        if case is not None:
            check(case)


@pytest.mark.parametrize("seed", range(14))
def test_why_not_against_brute_force(seed: int) -> None:
    """The bound on plans with a pair holds for all of them."""
    case = tiny(np.random.default_rng(seed), LOCAL[seed % len(LOCAL)], 100)
    if case is not None:
        check_pairs(case)


def test_why_not_of_a_plain_problem() -> None:
    """It needs no limits; the words name who holds the task, and a pair of the plan is told as such."""
    problem = SAP([[[2.0, 0.0], [1.5, 0.0]]], 0.0, agents=["a", "b"])
    told = why_not(problem, solve(problem, Exact()), "b", 0, 0)
    # The best plan with the pair is worth 1.5; which of the optimal prices are known decides how near to it one gets.
    assert 1.5 <= told.bound <= told.value
    assert told.holders == (0,)
    assert told.is_settled
    assert "held by agent 'a'" in str(told)
    assert (
        str(why_not(problem, solve(problem, Exact()), "a", 0, 0))
        == "The plan has agent 'a' on task 0 at step 0."
    )
    with pytest.raises(ValueError, match="step: 5 is outside"):
        why_not(problem, solve(problem, Exact()), 0, 0, 5)


@pytest.mark.parametrize("seed", range(40))
def test_policies_stay_within_limits(seed: int) -> None:
    """Greedy, HAA, HAAL and the rest, on every kind of dynamics, a global one too."""
    case = tiny(np.random.default_rng(seed), (*LOCAL, "dictator")[seed % (len(LOCAL) + 1)], 200)
    if case is not None:
        check_policies(case)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1000, 4000, 100))
def test_policies_stay_within_limits_thousands(first: int) -> None:
    """The same for 3000 problems."""
    for seed in range(first, first + 100):
        case = tiny(np.random.default_rng(seed), (*LOCAL, "dictator")[seed % (len(LOCAL) + 1)], 300)
        if case is not None:
            check_policies(case)


def test_contradicting_limits_are_named() -> None:
    """An infeasible problem is refused with the limits that stand against each other, and with none that does not."""
    limits = [
        Limit.work(0, at_least=3, name="busy"),
        Limit.once([0, 1], 1, name="look"),
        Limit.handovers(9, name="calm"),
    ]
    problem = SAP(np.ones((4, 1, 2)), 0.0, idle=True, limits=limits)
    with pytest.raises(InfeasibleError, match=r"busy\[0\] \(at_least=3\)") as told:
        solve(problem, Exact())
    assert "look[0]" in str(told.value)
    assert "calm" not in str(told.value)


def test_a_solver_that_cannot_says_so() -> None:
    """A solver without the capability is refused before it starts, by name."""
    problem = SAP(np.ones((2, 2, 2)), 0.0, capacity=2, limits=[Limit.once()])
    with pytest.raises(
        ValueError, match=r"DistributedDual.* does not take problems with capacity and limits"
    ):
        solve(problem, DistributedDualLookahead(2))
    with pytest.raises(ValueError, match=r"Exact\(milp\) does not take"):
        solve(problem, Exact("milp"))
    with pytest.raises(ValueError, match=r"not agent-local|local_model"):
        bound(SAP(np.ones((2, 2, 2)), Dictator(), capacity=2))


def test_a_policy_refuses_what_takes_several_steps() -> None:
    """A hard limit that needs work over the horizon is for planners; with a penalty a policy pays."""
    needs = Limit.work(0, at_least=1)
    with pytest.raises(ValueError, match=r"'work\[0\]' needs something done over several steps"):
        solve(SAP(np.ones((2, 2, 2)), 0.0, limits=[needs]), HAA())
    assert (
        solve(SAP(np.ones((2, 2, 2)), 0.0, limits=[Limit.work(0, at_least=1, penalty=3)]), HAA()).value == 4.0
    )


def test_covers_are_met_step_by_step() -> None:
    """A policy leaves what it gains more from, where a cover of the step needs it."""
    benefits = np.zeros((3, 2, 3))
    benefits[:, :, 1:] = 1.0
    result = solve(SAP(benefits, 0.1, limits=[Limit.cover([0], 1)]), HAA())
    assert (result.plan == 0).sum(axis=1).tolist() == [1, 1, 1]


def test_changed_certificates_fail() -> None:
    """A multiplier above a penalty, a better bound, and another problem's limits are refused."""
    rng = np.random.default_rng(0)
    limits = [Limit.once(penalty=0.3), Team(0, 2, 0.4)]
    problem = SAP(rng.random((3, 2, 2)), 0.2, capacity=2, idle=True, limits=limits)
    certificate = certify(problem, solve(problem, Exact()))
    with pytest.raises(CertificateError, match="prove a bound"):
        verify(dataclasses.replace(certificate, bound=certificate.bound - 1e-3), problem)
    with pytest.raises(CertificateError, match="above the penalty"):
        verify(dataclasses.replace(certificate, limit_prices=np.full(2, 0.31)), problem)
    with pytest.raises(CertificateError, match="another problem"):
        verify(
            certificate, SAP(problem.benefits, 0.2, capacity=2, idle=True, limits=[Limit.once(penalty=0.4)])
        )
