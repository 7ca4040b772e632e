"""Synthetic agents and tasks: forth and back, best order, and the problem of identical copies as a bound."""

from __future__ import annotations

from itertools import permutations, product
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from strategies import arrays, as_form, plans_of, quarters, sparse_quarters

from sapopt import SAP, SwitchingCost, bound, solve
from sapopt.dynamics import SyntheticSwitching
from sapopt.formulations.synthetic import SyntheticAgents, SyntheticTasks, synthetic_agents, synthetic_tasks
from sapopt.solvers import HAAL, Exact

nonnegative = st.integers(0, 12).map(lambda x: x / 4)


@st.composite
def beams(draw: Any, elements: Any = quarters, steps: int = 3, extra: int | None = None) -> SyntheticAgents:
    """One or two agents with up to two copies each, three tasks."""
    T, n, m = draw(st.integers(1, steps)), draw(st.integers(1, 2)), 3
    benefits = draw(arrays((T, n, m), draw(st.sampled_from([elements, sparse_quarters]))))
    initial = draw(st.none() | st.permutations(range(m)).map(lambda p: p[:n]))
    dynamics = SwitchingCost(draw(st.sampled_from([0.0, 0.5, 2.0])), idle_is_free=draw(st.booleans()))
    base = SAP(as_form(benefits, draw(st.sampled_from(["dense", "sparse"]))), dynamics, initial)
    copies = draw(st.lists(st.integers(1, 2), min_size=n, max_size=n))
    assume(initial is None or extra is None or sum(copies) - n <= extra)
    return synthetic_agents(base, copies, draw(st.sampled_from([1.0, 0.5])), idle_tasks=extra)


def worth_of_sets(made: SyntheticAgents, owners: np.ndarray) -> float:
    """Value of the real agents' sets of tasks, by the rule: best first, charged for what was not in the set before."""
    base, total = made.base, 0.0
    held: Any = None
    if made.problem.initial_assignment is not None:
        held = [set(made.problem.initial_assignment[made.agent_of == i].tolist()) for i in range(base.n)]
    dense = base.benefits.dense()
    for k, row in enumerate(owners):
        sets = [set(np.flatnonzero(row == i).tolist()) for i in range(base.n)]
        for i, tasks in enumerate(sets):
            worth = {j: float(dense[k, i, j]) if j < base.m else 0.0 for j in tasks}
            ranked = sorted(worth.values(), reverse=True)
            total += sum(b * made.decay**r for r, b in enumerate(ranked))
            if held is not None:
                free = base.dynamics.idle_is_free
                fresh = [j for j in tasks - held[i] if worth[j] > 0 or not free]
                total -= base.dynamics.cost * len(fresh)
        held = sets
    return total


@given(beams(), st.data())
def test_agents_there_and_back(made: SyntheticAgents, data: st.DataObject) -> None:
    """The way back keeps the sets; their value is the rule's, the best that any order of the copies gives."""
    plan = data.draw(plans_of(made.problem.benefits.shape))
    owners = made.original(plan)
    tidy = made.plan(owners)
    np.testing.assert_array_equal(made.original(tidy), owners)
    assert made.evaluate(owners).value == pytest.approx(worth_of_sets(made, owners))
    assert made.evaluate(owners).value >= made.problem.evaluate(plan).value - 1e-9
    np.testing.assert_array_equal(made.tidied(tidy), tidy)
    for k, row in enumerate(made.tasks_of(plan)):
        for i, tasks in enumerate(row):
            assert set(tasks) == {j for j in plan[k][made.agent_of == i] if j < made.base.m}


@given(beams(), st.data())
def test_copies_may_be_relabelled(made: SyntheticAgents, data: st.DataObject) -> None:
    """Copies of equal weight may swap their tasks at any step: nothing changes but the count of handovers."""
    made = synthetic_agents(made.base, made.copies, 1.0)
    plan = data.draw(plans_of(made.problem.benefits.shape))
    other = plan.copy()
    for k in range(len(plan)):
        for i in range(made.base.n):
            mine = np.flatnonzero(made.agent_of == i)
            other[k, mine] = plan[k, data.draw(st.permutations(mine.tolist()))]
    assert made.problem.evaluate(other).value == pytest.approx(made.problem.evaluate(plan).value)


@settings(max_examples=20)
@given(beams(nonnegative, steps=2, extra=1))
def test_exact_in_the_original(made: SyntheticAgents) -> None:
    """The optimum of the copies is the best of all ways to share the tasks out among the real agents."""
    m, total = made.problem.m, int(made.copies.sum())
    assume(total <= 3)
    rows = [
        row
        for row in product(range(-1, made.base.n), repeat=m)
        if all(row.count(i) == made.copies[i] for i in range(made.base.n))
    ]
    best = max(worth_of_sets(made, np.array(plan)) for plan in product(rows, repeat=made.problem.T))
    found = solve(made.problem, Exact(method="dp"))
    assert found.value == pytest.approx(best)
    assert made.problem.evaluate(made.tidied(found.plan)).value == pytest.approx(best)


