"""Subclasses of every built-in dynamics that change one part of it: nothing said of the base is believed of them."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, bound, certify, solve, verify
from sapopt.data.benefits import dense_step
from sapopt.dynamics.base import Model
from sapopt.dynamics.capabilities import CAPABILITIES
from sapopt.dynamics.registry import BUILT_IN
from sapopt.proofs.guarantees import guarantee
from sapopt.solvers import HAA, Exact

T, N, M = 3, 2, 3
PLANS = np.array(list(itertools.product(itertools.permutations(range(M), N), repeat=T)))
FORMS = ("dense", "sparse", "forbidden")
PATTERN = np.array([[0.9, -0.4, 0.6], [0.2, 0.8, -0.7]])

PARAMETERS: dict[str, dict[str, Any]] = {
    "AtMostInARow": {"most": 4, "cost": 0.3, "worked": [1, 0]},  # who works at every step may
    "Battery": {"cost": 0.4, "drain": 0.5, "charge": 0.25},
    "Dictator": {"values": np.arange(12.0).reshape(2, N, M) / 8, "leads_to": [[0, 1, 0], [1, 0, 1]]},
    "Interference": {"pairs": [[0, 1], [1, 2]], "loss": 0.6, "cost": 0.3},
    "Jobs": {"length": [1], "cost": 0.3},  # nobody is ever busy
    "RideHailing": {
        "travel": [[0, 1], [1, 0]], "pick_up": [0, 1, 1], "drop_off": [1, 0, 1], "home": [0, 1], "cost": 0.2,
    },
    "SlewCost": {
        "cost": 0.3, "satellites_km": 7e3 + np.arange(18.0).reshape(T, N, 3) ** 2, "targets_km": np.eye(3) * 6e3,
    },
    "SwitchingCost": {"cost": 0.4},
    "SyntheticSwitching": {"cost": 0.3, "forfeit": 0.5, "task_of": [0, 0, 1]},
    "UnitCommitment": {
        "start_up": [0.3, 0.5], "minimum_up": [1, 2], "minimum_down": [2, 1], "idling": [0.1, 0.2], "initial": [-2, 1],
        "shut_down": [0.2, 0.4],
    },
    "WaitingRides": {
        "travel": [[0, 1], [1, 0]], "pick_up": [0, 1, 1], "drop_off": [1, 0, 1], "latest": [2, 1, 3], "home": [0, 1],
        "cost": 0.2,
    },
}  # fmt: skip


def benefits_of(name: str, form: str, seed: int) -> Any:
    """Random benefits that the dynamics takes: dense, sparse with zeros, or with a forbidden pair."""
    rng = np.random.default_rng(seed)
    dense = rng.random((T, N, M))
    if name == "RideHailing":
        offered = np.arange(T)[:, None] == rng.permutation(M)[None, :]  # every request at one step
        dense *= offered[:, None, :]
    if form == "forbidden" and name not in ("RideHailing", "SlewCost", "UnitCommitment", "WaitingRides"):
        dense[rng.integers(T), rng.integers(N), rng.integers(M)] = -np.inf
        return dense
    if form == "sparse":
        return [sp.csr_array(step * (step > 0.3)) for step in dense]
    return dense


def twisted(value: Any) -> Any:
    """Another answer of the same kind: gains where there were none, other states, the opposite truth."""
    if isinstance(value, (bool, np.bool_)):
        return not value
    if isinstance(value, float):
        return value + 0.7
    if isinstance(value, tuple) and type(value) is tuple:
        return (twisted(value[0]), *value[1:])
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        if value.shape == (N, M):
            return value + PATTERN
        return 1.5 * value + 0.2  # entry by entry: a rule is asked for all pairs at once, or for some
    if isinstance(value, np.ndarray) and value.dtype.kind == "b":
        return ~value
    if isinstance(value, np.ndarray) and value.dtype.kind == "i" and value.ndim == 1:
        return value[::-1].copy()
    return value


def overriding(base: type[Model], name: str) -> dict[str, Any]:
    """The body of a class that changes one method or property of `base`, and tells a fingerprint of its own."""
    said = next(vars(cls)[name] for cls in base.__mro__ if name in vars(cls))
    body: dict[str, Any] = {"fingerprint": lambda self: f"a changed {name}", "__module__": "somebody"}
    if isinstance(said, property):
        body[name] = property(lambda self: twisted(said.__get__(self)))
    elif callable(said):
        body[name] = lambda self, *args, **options: twisted(said(self, *args, **options))
    else:  # computed once
        body[name] = property(lambda self: twisted(said.func(self)))
    return body


def parts_of(base: type[Model]) -> list[str]:
    """All methods and properties of a dynamics, private ones too, that are no capability and no special method."""
    names = {name for cls in base.__mro__ if issubclass(cls, Model) and cls is not Model for name, said in
             vars(cls).items() if callable(said) or hasattr(type(said), "__get__")}  # fmt: skip
    names = {name for name in names if not name.startswith("__") and name not in CAPABILITIES}
    return sorted(
        (names | {"interaction", "handover_at"}) - {"bind", "validate", "extended_by", "_abc_impl", "called"}
    )


CASES = [(name, part) for name, base in BUILT_IN.items() for part in parts_of(base)]


class Truth:
    """Values of plans by the three methods (and the interaction) of a dynamics, and by nothing else."""

    def __init__(self, problem: SAP) -> None:
        self.problem = problem
        self.rule: Any = problem.dynamics
        if isinstance(self.rule, Model):
            self.rule = self.rule.bind(problem.benefits)

    def states(self, plan: np.ndarray) -> list[Any]:
        states = [self.rule.initial_state(self.problem)]
        for k in range(T):
            states.append(self.rule.transition(k, states[-1], plan[k]))
        return states

    def hat(self, k: int, state: Any) -> np.ndarray:
        return dense_step(self.problem.benefits.step(k)) + np.asarray(self.rule.handover(k, state))

    def value(self, plan: np.ndarray) -> float:
        total = 0.0
        for k, state in enumerate(self.states(plan)[:-1]):
            total += self.hat(k, state)[np.arange(N), plan[k]].sum()
            total += np.sum(self.rule.interaction(k, state, plan[k]))
        return float(total)


def check(problem: SAP) -> None:
    """Everything that the library says of the problem against the definition."""
    truth = Truth(problem)
    values = np.array([truth.value(plan) for plan in PLANS])
    best = float(values.max())
    for plan, value in list(zip(PLANS, values, strict=True))[::17]:
        if np.isfinite(value):
            assert problem.evaluate(plan).value == pytest.approx(value, abs=1e-9)
    assert solve(problem, Exact(method="dp")).value == pytest.approx(best, abs=1e-9)
    played = solve(problem, HAA())
    states = truth.states(played.plan)
    for k in range(T):
        hat = truth.hat(k, states[k])
        top = max(hat[np.arange(N), list(row)].sum() for row in itertools.permutations(range(M), N))
        assert hat[np.arange(N), played.plan[k]].sum() == pytest.approx(top, abs=1e-9)
    promised = guarantee(problem)
    if promised.covers(HAA()) and best > 0:
        assert played.value >= max(promised.ratio, promised.refined_ratio) * best - 1e-9
    if not problem.model.is_agent_local and problem.model.handover_limit is None:
        with pytest.raises(ValueError, match="must declare handover_limit"):
            bound(problem)
        return
    proven = bound(problem, time_limit=0.2)
    assert proven.value >= best - 1e-9
    if proven.prices is not None:
        certificate = verify(certify(problem, played, prices=proven.prices), problem)
        assert certificate.value == pytest.approx(truth.value(played.plan), abs=1e-9)
        assert certificate.bound >= best - 1e-9


def problem_of(name: str, kind: type[Model], form: str, seed: int) -> SAP:
    """A problem with a subclass of a built-in dynamics."""
    initial = [1, 2] if seed % 2 else None
    return SAP(benefits_of(name, form, seed), kind(**PARAMETERS[name]), initial)


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("form", FORMS)
def test_the_built_in_ones(name: str, form: str) -> None:
    """The yardstick itself: what is said of the built-in rules is true, and none of them is wrapped."""
    problem = problem_of(name, BUILT_IN[name], form, FORMS.index(form))
    assert type(problem.model) is BUILT_IN[name]
    check(problem)


@pytest.mark.parametrize(("name", "part"), CASES)
def test_one_part_changed(name: str, part: str) -> None:
    """Whatever a subclass changes, every value, bound, guarantee and certificate is of its own rule, or refused."""
    kind = type(f"Changed{name}", (BUILT_IN[name],), overriding(BUILT_IN[name], part))
    refused = {"handover_at": "two rules in one problem", "is_uniform": "cost has shape"}
    for seed, form in enumerate(FORMS):
        if part in refused:
            with pytest.raises(ValueError, match=refused[part]):
                problem_of(name, kind, form, seed)
        else:
            check(problem_of(name, kind, form, seed))


@settings(max_examples=40)
@given(
    case=st.sampled_from([case for case in CASES if case[1] not in ("handover_at", "is_uniform")]),
    form=st.sampled_from(FORMS),
    seed=st.integers(0, 99),
    way=st.sampled_from(["mixin", "grandchild", "object"]),
)
def test_other_ways_to_change_a_part(case: tuple[str, str], form: str, seed: int, way: str) -> None:
    """A mixin, a class in between, or an attribute of the object alone count as much as a subclass."""
    name, part = case
    base, body = BUILT_IN[name], overriding(BUILT_IN[case[0]], part)
    if way == "mixin":
        kind = type("Mixed", (type("Mixin", (), body), base), {"__module__": "somebody"})
    elif way == "grandchild":
        kind = type("Grandchild", (type("Child", (base,), body),), {"__repr__": lambda self: "me"})
    else:
        if isinstance(body[part], property):
            return

        def bind(self: Any, benefits: Any) -> Any:
            made = replace(self, benefits=benefits) if "benefits" in base.__dataclass_fields__ else self
            object.__setattr__(made, part, body[part].__get__(made))
            return made

        kind = type(
            "Loose", (base,), {"bind": bind, "fingerprint": body["fingerprint"], "__module__": "somebody"}
        )
    check(problem_of(name, kind, form, seed))
