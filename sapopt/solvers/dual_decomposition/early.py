"""An early plan by a receding horizon, made long before the prices of all steps have settled."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from sapopt.data.feasibility import InfeasibleError
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.running.rollout import rollout
from sapopt.solvers.dual_decomposition.plans import Found
from sapopt.solvers.dual_lookahead import DualLookahead

_SHARE, _SECONDS, _WINDOW = 0.08, 4.0, 8
"""Share of the time limit that it may take, its most seconds, and the steps it looks at."""


def looked_ahead(problem: SAP, run: Run, report: Callable[[str], bool]) -> Iterator[Found]:
    """The plan of `DualLookahead` in a small part of a run with a time limit.

    The dynamics has to value first tasks (`sapopt.solvers.dual_lookahead.values_first_tasks`).
    """
    phase = "looking ahead"
    part = run.part(min(_SHARE * (run.time_limit or 0.0), _SECONDS))
    part.callback = lambda progress: report(phase)
    try:
        yield phase, rollout(problem, DualLookahead(_WINDOW), part).plan
    except InfeasibleError:
        return  # it runs into a dead end that plans avoid
