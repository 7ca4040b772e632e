"""Sessions: the same plan as `solve`, ids that come and go, what is carried, and refusals that leave no trace."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from session_windows import RULES, as_plan, benefits_of, earned, played

from sapopt import SAP, Decision, Limit, Session, SwitchingCost, Team, solve
from sapopt.domains.tiny import tiny_problems
from sapopt.dynamics import AtMostInARow, Battery, Jobs, SlewCost, SyntheticSwitching, WaitingRides
from sapopt.live.decision import Outcome
from sapopt.solvers import (
    HAA,
    HAAL,
    AssignmentPolicy,
    DistributedDualLookahead,
    DualDecomposition,
    DualLookahead,
    Greedy,
    MyopicGreedy,
    NoHandover,
    myopic,
)

POLICIES: list[tuple[Any, int]] = [
    (DualLookahead(3), 3), (HAAL(3), 3), (HAAL(3, keep_plan=True), 3), (HAA(), 1), (Greedy(), 1), (MyopicGreedy(), 1),
    (NoHandover(), 1), (AssignmentPolicy(myopic), 1),
]  # fmt: skip

PROBLEMS = list(tiny_problems())


@pytest.mark.parametrize(("name", "problem"), PROBLEMS, ids=[name for name, _ in PROBLEMS])
def test_takes_every_dynamics(name: str, problem: SAP) -> None:
    """Every built-in dynamics is played as `solve` plays it, states of agents, of copies or of all together."""
    policy = DualLookahead(2) if problem.model.is_agent_local else HAAL(2)
    held = (
        None if problem.initial_assignment is None else dict(enumerate(problem.initial_assignment.tolist()))
    )

    def dynamics(step: int, agents: Any, tasks: Any) -> Any:
        rule = problem.dynamics
        if isinstance(rule, SlewCost):  # parameters by time: those of the window
            return SlewCost(rule.cost, rule.satellites_km[step : step + 2], rule.targets_km)
        if isinstance(rule, WaitingRides):
            return replace(rule, latest=rule.latest - step)
        return rule

    session = Session(policy, dynamics, holding=held)
    decisions = played(session, problem.benefits.dense(), 2)
    assert np.array_equal(as_plan(decisions), solve(problem, policy).plan)
    gained, value = earned(problem, decisions)
    assert gained == pytest.approx(value, abs=1e-9)
    assert (decisions[0].bound is not None) == problem.model.is_agent_local


@pytest.mark.parametrize("idle", [False, True])
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(("policy", "length"), POLICIES, ids=lambda value: getattr(value, "name", ""))
def test_plays_the_plan_of_solve(policy: Any, length: int, rule: str, idle: bool) -> None:
    """With exact windows, fixed ids and no budget a session plays what `solve` plays, and counts the same value."""
    benefits = benefits_of(1, (7, 3, 5))
    problem = SAP(benefits, RULES[rule](), idle=idle)
    decisions = played(Session(policy, RULES[rule](), idle=idle), benefits, length)
    assert np.array_equal(as_plan(decisions), solve(problem, policy).plan)
    gained, value = earned(problem, decisions)
    assert gained == pytest.approx(value, abs=1e-9)


@pytest.mark.parametrize("limit", [
    Limit.once(), Limit.once(times=2, penalty=0.3), Limit.work(at_most=2), Limit.handovers(1, each=True),
    Limit.handovers(3), Limit.cover([0, 1], 1, penalty=0.2), Team(1, 2, 0.8),
], ids=repr)  # fmt: skip
@pytest.mark.parametrize(("policy", "length"), [(HAA(), 1), (Greedy(), 1), (DualLookahead(3), 3)])
def test_carries_what_is_used_of_limits(policy: Any, length: int, limit: Any) -> None:
    """Within limits that count over all calls the plan is that of `solve`, which knows the whole problem."""
    benefits = benefits_of(2, (6, 3, 4))
    options: dict[str, Any] = {"idle": True, "capacity": 2, "limits": [limit]}
    problem = SAP(benefits, 0.2, [0, 1, 2], **options)
    session = Session(policy, 0.2, holding={0: 0, 1: 1, 2: 2}, **options)
    decisions = played(session, benefits, length)
    assert np.array_equal(as_plan(decisions), solve(problem, policy).plan)
    assert all(d.bound is None or d.value <= d.bound + 1e-9 for d in decisions)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.sampled_from(sorted(RULES)), st.booleans())
def test_order_and_names_change_nothing(seed: int, rule: str, sparse: bool) -> None:
    """A session whose ids come in another order, and one whose ids are called otherwise, decide the same."""
    rng = np.random.default_rng(seed)
    n, m = 3, 5
    plain, mixed, renamed = (Session(DualLookahead(2, iterations=5), RULES[rule]()) for _ in range(3))
    agents, tasks = list(range(n)), list(range(m))
    for k in range(4):
        if k:  # a task goes and another comes, an agent fails or comes back
            tasks = [*tasks[:1], *tasks[2:], 100 + k]
            agents = list(range(n)) if k == 3 else [i for i in range(n) if i != k]
        window = benefits_of(seed + k, (2, len(agents), m))
        form = [sp.csr_array(step) for step in window] if sparse else window
        expected = plain.step(form, agents=agents, tasks=tasks)
        rows = rng.permutation(len(agents)) if k else np.arange(len(agents))
        columns = rng.permutation(m) if k else np.arange(m)
        other = window[:, rows][:, :, columns]
        found = mixed.step(
            [sp.csr_array(step) for step in other] if sparse else other,
            agents=[agents[i] for i in rows], tasks=np.array(tasks)[columns],
        )  # fmt: skip
        assert found.assignment == expected.assignment
        assert found.value == pytest.approx(expected.value, abs=1e-9)
        named = renamed.step(form, agents=[f"a{i}" for i in agents], tasks=[f"t{j}" for j in tasks])
        assert named.assignment == {f"a{i}": f"t{j}" for i, j in expected.assignment.items()}


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.sampled_from(sorted(RULES)))
def test_bound_is_above_every_plan(seed: int, rule: str) -> None:
    """The bound of a window is not below the best plan that is found from the same state by looking at all of it."""
    from sapopt.solvers import Exact

    benefits = benefits_of(seed, (5, 2, 3))
    session = Session(HAA(), RULES[rule]())
    for k in range(3):
        held = session.assignment
        decision = session.step(benefits[k : k + 2], ends=True)
        assert decision.bound is not None
        assert decision.value <= decision.bound + 1e-9
        if rule != "battery":  # there a problem cannot begin with the charges of the session
            start = [held[i] for i in range(2)] if k else None
            best = solve(SAP(benefits[k : k + 2], RULES[rule](), start), Exact(method="dp"))
            assert decision.bound >= best.value - 1e-9


@pytest.mark.parametrize("rule", [Jobs([2, 1, 3, 1]), AtMostInARow(2, 0.1)], ids=repr)
def test_agents_stay_busy(rule: Any) -> None:
    """What an agent has begun, or worked, goes with it from call to call, counted from the step that begins."""
    benefits = benefits_of(9, (7, 2, 4))
    decisions = played(Session(DualLookahead(3), rule, idle=True), benefits, 3)
    problem = SAP(benefits, rule, idle=True)
    assert np.array_equal(as_plan(decisions), solve(problem, DualLookahead(3)).plan)
    gained, value = earned(problem, decisions)
    assert gained == pytest.approx(value, abs=1e-9)


def test_a_failed_agent_frees_its_task_at_once() -> None:
    """Whoever is left out gives up its task in the same call, and is new when it comes back."""
    session = Session(DualLookahead(2), Battery(0.1, 0.5, 0.25))
    window = np.ones((2, 2, 2)) * [[1.0, 0.2]]
    first = session.step(window, agents=["a", "b"], tasks=["x", "y"]).assignment
    (holder,) = (agent for agent, task in first.items() if task == "x")
    other = "b" if holder == "a" else "a"
    assert session.step(window[:, :1], agents=[other], tasks=["x", "y"]).assignment == {other: "x"}
    session.step(window, agents=["a", "b"], tasks=["x", "y"])
    columns = session._standing.columns
    assert columns is not None
    charge = dict(zip(session._standing.agents.names, columns.values["levels"].tolist(), strict=True))
    assert charge[holder] > charge[other]


def test_states_go_with_their_agents() -> None:
    """Charges stay with the agents whatever order they are listed in, and a new one comes fully charged."""
    session = Session(HAA(), Battery(0.0, 0.5, 0.0))
    session.step([[[1.0, 0.0], [0.0, 0.0]]], agents=["a", "b"], tasks=["x", "y"])
    second = session.step(
        [[[0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [1.0, 0.0, 0.0]]], agents=["b", "c", "a"], tasks=["x", "y", "z"]
    )
    assert second.assignment["a"] == "x"
    third = session.step([[[1.0, 0.0, 0.0]] * 3], agents=["a", "b", "c"], tasks=["x", "y", "z"])
    assert third.assignment["a"] != "x"  # dead: it was drained twice
    assert third.gained == 1.0


def test_tasks_that_are_gone_are_paid_for_anew() -> None:
    """An agent whose task is there no more pays for the next one, an agent whose task is still there does not."""
    session = Session(HAA(), 0.25)
    session.step([[[1.0, 0.0], [0.0, 1.0]]], agents=["a", "b"], tasks=["x", "y"])
    decision = session.step([[[1.0, 0.0], [0.0, 1.0]]], agents=["a", "b"], tasks=["x", "z"])
    assert decision.assignment == {"a": "x", "b": "z"}
    assert decision.gained == 1.75


def test_dynamics_by_a_function() -> None:
    """Rules with parameters by time, agent or task are made anew for every window: here satellites that slew."""
    places = {"s": 7000.0, "t": 7100.0}
    targets = {"x": [6400.0, 0.0, 0.0], "y": [0.0, 6400.0, 0.0], "z": [0.0, 0.0, 6400.0]}
    seen: list[tuple[int, tuple[Any, ...]]] = []

    def slewing(step: int, agents: tuple[Any, ...], tasks: tuple[Any, ...]) -> SlewCost:
        seen.append((step, tasks))
        here = np.array([[places[a] + 10.0 * (step + k), 0.0, 0.0] for k in range(2) for a in agents])
        return SlewCost(0.1, here.reshape(2, len(agents), 3), np.array([targets[j] for j in tasks]))

    session = Session(DualLookahead(2), slewing)
    session.step(np.ones((2, 2, 2)), agents=["s", "t"], tasks=["x", "y"])
    decision = session.step(np.ones((2, 1, 2)), agents=["t"], tasks=["z", "x"])
    assert set(decision.assignment) == {"t"}
    assert [step for step, _ in seen] == [0, 1]
    assert set(seen[1][1]) == {"x", "z"}


def test_own_dynamics_with_fixed_ids() -> None:
    """A class with the three methods alone is carried as it is; where ids change it has to say what goes with whom."""

    class Tired:
        def initial_state(self, problem: Any) -> np.ndarray:
            return np.zeros(problem.n)

        def handover(self, k: int, state: np.ndarray) -> np.ndarray:
            return -0.1 * state[:, None] * np.ones((1, 3))

        def transition(self, k: int, state: np.ndarray, assignment: np.ndarray) -> np.ndarray:
            return state + (assignment == 0)

    benefits = benefits_of(3, (5, 2, 3))
    session = Session(HAAL(2), Tired())
    decisions = played(session, benefits, 2)
    assert np.array_equal(as_plan(decisions), solve(SAP(benefits, Tired()), HAAL(2)).plan)
    assert decisions[0].bound is None
    with pytest.raises(ValueError, match="agent_columns"):
        session.step(benefits[:1, :1], agents=[1])
    assert session.steps == 5


def test_announced_steps_can_be_frozen() -> None:
    """What was announced and frozen is played, whatever the forecasts say then; new agents choose what is left."""
    rng = np.random.default_rng(4)
    session = Session(DualLookahead(3), 0.1, announce=3)
    first = session.step(rng.random((4, 2, 4)), agents=["a", "b"], tasks=[0, 1, 2, 3])
    assert len(first.plan) == 3
    second = session.step(rng.random((4, 2, 4)), agents=["a", "b"], tasks=[0, 1, 2, 3], frozen=2)
    assert second.plan[:2] == first.plan[1:]
    assert second.status is Outcome.FROZEN
    assert second.bound is not None
    assert second.value <= second.bound + 1e-9
    third = session.step(rng.random((4, 3, 4)), agents=["c", "a", "b"], tasks=[0, 1, 2, 3], frozen=2)
    assert {agent: third.assignment[agent] for agent in "ab"} == second.plan[1]
    assert len(set(third.assignment.values())) == 3


@pytest.mark.parametrize("options", [{}, {"idle": True}, {"capacity": 2}])
def test_frozen_on_a_task_that_earns_nothing(options: dict[str, Any]) -> None:
    """A task that is worth nothing to its agent can be frozen like any other."""
    benefits = np.ones((2, 2, 3)) * [[1.0, 1.0, 0.0], [1.0, 0.5, 0.0]]
    decision = Session(DualLookahead(2), 0.1, **options).step(benefits, frozen={0: 2})
    assert decision.assignment == {0: 2, 1: 0}
    assert decision.gained == 1.0


@pytest.mark.parametrize("options", [{}, {"idle": True}, {"capacity": 2}])
def test_frozen_by_name(options: dict[str, Any]) -> None:
    """Agents that are named take their tasks, the policy decides on the others, and nobody takes what is frozen."""
    benefits = benefits_of(5, (3, 3, 4)) + 0.1
    benefits[:, :, 3] = 2.0
    session = Session(DualLookahead(2), 0.1, **options)
    decision = session.step(benefits, frozen={0: 2})
    assert decision.assignment[0] == 2
    assert decision.bound is None
    after = session.step(benefits, frozen=[{1: 3}, {1: 3}])
    assert after.assignment[1] == 3
    assert after.plan[0] == after.assignment
    if "capacity" not in options:
        assert len(set(after.assignment.values())) == 3


def test_changes_of_what_was_announced_cost() -> None:
    """A small gain does not change what was announced, a large one does, and the decision says for whom."""
    announced = np.array([[[1.0, 0.0]], [[1.0, 0.0]]])
    for better, task, changes in ((1.3, "x", ()), (1.7, "y", ("a",))):
        session = Session(DualLookahead(2), 0.0, announce=2, change_cost=0.5)
        assert session.step(announced, agents=["a"], tasks=["x", "y"]).plan == ({"a": "x"}, {"a": "x"})
        decision = session.step([[[1.0, better]]], agents=["a"], tasks=["x", "y"])
        assert decision.assignment == {"a": task}
        assert decision.changes == changes
        assert decision.gained == pytest.approx(1.0 if task == "x" else better - 0.5)
        assert decision.bound == pytest.approx(decision.value)


def test_threads_are_answered_one_after_another() -> None:
    """Calls from several threads are answered one by one, each with a step of its own."""
    session = Session(HAA(), 0.1)
    found: list[Decision] = []
    window = benefits_of(6, (1, 3, 4))
    threads = [threading.Thread(target=lambda: found.append(session.step(window))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(decision.step for decision in found) == list(range(8))


BAD_CALLS: list[tuple[dict[str, Any], str]] = [
    ({"agents": ["a", "a"]}, "agents: the id 'a' is there twice"),
    ({"agents": ["a"]}, "agents: 1 ids, but the benefits have 2"),
    ({"tasks": ["x", "y", 1.5]}, "tasks: ids are texts or whole numbers, got 1.5"),
    ({"tasks": "xyz"}, "tasks must be a list"),
    ({"benefits": np.full((1, 2, 3), np.nan)}, "agent 'a' for task 'x' at step 0"),
    ({"benefits": [sp.csr_array([[0.0, 1.0, 0.0], [0.0, 0.0, np.inf]])]}, "agent 'b' for task 'z' at step 0"),
    ({"benefits": np.ones((2, 3))}, "three axes"),
    ({"benefits": [[[1.0, 1.0, -np.inf], [-np.inf] * 3]]}, "agents 'b'"),
    ({"budget_s": -1.0}, "budget_s must be a finite number that is not negative"),
    ({"budget_s": np.nan}, "budget_s must be"),
    ({"budget_s": "soon"}, "budget_s must be"),
    ({"frozen": {"c": "x"}}, "frozen: the agent 'c' is not among the agents"),
    ({"frozen": {"a": "w"}}, "frozen: the task 'w' of agent 'a'"),
    ({"frozen": {"a": None}}, "needs a session with idle=True"),
    ({"frozen": {"a": "x", "b": "x"}}, "task 'x' is given to agents 'a', 'b'"),
    ({"frozen": [{}, {}]}, "frozen: 2 steps, but the benefits have 1"),
    ({"frozen": 3}, "only 0 steps"),
    ({"frozen": -1}, "frozen must not be negative"),
    ({"frozen": "all"}, "frozen must be"),
    ({"ends": 1}, "ends must be True or False"),
]


@pytest.mark.parametrize(
    ("change", "message"), BAD_CALLS, ids=lambda value: value if isinstance(value, str) else ""
)
def test_refused_calls_leave_no_trace(change: dict[str, Any], message: str) -> None:
    """What is wrong with a call is said by ids, and the session is what it was."""
    call: dict[str, Any] = {
        "benefits": benefits_of(7, (1, 2, 3)),
        "agents": ["a", "b"],
        "tasks": ["x", "y", "z"],
    }
    session, twin = Session(HAA(), 0.1), Session(HAA(), 0.1)
    assert session.step(**call).assignment == twin.step(**call).assignment
    before = session._standing
    bad = call | change
    with pytest.raises(ValueError, match=message):
        session.step(bad.pop("benefits"), **bad)
    assert session._standing is before
    later = call | {"benefits": benefits_of(8, (1, 2, 3))}
    assert session.step(**later).assignment == twin.step(**later).assignment


BAD_SESSIONS: list[tuple[dict[str, Any], str]] = [
    ({"policy": DualDecomposition()}, "policy must decide step by step"),
    ({"policy": HAA}, "policy must decide step by step"),
    ({"dynamics": "cheap"}, "dynamics must be"),
    ({"idle": 1}, "idle must be True or False"),
    ({"announce": 0}, "announce must be a whole number of at least 1"),
    ({"change_cost": -1}, "change_cost must be"),
    ({"capacity": {"x": -1}}, "capacity must be"),
    ({"capacity": 1.5}, "capacity must be"),
    ({"holding": ["x"]}, "holding must be"),
    ({"limits": [Limit(1.0, 3)]}, "takes once, work, handovers and cover"),
    ({"limits": [Limit.visits("x")]}, "takes once, work, handovers and cover"),
    ({"limits": [Limit.work("a", at_least=2)]}, "at_least needs a last step"),
    ({"limits": [Limit.cover("x", 1, steps=[0])]}, "steps have no meaning"),
    ({"policy": DistributedDualLookahead(2), "idle": True}, "does not take idle"),
]


@pytest.mark.parametrize(
    ("change", "message"), BAD_SESSIONS, ids=lambda value: value if isinstance(value, str) else ""
)
def test_bad_sessions(change: dict[str, Any], message: str) -> None:
    """What is wrong with a session is said when it is made."""
    options = {"policy": HAA(), "dynamics": 0.1} | change
    with pytest.raises(ValueError, match=message):
        Session(options.pop("policy"), options.pop("dynamics"), **options)


def test_too_many_agents_are_refused_by_name() -> None:
    """More agents than tasks is an error that says what to do."""
    session = Session(HAA(), 0.1)
    with pytest.raises(ValueError, match="idle=True"):
        session.step(np.ones((1, 3, 2)))


def test_capacity_by_name() -> None:
    """Capacities name tasks, wherever these stand; a cover is kept at every step."""
    session = Session(HAA(), 0.0, capacity={"x": 2, "z": 0}, idle=True, limits=[Limit.cover(["y"], 1)])
    window = np.ones((1, 3, 3)) * [3.0, 1.0, 9.0]
    found = session.step(window, agents=list("abc"), tasks=["x", "y", "z"]).assignment
    assert sorted(map(str, found.values())) == ["x", "x", "y"]
    found = session.step(window[:, :, ::-1], agents=list("abc"), tasks=["z", "y", "x"]).assignment
    assert sorted(map(str, found.values())) == ["x", "x", "y"]


def test_warm_leaves_the_session_as_it_is() -> None:
    """Warming up decides nothing, and says how long it took."""
    session = Session(DualLookahead(2), SyntheticSwitching(0.1))
    assert session.warm(agents=["a", "b"], tasks=3, budget_s=0.01) > 0
    assert session.steps == 0
    with pytest.raises(ValueError, match="warm needs"):
        session.warm()


def test_says_what_it_is() -> None:
    """Session and decision can be read."""
    session = Session(HAA(), SwitchingCost(0.5), holding={"a": "x"})
    assert session.assignment == {"a": "x"}
    decision = session.step([[[1.0, 0.0]]], agents=["a"], tasks=["x", "y"])
    assert "HAA" in repr(session)
    assert "1 agents" in repr(decision)
    assert decision.gap == pytest.approx(0.0, abs=1e-12)
    assert replace(decision, bound=None).gap is None
    assert all(outcome.message for outcome in Outcome)
