"""Interference: the quadratic rule in plain loops, exact against brute force, and who is blind to it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import FORMS, arrays, as_form, plans_of, quarters, sizes, sparse_quarters

from sapopt import SAP, CertificateError, Limit, Status, SwitchingCost, bound, certify, solve, verify, why_not
from sapopt.dynamics import Interference
from sapopt.proofs.plain import plain_value
from sapopt.solvers import (
    HAA,
    HAAL,
    DualDecomposition,
    DualLookahead,
    Exact,
    Greedy,
    IteratedAssignment,
    NoHandover,
)


@dataclass(frozen=True, eq=False)
class Case:
    """A problem as plain numbers."""

    benefits: np.ndarray
    loss: dict[tuple[int, int], float]
    cost: float
    idle_is_free: bool
    initial: tuple[int, ...] | None

    def problem(self, form: str = "dense") -> SAP:
        dynamics = Interference(list(self.loss), list(self.loss.values()), self.cost, self.idle_is_free)
        return SAP(as_form(self.benefits, form), dynamics, self.initial)

    def score(self, plan: Any) -> float:
        """Value of a plan by the rule."""
        total, before = 0.0, self.initial
        for k, row in enumerate(plan):
            served = set()
            for i, j in enumerate(row):
                b = self.benefits[k, i, j]
                total += b
                if b > 0:
                    served.add(int(j))
                if before is not None and before[i] != j and (b > 0 or not self.idle_is_free):
                    total -= self.cost
            total -= sum(loss for pair, loss in self.loss.items() if set(pair) <= served)
            before = row
        return float(total)

    def best(self) -> float:
        """Value of the best of all plans."""
        steps, n, m = self.benefits.shape
        rows = list(permutations(range(m), n))
        return max(self.score(plan) for plan in product(rows, repeat=steps))


@st.composite
def cases(draw: Any, plans: int = 10**9) -> Case:
    """Small problems; every pair of tasks may disturb."""
    steps, n, m = shape = draw(sizes(plans, (3, 3, 4)))
    benefits = draw(arrays(shape, draw(st.sampled_from([quarters, sparse_quarters]))))
    every = list(combinations(range(m), 2))
    chosen = draw(st.lists(st.sampled_from(every), unique=True)) if every else []
    loss = {pair: draw(st.integers(0, 12)) / 4 for pair in chosen}
    initial = draw(st.none() | st.permutations(range(m)).map(lambda p: tuple(p[:n])))
    return Case(benefits, loss, draw(st.sampled_from([0.0, 0.5])), draw(st.booleans()), initial)


@given(cases(), st.data())
def test_evaluation_is_the_rule(case: Case, data: st.DataObject) -> None:
    """Every form of the benefits, and the verifier's plain value, give the value of the rule."""
    plan = data.draw(plans_of(case.benefits.shape))
    for form in FORMS:
        problem = case.problem(form)
        assert problem.model.interacts
        assert problem.evaluate(plan).value == pytest.approx(case.score(plan))
        assert plain_value(problem, plan) == pytest.approx(case.score(plan))


@given(cases(), st.data())
def test_relabelling(case: Case, data: st.DataObject) -> None:
    """Agents in another order are worth the same, and so are tasks."""
    n, m = case.benefits.shape[1:]
    agents = np.array(data.draw(st.permutations(range(n))))
    tasks = np.array(data.draw(st.permutations(range(m))))
    place = np.argsort(tasks)
    plan = data.draw(plans_of(case.benefits.shape))
    loss = {(int(place[a]), int(place[b])): value for (a, b), value in case.loss.items()}
    initial = None if case.initial is None else tuple(place[np.array(case.initial)[agents]].tolist())
    other = Case(case.benefits[:, agents][:, :, tasks], loss, case.cost, case.idle_is_free, initial)
    renamed = place[plan[:, agents]]
    assert other.problem().evaluate(renamed).value == pytest.approx(case.problem().evaluate(plan).value)


