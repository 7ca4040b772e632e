"""The network of a window as an integer programme, and its best flow.

The relaxation of such a programme is nearly whole, and takes a fraction of the time that a search for whole numbers
takes: it is solved first, and what is torn in it planned beside the rest. Moves that earn the same whatever task they
come from go through hubs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array, vstack

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import Programme, SolverError, maximise
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import RestrictedFlow
from sapopt.solvers.dual_decomposition.network_plans.waiting_places import Places

_OPTIONS: dict[str, Any] = {"threads": 1, "mip_abs_gap": 1e-6}
"""Several networks are solved at the same time, and none has to be proven to the last digit."""

_INTERIOR, _INTERIOR_WAITING = 40_000, 100_000
"""Columns from which on the interior point method, with a crossover, is faster than the simplex method: without and
with places to wait."""

_NOTHING = 1e-9
"""Share of the relaxation's value below which nothing is to be gained."""

_WHOLE = 1e-6
"""How far from a whole number a column of the relaxation may be."""

_NOBODY = -1
"""Agent of the columns that are nobody's."""

_LOST, _LOST_VALUE = 0.1, 1e-3
"""Shares of what could be gained, and of all the value, that may be lost by keeping what is whole in the relaxation."""


def solve_flow(
    flow: RestrictedFlow,
    plan: IntArray,
    tasks: int,
    *,
    gap: float = 1e-6,
    seconds: float = np.inf,
    stop: Callable[[], object] = lambda: False,
    limits: tuple[Any, FloatArray] | None = None,
    places: Places | None = None,
) -> IntArray | None:
    """Return ``plan`` (T, n) with the network's best integral flow in it, or None when HiGHS found none.

    Parameters
    ----------
    tasks : int
        Number m of tasks.
    gap : float
        Relative gap at which the flow counts as the best.
    seconds : float
        Time limit.
    stop : callable
        Asked now and then; a true answer ends the search with the best flow so far.
    limits : (sparse array of shape (rows, arcs), ndarray of shape (rows,)), optional
        Further rows that the plan keeps: sums of arcs, and how great they may be.
    places : Places, optional
        Where agents wait, if ``flow`` has tasks that stand for waiting (`waiting_places.waiting_flow`).
    """
    columns = _columns(flow)
    programme, agents = _paths(flow, columns)
    if limits is not None:
        rows, most = limits
        programme = _limited(programme, columns.limited(rows), most)
    if places is None:
        programme = _limited(programme, *_capacities(flow, columns, tasks))
    else:
        programme = places.added(programme, flow, columns.tail, columns.head)
    held = plan[flow.step, flow.agent] == flow.task
    chosen = columns.chosen(flow, held[flow.head] & ((flow.tail < 0) | held[np.maximum(flow.tail, 0)]))
    count, width = len(chosen), len(programme.gain)
    chosen = np.append(chosen, np.zeros(width - count))
    owners = np.append(columns.agents(flow), np.full(width - count, _NOBODY))
    end = time.monotonic() + seconds

    def solved(programme: Programme, **options: Any) -> FloatArray | None:
        answer = maximise(
            programme, seconds=end - time.monotonic(), tolerance=gap, watch=lambda value, bound: bool(stop()), **options
        )  # fmt: skip
        return answer.x

    try:
        # Windows with places to wait are many, and each round goes over them anew: nothing is lost for good.
        x = _integral(programme, owners, chosen, solved, thorough=places is None)
    except SolverError:
        return None
    if x is None:
        return None
    on = columns.head[x[:count] > 0.5]
    on = on[on < len(flow.agent)]
    if len(on) != len(np.unique(flow.step)) * agents:
        return None
    better = plan.copy()
    better[flow.step[on], flow.agent[on]] = flow.task[on]
    if places is not None:
        better[places.first : places.last] = places.placed(better[places.first : places.last], x[count:])
    return better


