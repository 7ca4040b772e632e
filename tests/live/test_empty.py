"""Calls without agents or without tasks: nothing is decided, nothing breaks, and the session goes on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from session_windows import RULES

from sapopt import Limit, Session, SwitchingCost
from sapopt.live.service import asked
from sapopt.solvers import HAA, HAAL, DualLookahead

POLICIES = [DualLookahead(3), HAAL(2), HAA()]
WORTH = [[[1.0, 0.2], [0.3, 0.8]]] * 2


@pytest.mark.parametrize("policy", POLICIES, ids=lambda policy: policy.name)
@pytest.mark.parametrize("form", ["list", "array", "sparse"])
def test_without_tasks_all_idle(policy: Any, form: str) -> None:
    """Agents that may idle do so; what they take up afterwards is a handover."""
    session = Session(policy, SwitchingCost(0.5), idle=True, announce=2)
    assert session.step(WORTH, agents=["a", "b"], tasks=["x", "y"]).assignment == {"a": "x", "b": "y"}
    nothing: Any = {
        "list": [[[], []]] * 2, "array": np.zeros((2, 2, 0)), "sparse": [sp.csr_array((2, 0))] * 2,
    }[form]  # fmt: skip
    decision = session.step(nothing, agents=["a", "b"], tasks=[])
    assert decision.assignment == session.assignment == {"a": None, "b": None}
    assert decision.value == decision.gained == 0.0
    after = session.step(WORTH, agents=["a", "b"], tasks=["x", "y"])
    assert after.assignment == {"a": "x", "b": "y"}
    assert after.gained == pytest.approx(1.8 - 2 * 0.5)


@pytest.mark.parametrize("policy", POLICIES, ids=lambda policy: policy.name)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("first", [True, False], ids=["at first", "later"])
def test_without_agents_time_goes_on(policy: Any, rule: str, first: bool, tmp_path: Path) -> None:
    """Nobody has an empty assignment; whoever comes next is new, also when the session was in a file meanwhile."""
    session = Session(policy, RULES[rule](), idle=True, announce=2, limits=[Limit.once(None)])
    if not first:
        session.step(WORTH, agents=["a", "b"], tasks=["x", "y"])
    decision = session.step(np.zeros((2, 0, 2)), agents=[], tasks=["x", "y"], frozen=0)
    assert (decision.assignment, decision.plan, decision.value) == ({}, ({}, {}), 0.0)
    assert session.steps == (1 if first else 2)
    session.save(tmp_path / "session.npz")
    again = Session.load(tmp_path / "session.npz")
    fresh = Session(policy, RULES[rule](), idle=True, announce=2, limits=[Limit.once(None)])
    if not first:  # from then on, what an agent takes up is a handover
        fresh.step(WORTH, agents=["e", "f"], tasks=["p", "q"])
    tasks = ["v", "w"]  # new ones, since those that were looked at are used up
    expected = fresh.step(WORTH, agents=["c", "d"], tasks=tasks).assignment
    for one in (session, again):
        assert one.step(WORTH, agents=["c", "d"], tasks=tasks, frozen=0).assignment == expected
        assert one.steps == (2 if first else 3)


def test_refusals() -> None:
    """Agents that must have a task, and benefits of another shape, are named; the session stays as it was."""
    session = Session(HAA())
    with pytest.raises(ValueError, match=r"tasks: there is none.*idle=True"):
        session.step(np.zeros((1, 2, 0)), agents=["a", "b"], tasks=[])
    for values, agents, tasks in (
        (np.zeros((1, 2, 1)), [], ["x"]),
        (np.zeros((1, 2, 1)), ["a", "b"], []),
        (0.0, [], []),
        ([], [], []),
        ([[[]], [[], []]], [], ["x"]),
    ):
        with pytest.raises(ValueError, match="benefits must have the shape"):
            session.step(values, agents=agents, tasks=tasks)
    assert session.steps == 0


def test_of_a_request() -> None:
    """The service takes requests without agents or tasks."""
    session = Session(HAA(), idle=True)
    for agents, tasks, expected in (([], ["x"], {}), (["a"], [], {"a": None}), ([], [], {})):
        given = asked({"agents": agents, "tasks": tasks, "benefits": [[], []]})
        assert session.step(given.pop("benefits"), **given).assignment == expected
    with pytest.raises(ValueError, match="benefits must have at least one step"):
        asked({"agents": [], "tasks": [], "benefits": []})
