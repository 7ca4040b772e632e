"""The mixed-integer programme of a graph of paths: flow, capacities, limits and teams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import Programme
from sapopt.formulations.limited.graph import PathGraph


@dataclass(frozen=True, eq=False)
class LimitedProgramme:
    """The programme over some arcs of a graph.

    Its columns are the arcs kept, then how far every soft limit is exceeded and undercut, then one for every team and
    step, whether the reward is earned.

    Attributes
    ----------
    graph : PathGraph
    kept : ndarray of int64
        Arcs, ascending.
    programme : Programme
    soft : ndarray of int64
        Rows of limits that may be broken at a price.
    nodes, cells : ndarray of int64
        What the first rows are about: the flow through a node of the graph, and the agents on a cell ``k * m + j``.
    """

    graph: PathGraph
    kept: IntArray
    programme: Programme
    soft: IntArray
    nodes: IntArray
    cells: IntArray

    def recover(self, x: FloatArray) -> IntArray:
        """Plan (T, n) of an integral point."""
        return self.graph.plan_of(self.kept[x[: len(self.kept)] > 0.5])

    def point(self, arcs: IntArray) -> FloatArray:
        """The point of a plan that uses these arcs, all of them kept."""
        rows, count = self.graph.problem.rows, len(self.kept)
        x = np.zeros(len(self.programme.gain))
        x[np.searchsorted(self.kept, arcs)] = 1.0
        share = np.zeros(self.graph.arcs)
        share[arcs] = 1.0
        use = self.graph.weights @ share if rows.count else np.zeros(0)
        s = len(self.soft)
        x[count : count + s] = np.where(np.isfinite(rows.high), np.maximum(use - rows.high, 0.0), 0.0)[
            self.soft
        ]
        x[count + s : count + 2 * s] = np.where(np.isfinite(rows.low), np.maximum(rows.low - use, 0.0), 0.0)[
            self.soft
        ]
        held = self.graph.usage(share).ravel()[rows.team_cell]
        x[count + 2 * s :] = held >= rows.team_needs
        return x


def limited_programme(
    graph: PathGraph, keep: np.ndarray | None = None, elastic: float = np.inf
) -> LimitedProgramme:
    """The programme over the arcs of a mask, by default all; hard limits may be broken at a finite price `elastic`.

    Every agent follows one path through them; a cell holds no more agents than its capacity; limits hold, or are paid
    for; a team earns where enough agents hold its task.
    """
    problem, rows = graph.problem, graph.problem.rows
    kept = np.arange(graph.arcs) if keep is None else np.flatnonzero(keep)
    count = len(kept)
    penalty = np.minimum(rows.penalty, elastic)
    soft = np.flatnonzero(np.isfinite(penalty))
    width = count + 2 * len(soft) + len(rows.team_cell)
    column = np.arange(count)
    tail, head, cell = graph.tail[kept], graph.head[kept], graph.cell[kept]
    inner = ~graph.ends[head]
    source = graph.node_ptr[:-1]
    nodes, place = np.unique(np.concatenate([tail, head[inner], source]), return_inverse=True)
    flow = _rows(
        np.concatenate([place[:count], place[count : count + int(inner.sum())]]),
        np.concatenate([column, column[inner]]),
        np.concatenate([np.ones(count), -np.ones(int(inner.sum()))]),
        (len(nodes), width),
    )
    supply = np.isin(nodes, source).astype(np.float64)
    # a cell that has room for every agent that could come needs no row
    holds = np.flatnonzero(cell >= 0)
    pairs = np.unique(cell[holds] * problem.n + graph.agent[kept[holds]])
    cells, comers = np.unique(pairs // problem.n, return_counts=True)
    room = np.ones(problem.T * problem.m, dtype=np.int64)
    if problem.capacity is not None:
        room = problem.capacity.ravel()
    tight = cells[comers > room[cells]]
    at = np.minimum(np.searchsorted(tight, cell[holds]), max(len(tight) - 1, 0))
    hit = holds[tight[at] == cell[holds]] if len(tight) else holds[:0]
    places = _rows(np.searchsorted(tight, cell[hit]), hit, np.ones(len(hit)), (len(tight), width))
    limits, low, high = _limits(graph, kept, soft, width)
    teams = _teams(graph, cell, count + 2 * len(soft), width)
    gain = np.concatenate([graph.gain[kept], np.tile(-penalty[soft], 2), rows.team_reward])
    upper = np.concatenate([np.ones(count), np.full(2 * len(soft), np.inf), np.ones(len(rows.team_cell))])
    integer = np.concatenate([cell >= 0, np.zeros(2 * len(soft), bool), np.ones(len(rows.team_cell), bool)])
    programme = Programme(
        gain,
        sp.vstack([flow, places, limits, teams], format="csr"),
        np.concatenate([supply, np.full(len(tight), -np.inf), low, np.full(len(rows.team_cell), -np.inf)]),
        np.concatenate([supply, room[tight].astype(np.float64), high, np.zeros(len(rows.team_cell))]),
        upper,
        integer,
    )
    return LimitedProgramme(graph, kept, programme, soft, nodes, tight)


def _rows(row: IntArray, column: IntArray, value: FloatArray, shape: tuple[int, int]) -> sp.csr_array:
    return sp.csr_array((value, (row, column)), shape=shape)


def _limits(
    graph: PathGraph, kept: IntArray, soft: IntArray, width: int
) -> tuple[sp.csr_array, FloatArray, FloatArray]:
    """Rows of the limits. One that may be exceeded and undercut has a column for each, at the price of its penalty."""
    rows, count = graph.problem.rows, len(kept)
    own = graph.weights[:, kept] if rows.count else sp.csr_array((0, count))
    s = len(soft)
    over = sp.csr_array((-np.ones(s), (soft, np.arange(s))), shape=(rows.count, s))
    rest = sp.csr_array((rows.count, width - count - 2 * s))
    return sp.hstack([own, over, -over, rest], format="csr"), rows.low, rows.high


def _teams(graph: PathGraph, cell: IntArray, first: int, width: int) -> sp.csr_array:
    """``needs * earned - agents on the task <= 0`` for every team and step."""
    rows = graph.problem.rows
    count = len(rows.team_cell)
    row, column, value = [np.arange(count)], [first + np.arange(count)], [rows.team_needs.astype(np.float64)]
    for team in range(count):  # two teams may want one cell
        hit = np.flatnonzero(cell == rows.team_cell[team])
        row.append(np.full(len(hit), team))
        column.append(hit)
        value.append(-np.ones(len(hit)))
    return _rows(np.concatenate(row), np.concatenate(column), np.concatenate(value), (count, width))
