"""Sessions in files: a session taken up again goes on as if nothing had happened, and no file is trusted."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from session_windows import RULES, benefits_of

from sapopt import Limit, Session, SwitchingCost, Team
from sapopt.data.files import read_npz, write_npz
from sapopt.dynamics import AgentLocal, Battery
from sapopt.live.saving import _ENTRIES, _FORMAT, _PREFIXES
from sapopt.running.outlook import Outlook
from sapopt.solvers import HAA, HAAL, AssignmentPolicy, DualLookahead, myopic

POLICIES = [DualLookahead(3), HAAL(3), HAAL(3, keep_plan=True), HAA(), AssignmentPolicy(myopic)]


def call(k: int) -> dict[str, Any]:
    """The k-th call of a world in which agents and tasks come and go."""
    agents = [f"a{i}" for i in range(4) if (i + k) % 4]
    tasks = [f"t{(j + k // 2)}" for j in range(5)]
    return {"benefits": benefits_of(k, (3, len(agents), len(tasks))), "agents": agents, "tasks": tasks}


def step(session: Session, k: int, **options: Any) -> tuple[Any, ...]:
    """All that a decision says but for the time it took."""
    given = call(k)
    decision = session.step(given.pop("benefits"), **given, **options)
    return (
        decision.assignment,
        decision.plan,
        decision.value,
        decision.bound,
        decision.gained,
        decision.changes,
    )


def test_a_pickled_session_goes_on_by_itself() -> None:
    """A session sent to a worker stands where it stood and shares nothing with the one that stayed."""
    session = Session(DualLookahead(3), announce=2)
    for k in range(5):
        sent = pickle.loads(pickle.dumps(session))
        expected = step(session, k)
        assert step(sent, k) == expected
        assert (sent.steps, sent.assignment) == (session.steps, session.assignment)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("policy", POLICIES, ids=lambda policy: policy.name)
def test_goes_on_as_it_would_have(policy: Any, rule: str, tmp_path: Path) -> None:
    """After every call a session read from its file answers as the one that was never interrupted."""
    session = Session(policy, RULES[rule](), announce=2, change_cost=0.1)
    path = tmp_path / "session.npz"
    for k in range(5):
        session.save(path)
        again = Session.load(path)
        assert step(again, k) == step(session, k)
        assert again.assignment == session.assignment
        assert again.announced == session.announced


def test_limits_and_options_are_kept(tmp_path: Path) -> None:
    """Limits with their use so far, capacities and everything else that a session was made with are in the file."""
    limits = [
        Limit.once(times=2),
        Limit.work(["a1", "a2"], at_most=3),
        Limit.handovers(9),
        Team("t3", 2, 0.5),
    ]
    session = Session(
        DualLookahead(3), Battery(0.1, 0.5, 0.25), idle=True, capacity={"t3": 2}, limits=limits, seed=3,
        holding={"a1": "t1"}, prove=False,
    )  # fmt: skip
    path = tmp_path / "session.npz"
    for k in range(4):
        session.save(path)
        again = Session.load(path)
        assert again._settings.capacity == {"t3": 2}
        assert again._standing.used == session._standing.used
        assert step(again, k) == step(session, k)


class Lazy:
    """A policy of one's own."""

    name = "Lazy"

    def begin(self, problem: Any, rng: Any) -> None:
        return None

    def act(self, outlook: Outlook, memory: None) -> tuple[np.ndarray, None]:
        return np.arange(outlook.problem.n), None


def cheap(step: int, agents: Any, tasks: Any) -> SwitchingCost:
    """A dynamics made for every window."""
    return SwitchingCost(0.01 * step)


def test_own_code_is_handed_over(tmp_path: Path) -> None:
    """Policies and dynamics of one's own are in no file; they are asked for by name."""
    path = tmp_path / "session.npz"
    session = Session(Lazy(), cheap)
    step(session, 0)
    session.save(path)
    again = Session.load(path, policy=Lazy(), dynamics=cheap)
    assert step(again, 1) == step(session, 1)
    for given, message in [
        ({}, "its policy, Lazy, is in no file"),
        ({"policy": Lazy()}, "its dynamics, function, is in no file"),
        ({"policy": HAA(), "dynamics": cheap}, "was saved with Lazy, got HAA"),
        ({"policy": Lazy(), "dynamics": SwitchingCost(0.1)}, "was saved with function, got SwitchingCost"),
        ({"policy": 3, "dynamics": cheap}, "policy must decide"),
    ]:
        with pytest.raises(ValueError, match=message):
            Session.load(path, **given)
    Session(HAA(), 0.1).save(path)
    with pytest.raises(ValueError, match="holds the dynamics itself"):
        Session.load(path, dynamics=SwitchingCost(0.1))


