"""The web service: hundreds of steps by HTTP in which everything changes, the same decisions, clear refusals."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sapopt import Session, SwitchingCost
from sapopt.solvers import HAA, DualLookahead

pytest.importorskip("fastapi")
from fastapi.testclient import TestClient

from sapopt.live.service import EXAMPLE, create_app


def request(k: int) -> dict[str, Any]:
    """A call of a world in which another agent fails at every step, and tasks are replaced."""
    rng = np.random.default_rng(k)
    agents: list[str | int] = [f"sat {i}" if i % 2 else i for i in range(6) if i != k % 7]
    tasks = [f"task {j}" for j in range(k // 3, k // 3 + 8)]
    benefits = [
        [
            [agent, task, round(float(rng.random()), 3)]
            for agent in agents
            for task in tasks
            if rng.random() < 0.4
        ]
        for _ in range(3)
    ]
    return {"agents": agents, "tasks": tasks, "benefits": benefits}


def dense(call: dict[str, Any]) -> np.ndarray:
    """The benefits of a call as an array."""
    out = np.zeros((len(call["benefits"]), len(call["agents"]), len(call["tasks"])))
    for k, step in enumerate(call["benefits"]):
        for agent, task, benefit in step:
            out[k, call["agents"].index(agent), call["tasks"].index(task)] = benefit
    return out


@pytest.mark.parametrize("steps", [40, pytest.param(500, marks=pytest.mark.slow)])
def test_decides_as_the_session_does(steps: int, tmp_path: Path) -> None:
    """Every answer is that of a session in this process, and the file goes on where the service stopped."""
    path = tmp_path / "session.npz"
    client = TestClient(create_app(Session(DualLookahead(2), SwitchingCost(0.2)), save_to=path))
    twin = Session(DualLookahead(2), SwitchingCost(0.2))
    for k in range(steps):
        call = request(k)
        answer = client.post("/step", json=call)
        assert answer.status_code == 200, answer.text
        found, expected = answer.json(), twin.step(dense(call), agents=call["agents"], tasks=call["tasks"])
        assert dict(found["assignment"]) == expected.assignment
        assert found["step"] == k
        assert found["value"] == pytest.approx(expected.value)
        assert found["bound"] == pytest.approx(expected.bound)
    state = client.get("/state").json()
    assert state["step"] == steps
    assert Session.load(path).assignment == twin.assignment


def test_frozen_and_budget_by_request() -> None:
    """Pins, budgets and the end are parts of a request."""
    client = TestClient(create_app(Session(HAA(), 0.1, idle=True)))
    call = {"agents": ["a", "b"], "tasks": ["x", "y"], "benefits": [[["a", "x", 1.0], ["b", "y", 1.0]]]}
    frozen = [[["a", "y"], ["b", None]]]
    found = client.post("/step", json=call | {"frozen": frozen, "budget_s": 5.0, "ends": True}).json()
    assert found["assignment"] == [["a", "y"], ["b", None]]
    assert client.post("/step", json=call | {"frozen": 0}).json()["status"] == "complete"


BAD: list[tuple[dict[str, Any], str]] = [
    ({"agents": None}, "agents must be a list"),
    ({"tasks": "x"}, "tasks must be a list"),
    ({"agents": ["a", "a"]}, "'a' is there twice"),
    ({"benefits": [[["a", "w", 1.0]]]}, "['a', 'w', 1.0] is not"),
    ({"benefits": [3]}, "3 is not"),
    ({"benefits": [[["a", "x", "much"]]]}, "is not [agent id, task id, number]"),
    ({"benefits": [[[["a"], "x", 1.0]]]}, "is not [agent id, task id, number]"),
    ({"budget_s": -1}, "budget_s"),
    ({"frozen": [3]}, "frozen must have"),
    ({"frozen": [[["a", "w"]]]}, "task 'w'"),
    ({"wishes": 3}, "wishes: the service knows"),
]


@pytest.mark.parametrize(
    ("change", "message"), BAD, ids=lambda value: value if isinstance(value, str) else ""
)
def test_refusals(change: dict[str, Any], message: str) -> None:
    """A wrong request is answered by 422 and one line, and changes nothing."""
    session = Session(HAA(), 0.1)
    client = TestClient(create_app(session))
    call = {"agents": ["a", "b"], "tasks": ["x", "y"], "benefits": [[["a", "x", 1.0]]]}
    answer = client.post("/step", json=call | change)
    assert answer.status_code == 422
    assert message in answer.json()["detail"]
    assert session.steps == 0


def test_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without FastAPI the error names the extra."""
    found = builtins.__import__

    def without(name: str, *args: Any, **options: Any) -> Any:
        if name == "fastapi":
            raise ImportError(name)
        return found(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match="serve"):
        create_app(Session(HAA(), 0.1))


def test_the_page_of_documentation_has_an_example() -> None:
    """The request that the service shows on its own page is one that it answers."""
    client = TestClient(create_app(Session(HAA(), SwitchingCost(0.2))))
    assert client.post("/step", json=EXAMPLE).json()["assignment"] == [["north", "port"], ["south", "field"]]
    assert EXAMPLE["tasks"][0] in client.get("/openapi.json").text