@settings(max_examples=40)
@given(cases(plans=3000))
def test_exact_and_heuristics(case: Case) -> None:
    """Heuristic <= exact = best of all plans <= bound."""
    problem, best = case.problem("sparse"), case.best()
    assert solve(problem, Exact(method="dp")).value == pytest.approx(best)
    solvers: list[Any] = [
        IteratedAssignment(),
        IteratedAssignment(4, 0.0),
        HAA(),
        HAAL(2),
        Greedy(),
        NoHandover(),
    ]
    for solver in solvers:
        result = solve(problem, solver)
        assert result.value == pytest.approx(case.score(result.plan))
        assert result.value <= best + 1e-9
    assert bound(problem).value >= best - 1e-9


@settings(max_examples=12)
@given(cases(plans=2000))
def test_prices_know_the_losses(case: Case) -> None:
    """Bound and certificate are not below the best of all plans; the planners find it, and prove it."""
    problem, best = case.problem("sparse"), case.best()
    proven = bound(problem)
    assert proven.value >= best - 1e-11
    for solver in (Exact(), DualDecomposition()):
        result = solve(problem, solver)
        assert result.value == pytest.approx(case.score(result.plan))
        assert result.value >= best - 1e-4 * max(1.0, abs(best))
        assert result.bound is not None
        assert result.bound >= best - 1e-9
        certificate = verify(certify(problem, result), problem)
        assert certificate.value <= best + 1e-11
        assert certificate.bound >= best - 1e-11
    assert solve(problem, Exact()).status is Status.OPTIMAL


def test_a_bound_with_losses_is_lower() -> None:
    """Two neighbours that lose more than the second one earns: the bound is the optimum, and not the sum of both."""
    problem = SAP([[[2.0, 0.0], [0.0, 2.0]]] * 3, Interference([[0, 1]], 1.5))
    assert bound(problem).value == pytest.approx(7.5, abs=1e-6)
    certificate = certify(problem, solve(problem, Exact()))
    assert certificate.gap < 1e-6
    dear = replace(certificate, limit_prices=certificate.limit_prices + 2.0)
    with pytest.raises(CertificateError, match="is no price of tasks 0 and 1"):
        verify(dear, problem)
    with pytest.raises(CertificateError, match="prove a bound"):
        verify(replace(certificate, bound=certificate.bound - 1e-3), problem)


def test_losses_beside_capacities_and_limits(tmp_path: Path) -> None:
    """Where a task of a pair takes several agents the bound holds, and planners refuse; limits are kept as well."""
    rng = np.random.default_rng(0)
    for seed in range(4):
        benefits = np.round(rng.random((2, 2, 3)), 2)
        rule = Interference([[0, 1], [1, 2]], [0.4, 0.7], 0.1)
        crowded = SAP(benefits, rule, capacity=2, idle=True)
        rows = list(product(range(-1, 3), repeat=2))
        best = max(crowded.evaluate(np.array(plan)).value for plan in product(rows, rows))
        assert bound(crowded).value >= best - 1e-11
        with pytest.raises(ValueError, match="takes one agent"):
            solve(crowded, Exact())
        limited = SAP(benefits, rule, idle=True, limits=[Limit.once(), Limit.handovers(2)])
        value = -np.inf
        for plan in product([row for row in rows if row[0] != row[1] or row[0] < 0], repeat=2):
            try:
                value = max(value, limited.evaluate(np.array(plan)).value)
            except ValueError:
                continue
        result = solve(limited, Exact())
        assert result.value == pytest.approx(value, abs=1e-6)
        certify(limited, result).save(tmp_path / f"{seed}.npz")
        assert verify(tmp_path / f"{seed}.npz", limited).bound >= value - 1e-11


def test_what_stands_in_the_way() -> None:
    """`why_not` names the two tasks that disturb each other."""
    problem = SAP([[[2.0, 0.0, 0.5], [0.0, 1.0, 0.6]]], Interference([[0, 1]], 0.7), tasks=["x", "y", "z"])
    told = why_not(problem, solve(problem, Exact()), 1, "y", 0)
    assert told.bound == pytest.approx(2.3, abs=1e-4)
    assert "'x' beside task 'y'" in str(told)


