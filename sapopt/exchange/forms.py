"""A plan as columns: stays, one row a step with a column for each agent, or one row a step and agent."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from sapopt.problem.result import Result
from sapopt.problem.sap import SAP

Form = Literal["stays", "wide", "long"]
FORMS: tuple[Form, ...] = ("stays", "wide", "long")


def owner(result: Result, problem: SAP | None) -> SAP:
    """The problem of a result: the one given, or the one that the result holds.

    Raises
    ------
    ValueError
        If there is none, or the plan does not fit it.
    """
    known = result.problem if problem is None else problem
    if known is None:
        raise ValueError(
            "problem: a result that was read from a file does not hold its problem; pass it, for example "
            "SAP.load(...)"
        )
    if not isinstance(known, SAP):
        raise ValueError(f"problem must be a SAP, got {type(known).__name__}")
    known.check_plan(result.plan)
    return known


def columns(problem: SAP, result: Result, form: str) -> dict[Any, list[Any]]:
    """The plan of a result in one of `FORMS`, as lists by the names of the columns.

    Raises
    ------
    ValueError
        If there is no such form, or two agents have one name where each needs a column.
    """
    if form not in FORMS:
        raise ValueError(f"form must be one of {', '.join(map(repr, FORMS))}, got {form!r}")
    if form == "stays":
        found = result.stays(problem)
        names = ("agent", "task", "start", "stop", "benefit", "handover")
        rows = [(s.agent, s.task, s.start, s.stop, s.benefit, s.handover) for s in found]
        return {name: [row[place] for row in rows] for place, name in enumerate(names)}
    steps: list[Any] = list(range(problem.T)) if problem.times is None else list(problem.times)
    agents = [problem.agent_label(i) for i in range(problem.n)]
    held = [[_task(problem, j) for j in row] for row in result.plan.tolist()]
    if form == "wide":
        if len({"step", *agents}) <= len(agents):
            raise ValueError("agents: each needs a name of its own, other than 'step', to be a column")
        return {"step": steps, **{agent: [row[i] for row in held] for i, agent in enumerate(agents)}}
    benefit, handover = problem.terms(result.plan)
    return {
        "step": np.repeat(np.array(steps, dtype=object), problem.n).tolist(),
        "agent": agents * problem.T,
        "task": [task for row in held for task in row],
        "benefit": benefit.ravel().tolist(),
        "handover": (handover + 0.0).ravel().tolist(),
    }


def _task(problem: SAP, j: int) -> str | int | None:
    """The task as the tables show it; nothing is None among labels and -1 among numbers."""
    if j < 0:
        return -1 if problem.tasks is None else None
    return problem.task_label(j)
