"""Stays: the programme's points are plans, its value that of the plan, and its relaxation that of the network."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import instances, plans_of

from sapopt import SAP, SwitchingCost
from sapopt.formulations import network, stays
from sapopt.formulations.dual import dual_value
from sapopt.formulations.highs import maximise


@st.composite
def uniform_problems(draw: st.DrawFn) -> SAP:
    """Problems with one cost for every move."""
    instance = draw(instances(most=(4, 3, 4), forbid=True).filter(lambda one: np.ndim(one.cost) == 0))
    return instance.problem()


@settings(max_examples=40, deadline=None)
@given(uniform_problems(), st.data())
def test_a_plan_is_a_point_of_the_same_value(problem: SAP, data: st.DataObject) -> None:
    """The stays of a feasible plan fill the rows as they must, and add up to its value."""
    plan = np.array(data.draw(plans_of(problem.benefits.shape)))
    compiled = stays.formulate(problem)
    try:
        value = problem.evaluate(plan).value
    except ValueError:
        return
    chosen = compiled.follow(plan)
    assert compiled.gain[chosen].sum() == pytest.approx(value, abs=1e-9)
    filled = np.asarray(compiled.rows(np.flatnonzero(chosen)).sum(axis=1)).ravel()
    low, high = compiled.sides
    assert (filled >= low).all()
    assert (filled <= high).all()
    assert (stays.recover(compiled, chosen.astype(float)) == plan).all()


@settings(max_examples=25, deadline=None)
@given(uniform_problems())
def test_optimum_and_relaxation_are_those_of_the_network(problem: SAP) -> None:
    """Both programmes have the same linear relaxation and the same best plan."""
    one, other = stays.formulate(problem).programme(), network.formulate(problem).programme()
    for relaxed in (True, False):
        first, second = maximise(one, relaxed=relaxed), maximise(other, relaxed=relaxed)
        assert first.ending is second.ending
        assert first.value == pytest.approx(second.value, abs=1e-7)


def test_best_ways_are_the_paths_of_the_oracle() -> None:
    """Under prices the agents' best ways are worth what the compiled paths are; no stay lies on a better way."""
    rng = np.random.default_rng(0)
    problem = SAP(rng.random((6, 3, 5)), SwitchingCost(0.3), [4, 0, 2])
    prices = rng.random((6, 5)) * 0.5
    prices -= prices.min(axis=1, keepdims=True)  # as the dual does
    compiled = stays.formulate(problem)
    values, through = compiled.through(compiled.priced(prices))
    oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
    assert values.sum() + prices.sum() == pytest.approx(dual_value(oracle, prices).bound)
    assert (through <= values[compiled.agent] + 1e-12).all()
    # A way through a stay is worth what the network says of a plan that must use it.
    one = int(np.argmin(through))
    forced = compiled.agent == compiled.agent[one]
    forced &= (compiled.first < compiled.stop[one]) & (compiled.stop > compiled.first[one])
    weight = compiled.priced(prices)
    weight[forced & (np.arange(len(compiled)) != one)] = -np.inf
    assert compiled.through(weight)[0][compiled.agent[one]] == pytest.approx(through[one])


def test_stays_that_agree_with_a_plan() -> None:
    """With nothing free only pieces of the plan agree; with everything free all do."""
    problem = SAP(np.random.default_rng(1).random((4, 2, 3)), SwitchingCost(0.3))
    compiled = stays.formulate(problem)
    plan = np.array([[0, 1], [0, 2], [0, 2], [1, 2]])
    fixed = compiled.compatible(plan, np.zeros((4, 2), dtype=bool))
    for i, j, a, b in zip(
        *(getattr(compiled, k)[fixed] for k in ("agent", "task", "first", "stop")), strict=True
    ):
        assert (plan[a:b, i] == j).all()
    assert compiled.compatible(plan, np.ones((4, 2), dtype=bool)).all()
    free = np.zeros((4, 2), dtype=bool)
    free[:, 1] = True
    assert compiled.compatible(plan, free)[compiled.agent == 1].all()


def test_what_is_not_written_in_stays() -> None:
    """A cost matrix, and a problem with too many stays, are refused with the reason."""
    assert "one cost" in (stays.refusal(SAP(np.ones((2, 2, 3)), SwitchingCost(1 - np.eye(3)))) or "")
    assert "too many" in (stays.refusal(SAP(np.zeros((200, 10, 10)), SwitchingCost(1.0))) or "")
    with pytest.raises(ValueError, match="one cost"):
        stays.formulate(SAP(np.ones((2, 2, 3)), SwitchingCost(1 - np.eye(3))))
