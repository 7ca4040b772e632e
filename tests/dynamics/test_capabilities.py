"""What is believed of a user's dynamics, and what is said of one that cannot be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from local_dynamics import Tiring
from rule_problems import Learning

from sapopt import SAP, SwitchingCost, bound, certify, solve
from sapopt.data.windows import WindowSums
from sapopt.dynamics import Battery, RideHailing, SyntheticSwitching
from sapopt.dynamics.base import Model
from sapopt.dynamics.capabilities import Adapted, offers
from sapopt.proofs.guarantees import guarantee
from sapopt.solvers import CBBA, HAA, HAAL, DualDecomposition, DualLookahead, Exact, Greedy

RNG = np.random.default_rng(5)
BENEFITS = RNG.random((3, 2, 3))


class Plain:
    """Three methods and no more."""

    def initial_state(self, problem: Any) -> int:
        return 0

    def handover(self, k: int, state: int) -> np.ndarray:
        return np.zeros((2, 3))

    def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
        return state


class Limited(Plain):
    """With a limit, set where the object is made."""

    def __init__(self) -> None:
        self.handover_limit = 0.0


def test_three_methods_are_enough() -> None:
    """A plain class is adapted once, answers every question, and shows itself in the problem."""
    mine = Plain()
    problem = SAP(BENEFITS, mine)
    assert problem.dynamics is mine
    assert isinstance(problem.model, Adapted)
    assert problem.model.handover_at(0, 0, np.array([0, 1])).tolist() == [0.0, 0.0]
    assert problem.model.switching() is problem.model.batteries() is problem.model.charge_of(0) is None
    assert problem.model.interval(WindowSums(problem.benefits), 0, 2, 0).shape == (2, 3)
    assert not problem.model.is_agent_local
    with pytest.raises(ValueError, match="Plain must declare handover_limit"):
        bound(problem)


def test_limits_belong_to_the_class_that_sets_them() -> None:
    """A number that a constructor sets counts for that class, and not for a subclass with another matrix."""

    class Generous(Limited):
        def handover(self, k: int, state: int) -> np.ndarray:
            return np.ones((2, 3))

    class Declared(Generous):
        def __init__(self) -> None:
            super().__init__()
            self.handover_limit = 1.0

    @dataclass
    class Field(Plain):
        handover_limit: float = 0.0

    @dataclass
    class Wider(Field):
        extra: float = 1.0

        def handover(self, k: int, state: int) -> np.ndarray:
            return np.ones((2, 3))

    assert offers(Limited(), "handover_limit")
    assert offers(Field(), "handover_limit")
    assert offers(Declared(), "handover_limit")
    assert not offers(Generous(), "handover_limit")
    assert not offers(Wider(), "handover_limit")
    assert bound(SAP(BENEFITS, Declared())).value >= solve(SAP(BENEFITS, Declared()), HAA()).value


def test_free_moves_of_a_battery() -> None:
    """The bound of a battery whose moves are free is not that of the battery that charges for them (13.58 < 18.40)."""

    @dataclass(frozen=True, eq=False)
    class Free(Battery):
        def handover(self, k: int, state: Any) -> np.ndarray:
            return Battery(0.0, 0.01, 0.01, benefits=self.benefits).handover(k, state)

    problem = SAP(np.random.default_rng(0).random((6, 3, 5)), Free(5.0, 0.01, 0.01))
    with pytest.raises(ValueError, match="Free changes handover of Battery"):
        bound(problem)
    with pytest.raises(ValueError, match="Free changes handover of Battery"):
        solve(problem, DualLookahead(2))
    assert problem.model.batteries() is None


def test_a_subclass_of_copies_keeps_its_rule() -> None:
    """Binding makes no object of the base class, so `evaluate` scores by the subclass' rule."""

    class Free(SyntheticSwitching):
        def handover(self, k: int, state: Any) -> np.ndarray:
            return np.zeros((2, 3))

    plan = [[0, 1], [1, 2], [2, 0]]
    found = SAP(BENEFITS, Free(10.0)).evaluate(plan)
    assert found.value == pytest.approx(SAP(BENEFITS, 0.0).evaluate(plan).value)


class Harsh(SwitchingCost):
    """Charges ten times what it says."""

    def fingerprint(self) -> str:
        return "harsh 1"

    def handover(self, k: int, state: Any) -> np.ndarray:
        return 10.0 * super().handover(k, state)