def _integral(
    programme: Programme,
    agents: IntArray,
    start: FloatArray,
    solved: Callable[..., FloatArray | None],
    *,
    thorough: bool,
) -> FloatArray | None:
    """Whole columns: those of the relaxation, where most agents' paths are whole, and the others planned beside them.

    The programme is solved as it stands only where that gives none or, if the search is `thorough`, loses much of what
    could be gained over ``start``; ``agents`` are those of the columns, `_NOBODY` where they belong to none.
    """
    method = "ipm" if len(programme.gain) >= (_INTERIOR if thorough else _INTERIOR_WAITING) else "simplex"
    relaxed = solved(programme, relaxed=True, options=_OPTIONS | {"solver": method})
    if relaxed is None:
        return None
    possible, size = programme.value(relaxed) - programme.value(start), abs(programme.value(relaxed))
    if possible <= _NOTHING * size:
        return start
    torn = np.unique(agents[np.abs(relaxed - np.round(relaxed)) > _WHOLE])
    if len(torn) == 0:
        return np.round(relaxed)
    is_open = np.isin(agents, torn) | (agents == _NOBODY) | (relaxed > 0.5)
    x = solved(replace(programme, upper=np.where(is_open, programme.upper, 0.0)), options=_OPTIONS)
    lost = np.inf if x is None else programme.value(relaxed) - programme.value(x)
    if lost <= min(_LOST * possible, _LOST_VALUE * size) or (not thorough and lost < possible):
        return x
    better = start if x is None or programme.value(x) < programme.value(start) else x
    x = solved(programme, start=better, options=_OPTIONS)
    return better if x is None else x


@dataclass(frozen=True)
class _Columns:
    """The columns of a programme: arcs, and the ways into and out of hubs.

    Where every move into a cell earns the same, whatever cell it comes from, the moves of an agent at a step need not
    be listed pair by pair: they meet in a hub, which takes as many columns as there are tails and heads.

    Attributes
    ----------
    tail, head : ndarray of int
        Cells of the flow, and from their number on the hubs; a tail of -1 is the start of an agent's path.
    arc : ndarray of int
        An arc of the flow that a column stands for: itself, or any move into the cell that a hub leads to. -1: a way
        into a hub.
    hubs : int
        How many there are.
    """

    tail: IntArray
    head: IntArray
    arc: IntArray
    hubs: int

    def values(self, flow: RestrictedFlow) -> FloatArray:
        """What every column earns; ways into hubs earn nothing."""
        return np.where(self.arc >= 0, flow.value[self.arc], 0.0)

    def agents(self, flow: RestrictedFlow) -> IntArray:
        """Whose columns they are."""
        cell = np.where(self.head < len(flow.agent), self.head, self.tail)
        found: IntArray = flow.agent[cell]
        return found

    def limited(self, rows: Any) -> Any:
        """Sums of arcs as sums of columns."""
        return csc_array(rows)[:, self.arc].multiply(self.arc >= 0)

    def chosen(self, flow: RestrictedFlow, arcs: npt.NDArray[np.bool_]) -> FloatArray:
        """The columns of the chosen arcs, 1, and 0 for the others."""
        cells = len(flow.agent)
        move = arcs & _moves(flow)
        left, entered = np.zeros(cells, dtype=bool), np.zeros(cells, dtype=bool)
        left[flow.tail[move]], entered[flow.head[move]] = True, True
        into, out = self.head >= cells, self.tail >= cells
        on = arcs[self.arc]
        on[into], on[out] = left[self.tail[into]], entered[self.head[out]]
        return on.astype(float)


def _moves(flow: RestrictedFlow) -> npt.NDArray[np.bool_]:
    """Which arcs lead from one task to another."""
    moves: npt.NDArray[np.bool_] = (flow.tail >= 0) & (flow.task[flow.tail] != flow.task[flow.head])
    return moves


