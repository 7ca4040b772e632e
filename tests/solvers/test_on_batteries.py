"""Solvers, bounds and certificates of problems with batteries: value <= exact <= bound, and no false claim passes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from batteries import random_case

from sapopt import SAP, Benefits, CertificateError, bound, certify, solve, verify
from sapopt.domains.constellation import WalkerShell
from sapopt.domains.power import power_constellation
from sapopt.dynamics import Battery
from sapopt.dynamics.paths.oracles import LocalOracle
from sapopt.formulations import network
from sapopt.problem.result import Status
from sapopt.proofs.plain import plain_bound, plain_value
from sapopt.solvers import HAA, DualDecomposition, DualLookahead, Exact
from sapopt.solvers.dual_decomposition.oracle_plans import OraclePlans

QUICK = DualDecomposition(iterations=80, rounds=2, sweeps=10, repricing=10)


def small(pay_for: Any = "moves", seed: int = 0) -> SAP:
    """24 satellites and 30 tasks over 25 steps."""
    shell = WalkerShell(4, 6, 58.0, 1200.0)
    return power_constellation(shell, 30, 25, seed, pay_for=pay_for).problem()


@pytest.mark.parametrize("seed", range(10))
def test_value_exact_bound(seed: int) -> None:
    """On tiny problems: every plan is worth at most the optimum, and every bound at least that."""
    problem = random_case(seed, steps=4, n=2, m=3).problem("sparse" if seed % 2 else "dense")
    exact = solve(problem, Exact(method="dp")).value
    proven = bound(problem)
    assert proven.value >= exact - 1e-9
    assert proven.value <= exact + 0.5 * abs(exact) + 1.0
    for solver in (DualLookahead(2), DualLookahead(4), QUICK):
        result = solve(problem, solver)
        assert result.value <= exact + 1e-9
        assert result.bound is None or result.bound >= exact - 1e-9
        if result.status == Status.OPTIMAL:
            assert result.value == pytest.approx(exact, abs=1e-4)


@pytest.mark.parametrize("seed", range(10))
def test_any_prices_prove_what_the_plain_states_say(seed: int) -> None:
    """The verifier's recursion is the plain dynamic programme, for all rules, starts and signs."""
    case = random_case(seed, steps=5, n=2, m=4)
    problem = case.problem("sparse")
    prices = np.random.default_rng(seed).exponential(0.4, (problem.T, problem.m))
    model = problem.model.local_model(problem.benefits, problem.initial_state())
    values, _ = LocalOracle(problem.benefits, model).best_paths(prices)
    assert plain_bound(problem, prices) == pytest.approx(values.sum() + prices.sum(), abs=1e-9)
    plan = solve(problem, HAA()).plan
    assert plain_value(problem, plan) == pytest.approx(case.score(plan), abs=1e-9)


@pytest.mark.parametrize("pay_for", ["moves", "entries"])
def test_near_the_bound(pay_for: str) -> None:
    """A small constellation: plans within 2 % of a bound that all agree on, and looking further pays."""
    problem = small(pay_for)
    planned = solve(problem, DualDecomposition(iterations=200, rounds=2, repricing=10))
    assert planned.gap is not None
    assert planned.gap < 0.02
    far = solve(problem, DualLookahead(12, iterations=20)).value
    assert 1.2 * solve(problem, HAA()).value < far <= planned.bound  # type: ignore[operator]
    again = solve(problem, DualDecomposition(iterations=1, rounds=0, sweeps=0), start=planned)
    assert again.value >= planned.value


def test_free_standing_is_worth_something() -> None:
    """Paying for every entry can only cost, for one plan and for the bound."""
    moves, entries = small("moves"), small("entries")
    plan = solve(moves, QUICK).plan
    assert entries.evaluate(plan).value < moves.evaluate(plan).value
    assert bound(entries).value < bound(moves).value


def test_certificates_verify_and_tampering_is_refused(tmp_path: Any) -> None:
    """A certificate survives its file; a better value, a lower bound, or another battery does not pass."""
    problem = small()
    certificate = certify(problem, solve(problem, QUICK))
    certificate.save(tmp_path / "c.npz")
    proven = verify(tmp_path / "c.npz", problem)
    assert proven.value == pytest.approx(certificate.value)
    assert proven.value <= proven.bound
    for change in (
        {"value": certificate.value + 0.01},
        {"bound": certificate.bound - 0.01},
        {"prices": certificate.prices * 0.5},
        {"plan": np.roll(certificate.plan, 1, axis=1)},
    ):
        with pytest.raises(CertificateError):
            verify(dataclasses.replace(certificate, **change), problem)
    for other in (Battery(0.5, drain=0.3), Battery(0.5, pay_for="entries"), Battery(0.5, initial_charge=0.9)):
        with pytest.raises(CertificateError, match="another problem"):
            verify(certificate, SAP(problem.benefits, other, problem.initial_assignment))


def test_no_spare_task() -> None:
    """As many tasks as agents: agents can only swap, and the rolling assignment does it."""
    rng = np.random.default_rng(2)
    benefits = np.where(rng.random((12, 8, 8)) < 0.3, rng.random((12, 8, 8)) * 2, 0.0)
    problem = SAP(benefits, Battery(0.3), rng.permutation(8))
    result = solve(problem, QUICK)
    assert result.value > solve(problem, HAA()).value
    assert result.gap is not None
    assert result.gap < 0.15


@pytest.mark.parametrize("seed", range(4))
def test_exact_by_network(seed: int) -> None:
    """The time-expanded network of the plain states has the optimum of brute force; a huge one is refused in time."""
    problem = random_case(seed, steps=3, n=2, m=3).problem()
    network, brute = (solve(problem, Exact(method=method)).value for method in ("network", "dp"))
    assert network == pytest.approx(brute, abs=1e-6)


def test_a_network_that_fits_no_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message names the method that does serve."""
    problem = power_constellation(steps=20).problem()
    monkeypatch.setattr("sapopt.formulations.network._MOST_ARCS", 100_000)
    with pytest.raises(ValueError, match="DualDecomposition"):
        network.formulate(problem)


def test_sweeps_without_a_placing_oracle_do_the_same() -> None:
    """The plain oracle, agent by agent, moves the agents as the compiled one does, but for ties."""
    problem = random_case(4, steps=6, n=3, m=5, negative=False).problem("sparse")
    state = problem.initial_state()
    prices = np.random.default_rng(0).random((6, 5)) * 0.3
    plan = solve(problem, HAA()).plan
    compiled = problem.model.path_oracle(problem.benefits, state)
    plain = LocalOracle(problem.benefits, problem.model.local_model(problem.benefits, state))
    values = [
        problem.evaluate(OraclePlans(problem, oracle).sweep(plan, prices, np.random.default_rng(1))).value
        for oracle in (compiled, plain)
    ]
    assert values[0] == pytest.approx(values[1], abs=1e-9)
    assert values[0] >= problem.evaluate(plan).value - prices.sum()


def test_forecasts_reach_the_battery() -> None:
    """A perfect forecast changes nothing."""
    problem = small()
    dense = Benefits(problem.benefits).dense()
    told = solve(problem, DualLookahead(3), forecast=lambda k, steps: dense[k : k + steps])
    assert told.value == pytest.approx(solve(problem, DualLookahead(3)).value, rel=1e-9)


def test_a_dynamics_without_local_states_is_refused() -> None:
    """The planner says what it needs."""
    from local_dynamics import Dictator

    with pytest.raises(ValueError, match="agent-local"):
        solve(SAP(np.ones((2, 2, 3)), Dictator()), DualDecomposition())