@dataclass(frozen=True, eq=False)
class Tiring(AgentLocal):
    """Work tires an agent by a level, rest takes one away; each level costs."""

    loss: float = 0.2

    def start(self, problem: Any) -> np.ndarray:
        return np.zeros(problem.n, dtype=np.int64)

    def rule(self, k: int, agent: Any, local: Any, task: Any, benefit: Any) -> tuple[Any, Any]:
        return -self.loss * local, np.clip(local + np.where(benefit > 0, 1, -1), 0, 4)

    def fingerprint(self) -> list[Any]:
        return ["Tiring 1", self.loss]


def test_own_dynamics_by_fingerprint(tmp_path: Path) -> None:
    """A class that tells its fingerprint is rebuilt with its parameters, and one that tells another is refused."""
    path = tmp_path / "session.npz"
    session = Session(HAA(), Tiring(0.3))
    step(session, 0)
    session.save(path)
    for given in (Tiring, Tiring(0.3)):
        again = Session.load(path, dynamics=given)
        assert step(again, 1) == step(Session.load(path, dynamics=Tiring), 1)
    assert step(Session.load(path, dynamics=Tiring), 1) == step(session, 1)
    with pytest.raises(ValueError, match="tells another fingerprint"):
        Session.load(path, dynamics=Tiring(0.2))
    with pytest.raises(ValueError, match=r"hand the class over: Session\.load\(path, dynamics=Tiring\)$"):
        Session.load(path)


def test_states_of_unknown_form_are_refused(tmp_path: Path) -> None:
    """A state that is not told by agents is not written."""

    class Own:
        def initial_state(self, problem: Any) -> int:
            return 0

        def handover(self, k: int, state: int) -> np.ndarray:
            return np.zeros((3, 5))

        def transition(self, k: int, state: int, assignment: Any) -> int:
            return state + 1

    session = Session(HAA(), Own())
    session.save(tmp_path / "new.npz")  # nothing is carried yet
    step(session, 0)
    with pytest.raises(ValueError, match="agent_columns"):
        session.save(tmp_path / "later.npz")
    assert not (tmp_path / "later.npz").exists()


DAMAGES: list[dict[str, Any]] = [
    {"step": -1}, {"step": "2"}, {"agents": ["a1"]}, {"agents": ["a1", "a1", "a2"]}, {"tasks": [1.5] * 5},
    {"policy": {"class": "system", "options": {}}}, {"policy": {"class": "HAA", "options": {"looks": 3}}},
    {"announce": 0.5}, {"capacity": "all"}, {"holding": 3}, {"used": [[0]]}, {"announced": [[["a", 2.5]]]},
    {"decided": None}, {"rows": 3}, {"change_cost": None}, {"idle": 0}, {"dynamics": "os.system"},
]  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: next(iter(damage)))
def test_damaged_files_are_refused(damage: dict[str, Any], tmp_path: Path) -> None:
    """A file that says something impossible is refused with a ValueError that names it."""
    path = tmp_path / "session.npz"
    session = Session(HAA(), 0.1)
    step(session, 1)
    session.save(path)
    meta, arrays = read_npz(path, _FORMAT, _ENTRIES, 2**20, prefix=_PREFIXES)
    write_npz(path, meta | {"format": _FORMAT} | damage, arrays)
    with pytest.raises(ValueError, match=r"session\.npz|unknown dynamics"):
        Session.load(path)


@pytest.mark.parametrize("held", [[7, 0, 1], [-2, 0, 1], [0, 1]])
def test_tasks_that_are_not_there_are_refused(held: list[int], tmp_path: Path) -> None:
    """A file whose agents hold impossible tasks is refused."""
    path = tmp_path / "session.npz"
    session = Session(HAA(), 0.1)
    step(session, 1)
    session.save(path)
    meta, arrays = read_npz(path, _FORMAT, _ENTRIES, 2**20, prefix=_PREFIXES)
    write_npz(path, meta | {"format": _FORMAT}, arrays | {"held": np.array(held)})
    with pytest.raises(ValueError, match="hold tasks that are not there"):
        Session.load(path)


CHILD = """
import json, os, signal, sys
sys.path.insert(0, sys.argv[2])
from test_saving import step
from sapopt import Session, SwitchingCost
from sapopt.solvers import DualLookahead
session = Session(DualLookahead(3), SwitchingCost(0.2))
for k in range(3):
    step(session, k)
    session.save(sys.argv[1])
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="the platform cannot kill like this")
def test_taken_up_after_a_kill(tmp_path: Path) -> None:
    """A process that saves after every call and is killed loses nothing: another one goes on as the same session."""
    path = tmp_path / "session.npz"
    here = Path(__file__).parent
    env = dict(os.environ) | {"PYTHONPATH": os.pathsep.join([str(here.parents[1]), str(here.parent)])}
    done = subprocess.run([sys.executable, "-c", CHILD, str(path), str(here)], env=env, check=False)
    assert done.returncode == -signal.SIGKILL
    whole = Session(DualLookahead(3), SwitchingCost(0.2))
    expected = [step(whole, k) for k in range(6)][3:]
    again = Session.load(path)
    assert again.steps == 3
    assert [step(again, k) for k in range(3, 6)] == expected
    assert json.dumps(expected[0][0])  # ids are plain
