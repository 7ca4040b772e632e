"""From the plain problem that stands for one with limits back to that one: what a planner tells, and what it found."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from sapopt.formulations.limited.folded import Folded
from sapopt.formulations.limited.folded_dual import FoldedPaths
from sapopt.problem.result import Status
from sapopt.running.control import Progress, Run
from sapopt.solvers.base import Outcome, gap_unit


def folded_run(folded: Folded, run: Run) -> Run:
    """A run for the plain problem that tells of values and bounds of the problem with limits."""

    def told(progress: Progress) -> bool:
        value, bound = _less(progress.value, folded.paid), _less(progress.bound, folded.paid)
        run.report(progress.done, progress.total, value, bound, progress.message)
        return run.stopped  # that its time is over the plain run knows by itself

    left = run.seconds_left
    return Run(run.seed, None if math.isinf(left) else max(left, 0.0), told, run.start, run)


def unfolded(folded: Folded, outcome: Outcome, tolerance: float) -> Outcome:
    """The outcome of the plain problem as one of the problem with limits."""
    problem = folded.given
    bound = outcome.bound
    if bound is not None:
        bound = FoldedPaths(folded).whole(bound, np.zeros(problem.n))
    status = outcome.status
    if status is Status.OPTIMAL and bound is not None:
        value = problem.evaluate(outcome.plan).value
        # the penalties that are paid anyhow are no part of the value that the gap is compared with
        is_proven = bound - value <= tolerance * max(gap_unit(problem), abs(value))
        status = Status.OPTIMAL if is_proven else Status.FEASIBLE
    return replace(
        outcome, bound=bound, status=status, trace=[_line(line, folded.paid) for line in outcome.trace],
        limit_prices=folded.multipliers, team_prices=np.zeros(0),
    )  # fmt: skip


def _line(line: dict[str, Any], paid: float) -> dict[str, Any]:
    """A line of the trace."""
    out = {**line, "value": _less(line.get("value"), paid), "bound": _less(line.get("bound"), paid)}
    if out["value"] is not None and out["bound"] is not None and "gap" in line:
        out["gap"] = (out["bound"] - out["value"]) / max(abs(out["bound"]), 1e-300)
    return out


def _less(number: float | None, paid: float) -> float | None:
    return None if number is None else number - paid
