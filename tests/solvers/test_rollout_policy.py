"""RolloutPolicy against its definition, scored by plain arithmetic, and its promise never to lose to its base."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from batteries import random_case
from hypothesis import given
from hypothesis import strategies as st
from strategies import FORMS, Instance, instances

from sapopt import SAP, SwitchingCost, solve
from sapopt.domains.instances import instance
from sapopt.running.outlook import Policy
from sapopt.solvers import (
    HAA,
    HAAL,
    AssignmentPolicy,
    DualDecomposition,
    Greedy,
    NoHandover,
    RolloutPolicy,
    power_constrained,
)


def definition(case: Instance, base: Policy, asked: list[Policy], steps: int | None) -> list[list[int]]:
    """The plan step by step: every rollout is solved as a problem of its own and scored by the case."""
    T = len(case.benefits)
    plan: list[list[int]] = []
    for k in range(T):
        stop = T if steps is None else min(T, k + 1 + steps)

        def rest(first: int, held: Any, end: int = stop) -> Instance:
            return Instance(case.benefits[first:end], case.cost, case.idle_is_free, held)

        held = tuple(plan[-1]) if plan else case.initial
        best, top = None, -np.inf
        for policy in (base, *asked):  # what is asked sees everything to the end
            tasks = solve(rest(k, held, T).problem(), policy).plan[0].tolist()
            rows = [tasks]
            if k + 1 < stop:
                # It has the end of all steps in sight in a rollout too, so it plays them all; only the first count.
                rows += solve(rest(k + 1, tuple(tasks), T).problem(), base).plan.tolist()
            worth = rest(k, held).score(rows[: stop - k])
            if worth > top:
                best, top = tasks, worth
        assert best is not None
        plan.append(best)
    return plan


@given(case=instances(), steps=st.sampled_from([None, 1, 2]), form=st.sampled_from(FORMS))
def test_equals_its_definition(case: Instance, steps: int | None, form: str) -> None:
    """Numbers are exact in binary, so ties are ties: the first answer of equal worth is played."""
    asked: list[Policy] = [NoHandover(), HAAL(2), Greedy()]
    policy = RolloutPolicy(HAA(), asked, steps)
    assert solve(case.problem(form), policy).plan.tolist() == definition(case, HAA(), asked, steps)


@pytest.mark.parametrize("seed", range(40))
def test_never_below_its_base(seed: int) -> None:
    """With batteries, where HAA runs out of charge; and it finds better plans than base and candidate alone."""
    problem = random_case(seed, steps=7, n=3, m=4).problem("sparse")
    base = solve(problem, HAA()).value
    assert solve(problem, RolloutPolicy(HAA(), [HAAL(3), NoHandover()])).value >= base - 1e-9


def test_finds_what_neither_finds_alone() -> None:
    """On the power environment the base policy's future keeps HAAL's choices from killing the satellites."""
    problem = instance("power", seed=3, steps=25)
    base = AssignmentPolicy(power_constrained)
    both = solve(problem, RolloutPolicy(base, [HAAL(3)], steps=12)).value
    assert both > 1.02 * max(solve(problem, base).value, solve(problem, HAAL(3)).value)


def test_the_dictator_gives_way() -> None:
    """Greed earns 37.8 of 63; asked what the best constant assignment leads to, it waits for the last step."""
    problem = instance("dictator")
    generous = AssignmentPolicy(lambda outlook: np.eye(3))
    found = solve(problem, RolloutPolicy(generous, [HAA()])).value
    assert found > solve(problem, generous).value > solve(problem, HAA()).value


def test_rollouts_see_the_forecast_only() -> None:
    """The forecast says that task 1 will be worth nothing, so the move to it is not played, though it would pay."""
    benefits = np.zeros((3, 1, 2))
    benefits[:, 0, 0], benefits[1:, 0, 1] = 1.0, 5.0
    problem = SAP(benefits, SwitchingCost(3.0), [0])
    blind = np.zeros((3, 1, 2))
    blind[:, 0, 0] = 1.0
    mover = AssignmentPolicy(lambda outlook: np.array([[0.0, 1.0]]))
    policy = RolloutPolicy(HAA(), [mover])
    assert solve(problem, policy).plan.tolist() == [[0], [1], [1]]
    assert solve(problem, policy, forecast=lambda k, steps: blind[k : k + steps]).plan.tolist() == [[0]] * 3


def test_reda_plays_on_for_haal() -> None:
    """The shipped weights as the future of HAAL's choices: at least what they earn alone."""
    pytest.importorskip("torch")
    from sapopt.learning import REDA

    problem = instance("power", seed=5, steps=12)
    reda = AssignmentPolicy(REDA.load("power"))
    assert solve(problem, RolloutPolicy(reda, [HAAL(3)])).value > solve(problem, reda).value


def test_refusals_and_names() -> None:
    """Planners are not asked at every step."""
    with pytest.raises(ValueError, match="made of policies"):
        RolloutPolicy(HAA(), [DualDecomposition()])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="steps must be a whole number"):
        RolloutPolicy(HAA(), [], 0)
    assert RolloutPolicy(HAA(), [HAAL(3)], 5).name == "RolloutPolicy(HAA, HAAL(L=3), steps=5)"
