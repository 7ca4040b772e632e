"""Who does what, from when to when: a plan as a list of stays, with the names and times of its problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sapopt.data.times import Time, step_ends
from sapopt.data.types import IntArray

if TYPE_CHECKING:
    from sapopt.problem.sap import SAP


@dataclass(frozen=True)
class Stay:
    """An agent on a task over consecutive steps.

    Attributes
    ----------
    agent, task : str or int
        Labels where the problem has them, else 0-based numbers.
    start, stop : datetime, int, float or None
        When the stay begins and ends, by the problem's times: it ends where the step after it begins, and the last step
        lasts as long as the one before. Without times, the first step and the step after the last one, 0-based. `stop`
        is None only where nobody can tell, for a problem of one step with a time stamp.
    benefit : float
        Sum of the benefits.
    handover : float
        Sum of the handover terms of these steps, negative where they cost.
    """

    agent: str | int
    task: str | int
    start: Time
    stop: Time | None
    benefit: float
    handover: float


def spans(plan: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """First step, stop and agent of every stay of a plan (T, n), by agent and step; -1 is no task."""
    T, n = plan.shape
    by_agent = plan.T
    begins = np.ones((n, T), dtype=bool)
    begins[:, 1:] = by_agent[:, 1:] != by_agent[:, :-1]
    agent, first = np.nonzero(begins)
    stop = np.where(np.append(agent[1:], -1) == agent, np.append(first[1:], 0), T)
    holds = by_agent[agent, first] >= 0
    return first[holds], stop[holds], agent[holds]


def stays(problem: SAP, plan: IntArray) -> list[Stay]:
    """The stays of a checked plan (T, n), agent by agent, each in the order of time."""
    held, eta = problem.terms(plan)
    ends = None if problem.times is None else step_ends(problem.times)
    out = []
    for first, stop, agent in zip(*(part.tolist() for part in spans(plan)), strict=True):
        start: Time = first if problem.times is None else problem.times[first]
        end: Time | None = stop if ends is None else ends[stop - 1]
        span = slice(first, stop)
        out.append(
            Stay(
                problem.agent_label(agent), problem.task_label(int(plan[first, agent])), start, end,
                float(held[span, agent].sum()), float(eta[span, agent].sum()) + 0.0,
            )
        )  # fmt: skip
    return out