@given(cases())
def test_marginal_is_the_change_of_one_agent(case: Case) -> None:
    """With the others fixed, moving one agent changes the interaction by the difference of its marginals."""
    problem = case.problem()
    n, m = case.benefits.shape[1:]
    row = np.arange(n)
    active = np.zeros((n, m))
    state = problem.initial_state()
    active[np.arange(n), row] = problem.model.serves(0, state, row)
    marginal = problem.model.marginal(0, state, active.sum(axis=0) - active)
    total = problem.model.interaction(0, state, row).sum()
    for i in range(n):
        for j in set(range(m)) - set(row.tolist()):
            other = row.copy()
            other[i] = j
            change = problem.model.interaction(0, state, other).sum() - total
            assert change == pytest.approx(marginal[i, j] - marginal[i, row[i]])


@given(cases())
def test_a_step_is_never_worse_than_alpha(case: Case) -> None:
    """On one step the iterated assignment is worth at least alpha(beta_hat)."""
    one = Case(case.benefits[:1], case.loss, case.cost, case.idle_is_free, case.initial)
    problem = one.problem()
    assert solve(problem, IteratedAssignment()).value >= solve(problem, HAA()).value - 1e-9


def test_it_avoids_what_alpha_walks_into() -> None:
    """Two good neighbours: alpha takes both and loses, the iteration takes one of them and another task."""
    problem = SAP([[[2.0, 1.9, 1.0], [1.9, 2.0, 1.0]]], Interference([[0, 1]], 3.0))
    assert solve(problem, HAA()).value == pytest.approx(1.0)
    assert solve(problem, IteratedAssignment()).value == pytest.approx(3.0)
    assert solve(problem, Exact(method="dp")).value == pytest.approx(3.0)


def test_without_pairs_it_is_switching_cost() -> None:
    """No pairs: the value is that of `SwitchingCost`, and the policy is HAA."""
    benefits = np.random.default_rng(0).random((4, 3, 5))
    plain, empty = SAP(benefits, SwitchingCost(0.3)), SAP(benefits, Interference([], 0.0, 0.3))
    result = solve(empty, IteratedAssignment())
    assert result.value == pytest.approx(solve(plain, HAA()).value)
    assert plain.evaluate(result.plan).value == pytest.approx(result.value)


def test_methods_that_know_no_losses_refuse() -> None:
    """They would treat the agents' paths as independent, which they are not."""
    problem = SAP(np.ones((2, 2, 3)), Interference([[0, 1]], 0.5))
    for solver in (DualLookahead(2), Exact(method="milp"), Exact(method="qap")):
        with pytest.raises(ValueError, match=r"Interference|SwitchingCost"):
            solve(problem, solver)
    with pytest.raises(ValueError, match="has no interaction"):
        solve(SAP(np.ones((1, 2, 3)), 0.5), IteratedAssignment())


def test_files(tmp_path: Path) -> None:
    """Every field survives a file."""
    problem = SAP(np.ones((2, 2, 4)), Interference([[0, 1], [3, 2]], [0.5, 0.25], 0.1, True))
    problem.save(tmp_path / "p.npz")
    again = SAP.load(tmp_path / "p.npz")
    assert again.fingerprint == problem.fingerprint
    assert repr(again.dynamics) == repr(problem.dynamics)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pairs": [[0, 0]]}, "pairs must be a list of two different tasks"),
        ({"pairs": [0, 1]}, "pairs must be a list"),
        ({"pairs": [[0, 1], [1, 0]]}, "listed twice"),
        ({"loss": [1.0, 2.0]}, "one for each of the 1 pairs"),
        ({"loss": -1.0}, "loss must be finite and not negative"),
        ({"cost": np.zeros((2, 2))}, "cost must be one number"),
        ({"cost": -1.0}, "cost must be finite"),
    ],
)
def test_bad_options(options: dict[str, Any], message: str) -> None:
    """Each is a ValueError that names the argument."""
    with pytest.raises(ValueError, match=message):
        Interference(**({"pairs": [[0, 1]], "loss": 1.0} | options))


def test_pairs_must_be_tasks() -> None:
    """A pair beyond the last task is refused when the problem is built."""
    with pytest.raises(ValueError, match="pairs hold task 5, but the benefits have 3 tasks"):
        SAP(np.ones((1, 2, 3)), Interference([[0, 5]], 1.0))