@pytest.mark.parametrize("form", ["dense", "sparse"])
def test_the_equal_rule_plays_equally(form: str) -> None:
    """HAAL with a subclass plays what it plays with the equal rule of the library, and promises no more."""
    dense = np.random.default_rng(2).random((5, 3, 5)) * 3.0
    benefits = dense if form == "dense" else SAP(dense, 0.0).benefits
    mine, same = SAP(benefits, Harsh(0.5)), SAP(benefits, SwitchingCost(5.0))
    for solver in (HAA(), HAAL(2), HAAL(3)):
        assert solve(mine, solver).value == pytest.approx(solve(same, solver).value)
    assert guarantee(mine).ratio <= guarantee(same).ratio
    assert guarantee(mine).refined_ratio <= guarantee(same).refined_ratio
    for refused in (CBBA(2), DualDecomposition(), Exact(method="network"), Exact(method="qap")):
        with pytest.raises(ValueError, match="Harsh"):
            solve(mine, refused)
    with pytest.raises(ValueError, match="Harsh changes handover of SwitchingCost"):
        certify(mine, solve(mine, HAA()))


def test_harmless_changes_keep_everything() -> None:
    """A subclass with another name, defaults, constructor or text is the same rule, with all that is said of it."""

    @dataclass(frozen=True, eq=False)
    class Cheap(SwitchingCost):
        cost: Any = 0.1

        def __repr__(self) -> str:
            return "Cheap"

    problem, same = SAP(BENEFITS, Cheap()), SAP(BENEFITS, SwitchingCost(0.1))
    assert not isinstance(problem.model, Adapted)
    assert problem.model.switching() is not None
    assert bound(problem).value == pytest.approx(bound(same).value, rel=1e-9)


def test_rules_for_one_agent_may_be_replaced() -> None:
    """`AgentLocal` says all by calling the rule, so a subclass keeps it; that all agents are alike it does not keep."""

    class Faster(Learning):
        def rule(self, *args: Any) -> Any:
            eta, after = super().rule(*args)
            return 2.0 * eta, after

    class Biased(RideHailing):
        def rule(self, k: int, agent: Any, *args: Any) -> Any:
            eta, after = super().rule(k, agent, *args)
            return eta - 0.1 * agent, after

    assert not isinstance(SAP(BENEFITS, Faster()).model, Adapted)
    city = {"travel": [[0, 1], [1, 0]], "pick_up": [0], "drop_off": [1], "home": [0, 0]}
    assert offers(RideHailing(**city), "agents_alike")
    assert not offers(Biased(**city), "agents_alike")


def test_a_bind_that_makes_the_base_is_refused() -> None:
    """A user's own ``bind`` that builds the base class would drop the rule of a subclass."""

    class Tireless(Tiring):
        def handover(self, k: int, state: Any) -> np.ndarray:
            return np.zeros((2, 3))

    with pytest.raises(ValueError, match="bind of Tiring makes a Tiring of a Tireless"):
        SAP(BENEFITS, Tireless())


def test_two_rules_are_refused() -> None:
    """Entries that a subclass replaces without the matrix would be another rule than that of the matrix."""

    class Entries(SwitchingCost):
        def handover_at(self, k: int, state: Any, assignment: np.ndarray) -> np.ndarray:
            return np.zeros(len(assignment))

    with pytest.raises(
        ValueError, match="Entries defines handover_at, but its handover is that of SwitchingCost"
    ):
        SAP(BENEFITS, Entries(1.0))


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("handover_limits", "handover_limit"), ("local_models", "local_model"), ("intervall", "interval")],
)
def test_misspelt_capabilities_are_named(wrong: str, right: str) -> None:
    """What looks like a capability and is none is named, once, with what it may be meant to be."""
    kind = type("Mine", (Plain,), {wrong: lambda self: 0.0})
    with pytest.warns(UserWarning, match=rf"Mine\.{wrong}.*{right}"):
        SAP(BENEFITS, kind())


def test_a_misspelt_limit_of_the_object_is_named() -> None:
    """Also where the constructor sets it."""
    mine = Plain()
    mine.handover_limits = 0.0  # type: ignore[attr-defined]
    with pytest.warns(UserWarning, match="handover_limit, rename"):
        SAP(BENEFITS, mine)


