"""Batteries: the rules against exact fractions, charges that never drift, death, files, intervals, local states."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from batteries import Case, cases, random_case
from hypothesis import given
from hypothesis import strategies as st
from strategies import as_form, plans_of

from sapopt import SAP, Benefits, solve
from sapopt.data.benefits import dense_step
from sapopt.data.matrices import GainMatrix
from sapopt.data.windows import WindowSums
from sapopt.dynamics import Battery
from sapopt.dynamics.paths.oracles import LocalModel, LocalOracle
from sapopt.solvers import HAA, HAAL, Exact


@given(cases(), st.data(), st.sampled_from(["dense", "sparse"]))
def test_value_and_charges_follow_the_rules(case: Case, data: st.DataObject, form: str) -> None:
    """Plans are worth what the rules say, and levels are the exact charges at every step."""
    plan = data.draw(plans_of(case.benefits.shape))
    problem = case.problem(form)
    assert problem.evaluate(plan).value == pytest.approx(case.score(plan), abs=1e-9)
    state = problem.initial_state()
    levels = np.array([case.walk(i, plan[:, i])[1] for i in range(problem.n)]).T
    agents = np.arange(problem.n)
    for k in range(problem.T):
        eta = problem.handover(k, state)
        np.testing.assert_allclose(
            problem.model.handover_at(k, state, plan[k]), eta[agents, plan[k]], atol=1e-12
        )
        assert eta.max() <= problem.dynamics.handover_limit
        state = problem.transition(k, state, plan[k])
        assert [int(x) * problem.dynamics.units.unit for x in state.levels] == levels[k].tolist()


def test_levels_never_drift() -> None:
    """Thousands of uses and charges of 0.2 and 0.1 end at the very charge that fractions give."""
    rng = np.random.default_rng(0)
    steps = 3000
    benefits = (rng.random((steps, 1, 1)) < 0.33).astype(float)
    problem = SAP(benefits, Battery(0.5), [0])
    state, charge = problem.initial_state(), Fraction(1)
    for k in range(steps):
        if charge > 0:
            charge += Fraction(-1, 5) if benefits[k, 0, 0] else Fraction(1, 10)
            charge = min(max(charge, Fraction(0)), Fraction(1))
        state = problem.transition(k, state, np.array([0]))
        assert int(state.levels[0]) * problem.dynamics.units.unit == charge
        assert problem.dynamics.charge_of(state)[0] == pytest.approx(float(charge), abs=1e-15)


def test_five_uses_empty_the_battery_and_dead_stays_dead() -> None:
    """No sixth use by a residue of rounding; nothing is earned or charged after it, and nothing is paid."""
    benefits = np.zeros((10, 1, 2))
    benefits[:6, 0, 0] = 1.0
    benefits[8:, 0, :] = 7.0
    evaluation = SAP(benefits, Battery(0.5), [0]).evaluate([[0]] * 8 + [[1]] * 2)
    np.testing.assert_array_equal(evaluation.benefit + evaluation.handover, [1.0] * 5 + [0.0] * 5)


def test_entries_pay_where_moves_do_not() -> None:
    """Idling on a task before it is worth anything saves the cost under one rule only."""
    benefits = np.array([[[0.0, 0.0]], [[0.0, 2.0]], [[0.0, 2.0]], [[0.0, 0.0]], [[0.0, 2.0]]])
    plan = [[1]] * 5
    assert SAP(benefits, Battery(0.5), [0]).evaluate(plan).value == 6.0
    assert SAP(benefits, Battery(0.5, pay_for="entries"), [0]).evaluate(plan).value == 5.0


@pytest.mark.parametrize(
    ("options", "unit", "levels"),
    [
        ({}, Fraction(1, 10), (2, 1, 10)),
        ({"drain": 1 / 3, "charge": 0.25}, Fraction(1, 12), (4, 3, 12)),
        ({"drain": 0.0, "charge": 0.0}, Fraction(1), (0, 0, 1)),
        ({"initial_charge": 0.05}, Fraction(1, 20), (4, 2, 20)),
        ({"drain": 60, "charge": 40, "capacity": 300}, Fraction(20), (3, 2, 15)),
    ],
)
def test_the_unit_is_the_greatest_common_one(
    options: dict[str, float], unit: Fraction, levels: tuple[int, ...]
) -> None:
    """Of drain, charge, capacity and initial charges."""
    assert Battery(0.5, **options).units == (unit, *levels)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"cost": -1}, "cost"),
        ({"drain": -0.1}, "drain"),
        ({"charge": np.inf}, "charge"),
        ({"capacity": 0}, "capacity"),
        ({"capacity": [1, 2]}, "capacity"),
        ({"drain": 2**0.5 / 10}, "drain"),
        ({"drain": 0.0003}, "levels"),
        ({"pay_for": "all"}, "pay_for"),
        ({"initial_charge": 1.1}, "initial_charge"),
        ({"initial_charge": [[0.1]]}, "initial_charge"),
        ({"initial_charge": [0.1, 0.1]}, "initial_charge"),
    ],
)
def test_bad_arguments_are_named(options: dict[str, object], name: str) -> None:
    """Every error tells which argument to mend."""
    with pytest.raises(ValueError, match=name):
        SAP(np.ones((2, 1, 2)), Battery(**({"cost": 0.5} | options)))  # type: ignore[arg-type]


def test_an_unbound_battery_says_so() -> None:
    """Asked for costs before it belongs to a problem."""
    battery = Battery(0.5)
    state = battery.initial_state(SAP(np.ones((2, 1, 2)), battery))
    with pytest.raises(ValueError, match="belongs to no problem"):
        battery.handover(0, state)


@pytest.mark.parametrize("form", ["dense", "sparse"])
@pytest.mark.parametrize("seed", range(4))
def test_files_keep_everything(tmp_path: Path, seed: int, form: str) -> None:
    """A problem and its fingerprint survive a file; every field of the dynamics is part of the fingerprint."""
    case = random_case(seed)
    problem = case.problem(form)
    problem.save(tmp_path / "p.npz")
    again = SAP.load(tmp_path / "p.npz")
    assert again.fingerprint == problem.fingerprint
    assert again.dynamics.units == problem.dynamics.units
    plan = solve(problem, HAA()).plan
    assert again.evaluate(plan).value == problem.evaluate(plan).value
    others = [
        Battery(0.5), Battery(0.4), Battery(0.5, 0.4), Battery(0.5, charge=0.2), Battery(0.5, capacity=2.0),
        Battery(0.5, pay_for="entries"), Battery(0.5, initial_charge=0.5), Battery(0.5, initial_charge=[0.5, 1.0]),
    ]  # fmt: skip
    assert len({SAP(case.benefits, b, case.initial).fingerprint for b in others}) == len(others)


@given(cases(), st.data())
def test_an_interval_is_worth_what_holding_yields(case: Case, data: st.DataObject) -> None:
    """Dense and sparse intervals, also later in the horizon, against playing them; one step is beta_hat."""
    steps, n, m = case.benefits.shape
    start = data.draw(st.integers(0, steps - 1))
    stop = data.draw(st.integers(start + 1, steps))
    plan = data.draw(plans_of(case.benefits.shape))
    matrices = []
    for form in ("dense", "sparse"):
        problem = case.problem(form)
        state = problem.initial_state()
        for k in range(start):
            state = problem.transition(k, state, plan[k])
        windows = WindowSums(Benefits(as_form(case.benefits, form)))  # in just this form, whatever suits it
        found = problem.model.interval(windows, start, stop, state)
        assert isinstance(found, GainMatrix) == (form == "sparse")
        matrices.append(found.toarray() if isinstance(found, GainMatrix) else found)
    for matrix in matrices:
        if stop == start + 1:
            np.testing.assert_allclose(matrix, problem.beta_hat(start, state), atol=1e-9)
        for i in range(n):
            path = plan[:start, i].tolist()
            before = case.walk(i, path)[0]
            for j in range(m):
                held = case.walk(i, path + [j] * (stop - start))[0] - before
                assert matrix[i, j] == pytest.approx(held, abs=1e-9)


@given(cases(most=(4, 2, 3)))
def test_local_states_say_the_same(case: Case) -> None:
    """The plain local model's best path of every agent is the best by enumeration."""
    problem = case.problem()
    model = problem.model.local_model(problem.benefits, problem.initial_state())
    assert isinstance(model, LocalModel)
    prices = np.zeros(case.benefits.shape[::2])
    values, plan = LocalOracle(problem.benefits, model).best_paths(prices)
    for i in range(problem.n):
        assert values[i] == pytest.approx(max(case.walk(i, path)[0] for path in case.paths()), abs=1e-9)
        assert case.walk(i, plan[:, i])[0] == pytest.approx(values[i], abs=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_brute_force_finds_the_best_plan(seed: int) -> None:
    """Exact by dynamic programming is enumeration; no policy does better; relabelling agents changes nothing."""
    case = random_case(seed, steps=3, n=2, m=3)
    problem = case.problem()
    best = max(case.score(plan) for plan in case.plans())
    exact = solve(problem, Exact(method="dp"))
    assert exact.value == pytest.approx(best, abs=1e-9)
    for policy in (HAA(), HAAL(3)):
        assert solve(problem, policy).value <= best + 1e-9
    swapped = Case(
        case.benefits[:, ::-1], case.cost, case.charges, case.first[::-1],
        None if case.initial is None else case.initial[::-1], case.pay_for,
    )  # fmt: skip
    assert solve(swapped.problem(), Exact(method="dp")).value == pytest.approx(best, abs=1e-9)


def test_haal_sees_the_battery_within_an_interval() -> None:
    """Dense and sparse benefits give HAAL the same value, and it never counts work that the battery cannot do."""
    benefits = np.zeros((4, 1, 2))
    benefits[:, 0, 0] = [1.0, 1.0, 1.0, 1.0]
    benefits[0, 0, 1] = 1.5
    for form in ("dense", "sparse"):
        problem = SAP(as_form(benefits, form), Battery(0.0, drain=1.0, charge=0.0), [0])
        assert solve(problem, HAAL(4)).value == 1.5  # held for long, task 0 promises 4 and yields 1


def test_without_drain_it_is_free_idling() -> None:
    """A battery that never empties is a switching cost with free idling."""
    from sapopt import SwitchingCost

    rng = np.random.default_rng(3)
    benefits = Benefits(np.where(rng.random((5, 3, 4)) < 0.5, rng.random((5, 3, 4)), 0.0))
    one, other = (
        SAP(benefits, Battery(0.4, drain=0.0), [2, 0, 1]),
        SAP(benefits, SwitchingCost(0.4, True), [2, 0, 1]),
    )
    plan = solve(other, HAA()).plan
    assert one.evaluate(plan).value == pytest.approx(other.evaluate(plan).value)
    assert (
        dense_step(one.beta_hat(0, one.initial_state())).tolist()
        == other.beta_hat(0, other.initial_state()).tolist()
    )
