"""A session as a web service: `create_app(session)` gives a FastAPI application (extra ``serve``).

``POST /step`` takes the pairs that are worth something, by id, and answers with the decision; ``GET /state`` tells
where the session stands. What is wrong with a call is answered by status 422 and one line.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sapopt.live.decision import Decision
from sapopt.live.names import checked_names
from sapopt.live.session import Session

if TYPE_CHECKING:
    from fastapi import FastAPI

EXAMPLE: dict[str, Any] = {
    "agents": ["north", "south"],
    "tasks": ["port", "field"],
    "benefits": [
        [["north", "port", 1.0], ["north", "field", 0.9], ["south", "field", 0.8]],
        [["north", "port", 0.9], ["south", "field", 0.9]],
    ],
    "budget_s": 0.1,
}
"""A request, which the service's own page of documentation shows."""


def create_app(
    session: Session, *, save_to: str | Path | None = None, budget_s: float | None = None
) -> FastAPI:
    """A web service around a session.

    Parameters
    ----------
    session : Session
    save_to : str or Path, optional
        The session is written here after every step, before the answer goes out.
    budget_s : float, optional
        Of a step that names none.

    Returns
    -------
    fastapi.FastAPI

    Raises
    ------
    ImportError
        If FastAPI is not installed.
    """
    try:
        from fastapi import Body, FastAPI, HTTPException
    except ImportError:
        raise ImportError("the service needs FastAPI: pip install 'sapopt[serve]'") from None
    app = FastAPI(title="sapopt session")

    # Plain functions: FastAPI runs them in threads, so that a step keeps nobody waiting but other steps.
    def step(body: dict[str, Any] = Body(..., examples=[EXAMPLE])) -> dict[str, Any]:  # noqa: B008  # FastAPI's way
        """Decide. `benefits` has, for each of the next steps, the pairs that are worth something, as
        `[agent, task, benefit]`; the first step begins now. `budget_s`, `frozen` and `ends` may be left out.
        """
        try:
            given = asked(body)
            decision = session.step(given.pop("benefits"), **{"budget_s": budget_s} | given)
        except ValueError as error:
            raise HTTPException(422, str(error)) from None
        if save_to is not None:
            session.save(save_to)
        return answer(decision)

    def state() -> dict[str, Any]:
        """How many steps were decided, what everybody holds now, and what was announced."""
        return {
            "step": session.steps, "assignment": pairs(session.assignment),
            "announced": [pairs(later) for later in session.announced],
        }  # fmt: skip

    app.post("/step")(step)
    app.get("/state")(state)
    return app


def asked(body: dict[str, Any]) -> dict[str, Any]:
    """The arguments of `Session.step` in a request.

    Parameters
    ----------
    body : dict
        ``agents`` and ``tasks``, lists of ids; ``benefits``, for each step of the window a list of
        ``[agent id, task id, benefit]``, where pairs that are left out are worth nothing; and, if wanted, ``budget_s``,
        ``frozen`` (a number of steps, or for each frozen step a list of ``[agent id, task id or null]``) and ``ends``.

    Raises
    ------
    ValueError
        If something is missing or unknown.
    """
    unknown = body.keys() - {"agents", "tasks", "benefits", "budget_s", "frozen", "ends"}
    if unknown:
        raise ValueError(
            f"{sorted(unknown)[0]}: the service knows agents, tasks, benefits, budget_s, frozen and ends"
        )
    for name in ("agents", "tasks", "benefits"):
        if not isinstance(body.get(name), list):
            raise ValueError(f"{name} must be a list")
    if not body["benefits"]:
        raise ValueError("benefits must have at least one step, the one that begins now")
    agents = checked_names(body["agents"], len(body["agents"]), "agents")
    tasks = checked_names(body["tasks"], len(body["tasks"]), "tasks")
    rows = {name: place for place, name in enumerate(agents)}
    columns = {name: place for place, name in enumerate(tasks)}
    window = [_step(entries, k, rows, columns) for k, entries in enumerate(body["benefits"])]
    out: dict[str, Any] = {"benefits": window, "agents": agents, "tasks": tasks}
    out |= {name: body[name] for name in ("budget_s", "ends") if name in body}
    frozen = body.get("frozen")
    if isinstance(frozen, list):
        try:
            frozen = [dict(step) for step in frozen]
        except (TypeError, ValueError):
            raise ValueError(
                "frozen must have, for each step, a list of [agent id, task id or null]"
            ) from None
    return out | {"frozen": frozen}


def _step(entries: Any, k: int, rows: dict[Any, int], columns: dict[Any, int]) -> sp.csr_array:
    """The benefits of one step."""
    places, values = [], []
    for entry in entries if isinstance(entries, list) else [entries]:
        try:
            agent, task, benefit = entry
            places.append((rows[agent], columns[task]))
            values.append(float(benefit))
        except (TypeError, ValueError, KeyError):
            raise ValueError(
                f"benefits at step {k}: {entry!r} is not [agent id, task id, number] with ids of this call"
            ) from None
    row, column = np.array(places, dtype=np.int64).reshape(-1, 2).T
    return sp.csr_array((np.array(values, dtype=np.float64), (row, column)), shape=(len(rows), len(columns)))


def pairs(assignment: dict[Any, Any]) -> list[list[Any]]:
    """An assignment as a list, because keys of JSON are texts and ids may be numbers."""
    return [[agent, task] for agent, task in assignment.items()]


def answer(decision: Decision) -> dict[str, Any]:
    """A decision as plain values."""
    return {
        "step": decision.step, "assignment": pairs(decision.assignment),
        "plan": [pairs(step) for step in decision.plan], "value": decision.value, "bound": decision.bound,
        "gained": decision.gained, "seconds": decision.seconds, "status": decision.status.value,
        "message": decision.status.message, "changes": list(decision.changes),
    }  # fmt: skip