@given(beams(), st.data())
def test_identical_copies_are_a_bound(made: SyntheticAgents, data: st.DataObject) -> None:
    """Sets of tasks are worth at most as much as in the problem of identical copies, whatever the reference.

    The copies are named so that tasks that are kept stay on one copy; then own changes are the agent's changes.
    """
    shape = made.problem.benefits.shape
    plan, reference = data.draw(plans_of(shape)), data.draw(plans_of(shape))
    for alike, constant in (made.alike(), made.alike(reference), made.alike(plan)):
        named = kept_on_one_copy(made, plan)
        assert alike.evaluate(named).value + constant >= made.evaluate(made.original(plan)).value - 1e-9
    exact, constant = made.alike(plan)
    steady = exact.evaluate(kept_on_one_copy(made, plan)).value + constant
    if (made.base.benefits.dense() >= 0).all():
        assert steady == pytest.approx(made.evaluate(made.original(plan)).value)


def kept_on_one_copy(made: SyntheticAgents, plan: np.ndarray) -> np.ndarray:
    """The same sets of tasks; a task that an agent keeps stays on the copy that held it."""
    out = plan.copy()
    before = made.problem.initial_assignment
    for k in range(len(plan)):
        for i in range(made.base.n):
            mine = np.flatnonzero(made.agent_of == i)
            now = plan[k, mine].tolist()
            if before is None:
                continue
            row = [j if j in now else -1 for j in before[mine]]
            fresh = iter([j for j in now if j not in row])
            out[k, mine] = [j if j >= 0 else next(fresh) for j in row]
        before = out[k]
    return out


def test_identical_copies_equal_the_group_rule() -> None:
    """Without decay the two problems have one optimum: the copies' own changes are the agent's."""
    rng = np.random.default_rng(5)
    for _ in range(4):
        base = SAP(rng.random((3, 2, 4)), SwitchingCost(0.4), [0, 1])
        made = synthetic_agents(base, [2, 1], 1.0, idle_tasks=1)
        alike, constant = made.alike()
        assert constant == 0
        optimum = solve(made.problem, Exact(method="dp")).value
        assert solve(alike, Exact(method="dp")).value == pytest.approx(optimum)


def test_bound_with_decay() -> None:
    """The bound through identical copies lies above the optimum, and closer than the undecayed one."""
    rng = np.random.default_rng(1)
    base = SAP(rng.random((4, 2, 4)), SwitchingCost(0.2), [0, 1])
    made = synthetic_agents(base, 2, 0.5, idle_tasks=2)
    optimum = solve(made.problem, Exact(method="dp"))
    loose, tight = (
        bound(alike).value + constant for alike, constant in (made.alike(), made.alike(optimum.plan))
    )
    assert optimum.value - 1e-9 <= tight < loose
    assert made.bound(optimum.plan).value == pytest.approx(tight)
    free = synthetic_agents(
        SAP(base.benefits, SwitchingCost(0.2)), 2, 0.5, idle_tasks=2
    )  # copies share paths
    best = solve(free.problem, Exact(method="dp"))
    shared = free.bound(best.plan).value
    alike, constant = free.alike(best.plan)
    assert best.value - 1e-9 <= shared
    assert shared == pytest.approx(bound(alike).value + constant, rel=2e-3)


@st.composite
def observed(draw: Any) -> SyntheticTasks:
    """Up to three agents on two tasks that take up to two of them each, and idle tasks."""
    T, n = draw(st.integers(1, 3)), draw(st.integers(1, 3))
    benefits = draw(arrays((T, n, 2 + n), draw(st.sampled_from([nonnegative, sparse_quarters]))))
    benefits[:, :, 2:] = 0
    if draw(st.booleans()):
        dynamics: Any = SwitchingCost(draw(st.sampled_from([0.0, 0.5])), idle_is_free=draw(st.booleans()))
    else:
        dynamics = SyntheticSwitching(
            0.25, draw(st.sampled_from([0.5, 1.0])), needs_sight=draw(st.booleans())
        )
    initial = draw(st.none() | st.just(list(range(2, 2 + n))))
    base = SAP(as_form(benefits, draw(st.sampled_from(["dense", "sparse"]))), dynamics, initial)
    copies = [draw(st.integers(1, 2)), 2, *[1] * n]
    return synthetic_tasks(base, copies, draw(st.sampled_from([1.0, 0.5])))


