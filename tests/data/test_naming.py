"""Names in messages: the nurse by her name, the shift by its time, numbers where there are none."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import numpy as np
import pytest

from sapopt import SAP, Limit, SwitchingCost, solve, why_not
from sapopt.data.naming import Naming
from sapopt.domains.chance import Failures
from sapopt.formulations.synthetic import synthetic_agents, synthetic_tasks
from sapopt.plotting import benefit_history, timeline
from sapopt.solvers import HAA

NAMES: dict[str, Any] = {
    "agents": ["Eva", "Ada"], "tasks": ["ward", "lab", "night"],
    "times": [datetime(2026, 3, 1) + timedelta(hours=8 * k) for k in range(3)],
}  # fmt: skip
CUBE = np.random.default_rng(0).random((3, 2, 3))


def test_words() -> None:
    """Names in quotes, numbers without; long lists end in dots."""
    named = Naming(("Eva", "Ada"), ("ward",), (10, 20))
    assert (named.agent(1), named.task(0), named.step(1)) == ("agent 'Ada'", "task 'ward'", "step 1 (20)")
    assert (Naming().agent(1), Naming().task(0), Naming().step(1)) == ("agent 1", "task 0", "step 1")
    assert named.several([1, 0]) == "agents 'Ada', 'Eva'"
    assert Naming().several(range(9)) == "agents 0, 1, 2, 3, 4, 5, 6, 7, ..."
    assert named.task(-1) == "task -1"


FIRST = "step 0 (2026-03-01T00:00:00)"


@pytest.mark.parametrize("idle", [False, True])
@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ([[0, 0], [0, 1], [0, 1]], f"task 'ward' is given to agents 'Eva', 'Ada' at {FIRST}"),
        ([[0, 3], [0, 1], [0, 1]], f"task 3 of agent 'Ada' at {FIRST} is outside"),
        ([[1, 0], [0, 1], [0, 1]], f"agent 'Eva' may not take task 'lab' at {FIRST} (the pair is forbidden)"),
    ],
)
def test_plans(plan: Any, words: str, idle: bool) -> None:
    """What is wrong with a plan is said by names."""
    values = CUBE.copy()
    values[0, 0, 1] = -np.inf
    with pytest.raises(ValueError) as told:
        SAP(values, 0.2, idle=idle, **NAMES).evaluate(plan)
    assert words in str(told.value)


def test_limits_and_capacities() -> None:
    """A broken limit names whom it is about, a full task who holds it."""
    problem = SAP(CUBE, 0.2, limits=[Limit.work(["Eva"], at_most=1)], **NAMES)
    with pytest.raises(
        ValueError, match=r"limit 'work\[Eva\]'.*agent 'Eva' at step 0 \(2026-03-01T00:00:00\)"
    ):
        problem.evaluate([[0, 1]] * 3)
    problem = SAP(CUBE, 0.2, idle=True, capacity=[2, 1, 1], **NAMES)
    with pytest.raises(ValueError, match="task 'lab' is given to agents 'Eva', 'Ada' at step 0"):
        problem.evaluate([[1, 1]] * 3)
    with pytest.raises(ValueError, match="initial_assignment gives task 'lab' to two agents"):
        SAP(CUBE, 0.2, [1, 1], **NAMES)


def test_where_no_plan_exists() -> None:
    """Those who are short of tasks are named when the problem is built."""
    values = CUBE.copy()
    values[1, :, 1:] = -np.inf
    with pytest.raises(
        ValueError, match=r"benefits at step 1 \(2026-03-01T08.*agents 'Eva', 'Ada' \(2 in all\)"
    ):
        SAP(values, 0.2, **NAMES)


def test_why_not() -> None:
    """The explanation speaks of names."""
    problem = SAP(CUBE, 0.2, **NAMES)
    result = solve(problem, HAA())
    told = str(why_not(problem, result, "Ada", "ward", 0))
    assert "agent 'Ada' on task 'ward' at step 0 (2026-03-01T00:00:00)" in told


def test_copies_keep_names() -> None:
    """Several agents or tasks made of one bear its name with a number, and the times stay."""
    base = SAP(CUBE, SwitchingCost(0.2), **NAMES)
    many = synthetic_agents(base, [2, 1]).problem
    assert many.agents == ("Eva #1", "Eva #2", "Ada")
    assert many.tasks == ("ward", "lab", "night", "idle 0", "idle 1", "idle 2")
    teams = synthetic_tasks(base, [1, 2, 1]).problem
    assert teams.agents == ("Eva", "Ada")
    assert teams.tasks == ("ward", "lab #1", "lab #2", "night")
    assert many.times == teams.times == base.times
    failing = Failures(0.5).in_hindsight(base, 0)
    assert (failing.agents, failing.tasks, failing.times) == (base.agents, base.tasks, base.times)
    assert synthetic_agents(SAP(CUBE, SwitchingCost(0.2)), 2).problem.agents is None


def test_figures() -> None:
    """The timeline and the history of an agent are labelled by name, and asked for by name."""
    problem = SAP(CUBE, 0.2, **NAMES)
    result = solve(problem, HAA())
    rows = timeline(problem, result, agents=["Ada", "Eva"])
    assert [label.get_text() for label in rows.get_yticklabels()] == ["Ada", "Eva"]
    assert "agent 'Ada'" in benefit_history(problem, {"HAA": result}, "Ada").get_ylabel()