class Meeting(Plain):
    """Two agents earn more together than apart; no matrix says so, and no ``handover_at``."""

    def interaction(self, k: int, state: Any, assignments: np.ndarray) -> np.ndarray:
        near = np.abs(np.diff(assignments, axis=-1)) == 1
        return np.broadcast_to(np.where(near, 1.0, 0.0), np.shape(assignments)).copy()


def test_interactions_count_without_entries() -> None:
    """`evaluate` counts an interaction whether or not the class has ``handover_at``; dp finds the optimum."""
    problem = SAP(np.zeros((2, 2, 3)), Meeting())
    assert problem.evaluate([[0, 1], [0, 2]]).value == 2.0
    best = solve(problem, Exact(method="dp"))
    assert best.value == best.bound == 4.0
    assert solve(problem, Greedy()).value <= best.value


def test_values_for_names_of_ours_stay_values() -> None:
    """A user's parameter that has the name of a question to a `Model` is not taken for an answer."""

    @dataclass(frozen=True, eq=False)
    class Named(Learning):
        switching: float = 2.0
        plain: str = "yes"

    class Simple(Plain):
        def __init__(self) -> None:
            self.switching = SwitchingCost(1.0)

    for dynamics in (Named(), Simple()):
        model = SAP(BENEFITS, dynamics).model
        assert model.switching() is None
        assert model.plain(SAP(BENEFITS)) is None


def test_what_is_handed_on_is_not_said() -> None:
    """A class that hands unknown names on to another object says nothing by that."""

    class Wrapped(Plain):
        def __init__(self) -> None:
            self.inner = SwitchingCost(1.0)

        def __getattr__(self, name: str) -> Any:
            return getattr(self.inner, name)

    model = SAP(BENEFITS, Wrapped()).model
    assert isinstance(model, Adapted)
    assert model.handover_limit is None
    assert not model.is_agent_local


def test_models_of_a_user() -> None:
    """A subclass of `Model` itself needs no adapting, unless it says what is not of its rule."""

    class Own(Model):
        def initial_state(self, problem: Any) -> int:
            return 0

        def handover(self, k: int, state: int) -> np.ndarray:
            return np.zeros((2, 3))

        def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
            return state

        handover_limit = 0.0

    class Other(Own):
        def handover(self, k: int, state: int) -> np.ndarray:
            return np.ones((2, 3))

    assert isinstance(SAP(BENEFITS, Own()).model, Own)
    assert SAP(BENEFITS, Own()).model.handover_limit == 0.0
    assert SAP(BENEFITS, Other()).model.handover_limit is None


def test_a_guarantee_asks_the_solver() -> None:
    """A class of the same name, or a subclass that decides otherwise, is promised nothing."""
    promised = guarantee(SAP(BENEFITS + 1.0, 0.1))
    assert promised.applies
    impostor = type("HAAL", (), {"lookahead": 1, "keep_plan": True})()
    assert not promised.covers(impostor)
    assert not promised.covers(type("HAAL", (HAAL,), {"act": lambda self, outlook, memory: (None, None)})(1))
    for solver, covered in (
        (HAA(), True),
        (HAAL(2), True),
        (HAAL(3), False),
        (HAAL(3, keep_plan=True), True),
    ):
        assert promised.covers(solver) is covered


class OnlyEntries(Plain):
    """A subclass that says the entries of a matrix which its base defines, and they are other ones."""

    def handover_at(self, k: int, state: Any, assignment: np.ndarray) -> np.ndarray:
        return np.full(len(assignment), -9.0)


class Whole(OnlyEntries):
    """The same with a matrix of its own, which the entries above say nothing of."""

    def handover(self, k: int, state: Any) -> np.ndarray:
        return np.full((2, 3), -4.0)


def test_entries_without_a_matrix_are_refused() -> None:
    """Two rules in one problem, whether the base has entries of its own or, as here, the matrix alone."""
    benefits = np.ones((2, 2, 3))
    with pytest.raises(
        ValueError, match=r"OnlyEntries defines handover_at, but its handover is that of Plain"
    ):
        SAP(benefits, OnlyEntries())
    with pytest.raises(ValueError, match="two rules in one problem"):
        SAP(benefits, type("Entries", (Learning,), {"handover_at": OnlyEntries.handover_at})(0.3))
    problem = SAP(benefits, Whole())
    assert solve(problem, HAA()).value == problem.evaluate([[0, 1], [0, 1]]).value == -12.0