def _columns(flow: RestrictedFlow) -> _Columns:
    """Hubs wherever they save columns and all moves into a cell earn the same; else the arcs as they are."""
    cells, arc = len(flow.agent), np.arange(len(flow.tail))
    move = np.flatnonzero(_moves(flow))
    highest = np.full(cells, -np.inf)
    np.maximum.at(highest, flow.head[move], flow.value[move])
    hub = flow.agent[flow.head[move]] * (flow.step.max(initial=0) + 1) + flow.step[flow.head[move]]
    _, hub, count = np.unique(hub, return_inverse=True, return_counts=True)
    tails, tail_hub = _firsts(flow.tail[move], hub)
    heads, head_hub = _firsts(flow.head[move], hub)
    even = np.ones(len(count), dtype=bool)
    even[hub[flow.value[move] != highest[flow.head[move]]]] = False
    saved = count - np.bincount(tail_hub, minlength=len(count)) - np.bincount(head_hub, minlength=len(count))
    used = even & (saved > 0)
    number = cells + np.cumsum(used) - 1
    direct = np.setdiff1d(arc, move[used[hub]])
    tails, tail_hub = tails[used[tail_hub]], tail_hub[used[tail_hub]]
    heads, head_hub = heads[used[head_hub]], head_hub[used[head_hub]]
    return _Columns(
        np.concatenate([flow.tail[direct], flow.tail[move[tails]], number[head_hub]]),
        np.concatenate([flow.head[direct], number[tail_hub], flow.head[move[heads]]]),
        np.concatenate([direct, np.full(len(tails), -1), move[heads]]),
        int(used.sum()),
    )


def _firsts(cell: IntArray, hub: IntArray) -> tuple[IntArray, IntArray]:
    """Where each cell comes first, and its hub."""
    _, first = np.unique(cell, return_index=True)
    return first, hub[first]


def _paths(flow: RestrictedFlow, columns: _Columns) -> tuple[Programme, int]:
    """One path for every agent, whatever the others do; and how many agents there are.

    Rows: a start per agent, conservation (out = in) per hub and per cell that is not in the last step.
    """
    count = len(columns.tail)
    starts = columns.tail < 0
    order, agent_row = np.unique(flow.agent, return_inverse=True)
    inner = np.append(flow.step < flow.step.max(), np.ones(columns.hubs, dtype=bool))
    inner_row = np.cumsum(inner) - 1 + len(order)
    into = inner[columns.head]
    row = np.concatenate(
        [agent_row[columns.head[starts]], inner_row[columns.head[into]], inner_row[columns.tail[~starts]]]
    )
    all_columns = np.arange(count)
    column = np.concatenate([all_columns[starts], all_columns[into], all_columns[~starts]])
    sign = np.concatenate([np.ones(starts.sum()), np.ones(into.sum()), -np.ones((~starts).sum())])
    supply = np.append(np.ones(len(order)), np.zeros(int(inner.sum())))
    rows = csc_array((sign, (row, column)), shape=(len(supply), count))
    programme = Programme(
        columns.values(flow), rows, supply, supply, np.ones(count), np.ones(count, dtype=bool)
    )
    return programme, len(order)


def _capacities(flow: RestrictedFlow, columns: _Columns, tasks: int) -> tuple[Any, FloatArray]:
    """One agent for every contested cell: the columns that lead there, and 1."""
    capacity, contested = _capacity_rows(flow, tasks)
    to_cell = np.flatnonzero(columns.head < len(flow.agent))
    used = to_cell[capacity[columns.head[to_cell]] >= 0]
    at = capacity[columns.head[used]], used
    return csc_array((np.ones(len(used)), at), shape=(contested, len(columns.tail))), np.ones(contested)


def _limited(programme: Programme, rows: Any, most: FloatArray) -> Programme:
    """The programme with further rows, sums of columns that are at most so great."""
    return replace(
        programme, rows=vstack([programme.rows, rows], format="csc"),
        high=np.append(programme.high, most), low=np.append(programme.low, np.full(len(most), -np.inf)),
    )  # fmt: skip


def _capacity_rows(flow: RestrictedFlow, tasks: int) -> tuple[IntArray, int]:
    """Number the cells (step, task) that more than one agent may use; -1 for the others."""
    _, place, count = np.unique(flow.step * tasks + flow.task, return_inverse=True, return_counts=True)
    number = np.where(count > 1, np.cumsum(count > 1) - 1, -1)
    return number[place], int((count > 1).sum())
