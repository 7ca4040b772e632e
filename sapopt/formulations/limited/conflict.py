"""Why no plan exists: the limits that contradict each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sapopt.formulations.highs import Ending, Programme, maximise
from sapopt.formulations.limited.graph import PathGraph
from sapopt.formulations.limited.programme import LimitedProgramme, limited_programme

_SECONDS = 10.0
"""For the search of a small set of limits."""
_MOST = 200
"""Limits up to which each is left out once, to see whether the rest still contradict each other."""


def explain(graph: PathGraph) -> str:
    """Name limits that no plan meets together; as few as ten seconds allow.

    Limits are left out one by one: those whose absence does not help are dropped for good, so that what remains is
    irreducible, as long as time allows.
    """
    made = limited_programme(graph)
    problem = graph.problem
    hard = np.flatnonzero(np.isinf(problem.rows.penalty))
    if _infeasible(_without(made, hard)):
        return "no plan exists even without the limits: forbidden pairs and capacities leave no way for all agents"
    suspects = _violated(made, hard)
    rest = np.setdiff1d(hard, suspects)
    if len(rest) and not _infeasible(_without(made, rest)):
        suspects = hard
    needed = suspects
    if len(suspects) <= _MOST:
        for row in suspects:
            fewer = needed[needed != row]
            if _infeasible(_without(made, np.setdiff1d(hard, fewer))):
                needed = fewer
    names = [_told(graph, int(row)) for row in needed]
    shown = "; ".join(names[:8]) + ("; ..." if len(names) > 8 else "")
    if len(names) == 1:
        return f"no plan keeps the limit {shown}"
    return f"no plan keeps these limits together: {shown}"


def _told(graph: PathGraph, row: int) -> str:
    rows = graph.problem.rows
    bounds = []
    if np.isfinite(rows.told_low[row]):
        bounds.append(f"at_least={rows.told_low[row]:g}")
    if np.isfinite(rows.told_high[row]):
        bounds.append(f"at_most={rows.told_high[row]:g}")
    return f"{rows.names[row]} ({', '.join(bounds)})"


def _first_row(made: LimitedProgramme) -> int:
    rows = made.graph.problem.rows
    return len(made.programme.low) - rows.count - len(rows.team_cell)


def _without(made: LimitedProgramme, rows: np.ndarray) -> Programme:
    """The programme with some limits left open and nothing to gain."""
    programme, first = made.programme, _first_row(made)
    low, high = programme.low.copy(), programme.high.copy()
    low[first + rows], high[first + rows] = -np.inf, np.inf
    return replace(programme, gain=np.zeros(len(programme.gain)), low=low, high=high)


def _infeasible(programme: Programme) -> bool:
    return maximise(programme, seconds=_SECONDS).ending is Ending.INFEASIBLE


def _violated(made: LimitedProgramme, hard: np.ndarray) -> np.ndarray:
    """The limits that are broken where all together are broken as little as can be, and those that bind there."""
    import scipy.sparse as sp

    programme, first = made.programme, _first_row(made)
    count = len(hard)
    place = first + hard
    shape = (len(programme.low), count)
    over = sp.csr_array((np.ones(count), (place, np.arange(count))), shape=shape)
    elastic = Programme(
        np.concatenate([np.zeros(len(programme.gain)), -np.ones(2 * count)]),
        sp.hstack([sp.csr_array(programme.rows), -over, over], format="csr"),
        programme.low, programme.high,
        np.concatenate([programme.upper, np.full(2 * count, np.inf)]),
        np.zeros(len(programme.gain) + 2 * count, dtype=bool),
    )  # fmt: skip
    answer = maximise(elastic, relaxed=True, seconds=_SECONDS)
    if answer.duals is None:
        return hard
    return np.asarray(hard[np.abs(answer.duals[place]) > 1e-9]) if answer.value < -1e-7 else hard