def worth_of_observers(made: SyntheticTasks, tasks: np.ndarray) -> float:
    """Value of an original plan by the rule, over all orders of the agents on a task."""
    base, dynamics = made.base, made.problem.dynamics
    dense, total = base.benefits.dense(), 0.0
    held = None if base.initial_assignment is None else base.initial_assignment.tolist()
    for k, row in enumerate(tasks):
        for j in set(row.tolist()):
            best = -np.inf
            for order in permutations(np.flatnonzero(row == j).tolist()):
                worth = 0.0
                for r, i in enumerate(order):
                    b = dense[k, i, j] * made.decay**r
                    worth += b
                    if held is not None and held[i] != j and (b > 0 or not dynamics.idle_is_free):
                        worth -= dynamics.cost + dynamics.forfeit * b
                best = max(best, worth)
            total += best
        held = [
            j if dense[k, i, j] > 0 or not dynamics.needs_sight else -1 for i, j in enumerate(row.tolist())
        ]
    return total


@given(observed(), st.data())
def test_tasks_there_and_back(made: SyntheticTasks, data: st.DataObject) -> None:
    """The way back keeps who is on what; its value is the rule's, the best that any order of observers gives."""
    plan = data.draw(plans_of(made.problem.benefits.shape))
    tasks = made.original(plan)
    tidy = made.plan(tasks)
    np.testing.assert_array_equal(made.original(tidy), tasks)
    assert made.evaluate(tasks).value == pytest.approx(worth_of_observers(made, tasks))
    assert made.evaluate(tasks).value >= made.problem.evaluate(plan).value - 1e-9
    for k, row in enumerate(made.agents_of(plan)):
        assert [set(agents) for agents in row] == [
            set(np.flatnonzero(tasks[k] == j).tolist()) for j in range(made.base.m)
        ]


def test_forecasts_are_copied_too() -> None:
    """A forecast of the original is one of the copies; the perfect one changes nothing."""
    rng = np.random.default_rng(3)
    dense = rng.random((5, 3, 6)) * (rng.random((5, 3, 6)) < 0.6)
    for form in ("dense", "sparse"):
        base = SAP(as_form(dense, form), SwitchingCost(0.2))
        for made in (synthetic_agents(base, 2, 0.9), synthetic_tasks(base, 2, 0.2)):
            seen = made.forecast(lambda k, steps: as_form(dense[k : k + steps], form))  # noqa: B023
            truth = solve(made.problem, HAAL(3))
            assert solve(made.problem, HAAL(3), forecast=seen).value == pytest.approx(truth.value)


def test_sparse_stays_sparse() -> None:
    """Neither transformation expands a sparse problem."""
    base = SAP([sp.random_array((3, 8), density=0.3, rng=np.random.default_rng(0)).tocsr()] * 2, 0.1)
    made = synthetic_agents(base, 2, 0.9)
    assert made.problem.benefits.is_sparse
    assert synthetic_tasks(base, 2, 0.9).problem.benefits.is_sparse
    plan = solve(made.problem, HAAL(2)).plan
    assert made.alike(plan)[0].benefits.is_sparse
    assert made.handovers(plan) >= 0


BASE = SAP(np.ones((2, 2, 3)), SwitchingCost(0.5))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: synthetic_agents(BASE, 0), "copies must be a positive whole number"),
        (lambda: synthetic_agents(BASE, [1, 2, 3]), "one for each of the 2 agents"),
        (lambda: synthetic_agents(BASE, 2, 1.5), "decay must be above 0 and at most 1"),
        (lambda: synthetic_agents(BASE, 2, 0.0), "decay"),
        (lambda: synthetic_agents(BASE, 2, idle_tasks=0), "append at least 1"),
        (lambda: synthetic_agents(SAP(np.ones((1, 2, 2)), SyntheticSwitching(1.0)), 2), "SwitchingCost of one number"),
        (lambda: synthetic_tasks(SAP(np.ones((1, 2, 2)), SwitchingCost(np.zeros((2, 2)))), 2), "one number"),
        (lambda: synthetic_agents(BASE, 2).plan(np.zeros((2, 7), dtype=int)), "agent 0 has 7 tasks at step 0"),
        (lambda: synthetic_agents(BASE, 2).plan(np.zeros((2, 4), dtype=int)), "owners must have shape"),
        (lambda: synthetic_agents(BASE, 2).plan(np.full((2, 3), 5)), r"agents 0\.\.1"),
        (lambda: synthetic_tasks(BASE, 1).plan([[0, 0], [0, 1]]), "2 agents are on task 0 at step 0"),
        (lambda: synthetic_tasks(BASE, 2).plan([[0, 3], [0, 1]]), r"tasks 0\.\.2"),
    ],
)  # fmt: skip
def test_bad_input(call: Any, message: str) -> None:
    """Each is a ValueError that names the argument and the mend."""
    with pytest.raises(ValueError, match=message):
        call()
