"""Every agent's paths as a graph whose arcs know what they add to each limit.

`sapopt.formulations.limited.building` makes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray, IntArray, root_mean_square
from sapopt.formulations.limited import kernels
from sapopt.kernels.blocks import in_blocks
from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class PathGraph:
    """Arcs of all agents, by agent and, for each, by the node they leave.

    Attributes
    ----------
    problem : SAP
        A core (`SAP.core`).
    node_ptr : ndarray of int64, shape (n + 1,)
        Nodes of every agent, the first one its source, in an order in which every arc leads onward.
    arc_ptr : ndarray of int64, shape (nodes + 1,)
    head : ndarray of int64, shape (arcs,)
    gain : ndarray, shape (arcs,)
    cell : ndarray of int64, shape (arcs,)
        ``k * m + j`` where the arc holds task j at step k, else -1 (on the way to a hub).
    taken : ndarray of bool, shape (arcs,)
        Whether the arc takes up a task that was not held before.
    ends : ndarray of bool, shape (nodes,)
        Whether a path may end there.
    """

    problem: SAP
    node_ptr: IntArray
    arc_ptr: IntArray
    head: IntArray
    gain: FloatArray
    cell: IntArray
    taken: np.ndarray
    ends: np.ndarray

    @property
    def arcs(self) -> int:
        """Number of arcs."""
        return len(self.head)

    @cached_property
    def scale(self) -> float:
        """The typical size of what there is to gain; 1 where there is nothing."""
        sizes = np.concatenate([self.gain, self.problem.rows.team_reward])
        sizes = sizes[(sizes != 0) & np.isfinite(sizes)]
        return root_mean_square(sizes) if len(sizes) else 1.0

    def restricted(self, keep: np.ndarray) -> PathGraph:
        """The graph of the arcs of a mask (arcs,) alone; its nodes stay, some of them dead ends now."""
        if keep.all():
            return self
        kept = np.concatenate([[0], np.cumsum(keep)])
        return PathGraph(
            self.problem, self.node_ptr, kept[self.arc_ptr], self.head[keep], self.gain[keep], self.cell[keep],
            self.taken[keep], self.ends,
        )  # fmt: skip

    @cached_property
    def agent(self) -> IntArray:
        """Whose arc, shape (arcs,)."""
        counts = self.arc_ptr[self.node_ptr[1:]] - self.arc_ptr[self.node_ptr[:-1]]
        return np.repeat(np.arange(self.problem.n), counts)

    @cached_property
    def tail(self) -> IntArray:
        """Node an arc leaves, shape (arcs,)."""
        return np.repeat(np.arange(len(self.ends)), np.diff(self.arc_ptr))

    @cached_property
    def holds(self) -> np.ndarray:
        """Mask (arcs,) of the arcs that hold a task."""
        return self.cell >= 0

    @cached_property
    def comers(self) -> IntArray:
        """Agents (T, m) that could hold every task."""
        T, n, m = self.problem.T, self.problem.n, self.problem.m
        comes = np.zeros((n, T * m + 1), dtype=bool)
        comes[self.agent, self._count_at] = True
        return np.asarray(comes[:, : T * m].sum(axis=0)).reshape(T, m)

    @cached_property
    def _count_at(self) -> IntArray:
        """The cell of every arc, and one beyond the last for those that hold nothing."""
        return np.where(self.holds, self.cell, self.problem.T * self.problem.m)

    @cached_property
    def weights(self) -> sp.csr_array:
        """What every arc adds to every row, shape (rows, arcs)."""
        rows, n, m = self.problem.rows, self.problem.n, self.problem.m
        step, task = np.divmod(self.cell, m)
        own = np.where(self.holds, (step * n + self.agent) * m + task, -1)
        total = sp.csr_array((rows.count, self.arcs))
        everyone = np.ones(self.arcs, dtype=bool)
        for weights, mask in ((rows.pair, everyone), (rows.taken, self.taken), (rows.stayed, ~self.taken)):
            if not len(weights.cell):
                continue
            cells, place = np.unique(weights.cell, return_inverse=True)
            table = sp.csr_array((weights.weight, (weights.row, place)), shape=(rows.count, len(cells)))
            at = np.minimum(np.searchsorted(cells, own), len(cells) - 1)
            hit = np.flatnonzero((cells[at] == own) & mask)
            total = total + table @ sp.csr_array(
                (np.ones(len(hit)), (at[hit], hit)), shape=(len(cells), self.arcs)
            )
        by = rows.taken_by
        if len(by.row):
            table = sp.csr_array((by.weight, (by.row, by.agent)), shape=(rows.count, n))
            counts = self.taken & self.holds & (task != rows.idle)
            if not rows.first_counts:
                counts &= step > 0
            hit = np.flatnonzero(counts)
            total = total + table @ sp.csr_array(
                (np.ones(len(hit)), (self.agent[hit], hit)), shape=(n, self.arcs)
            )
        return sp.csr_array(total)

    @cached_property
    def _weights_by_arc(self) -> sp.csr_array:
        return sp.csr_array(self.weights.T)

    @property
    def most_limits(self) -> int:
        """Most rows that one arc adds to."""
        return int(np.diff(self._weights_by_arc.indptr).max(initial=0))

    def sizes(self, multipliers: FloatArray) -> FloatArray:
        """The sizes (arcs,) of gains and of all that multipliers take from them, added up."""
        size = np.abs(np.where(np.isfinite(self.gain), self.gain, 0.0))
        return size + abs(self._weights_by_arc) @ np.abs(multipliers) if len(multipliers) else size

    def priced(self, prices: FloatArray, multipliers: FloatArray) -> FloatArray:
        """Gains (arcs,) less the prices (T, m) of the cells and the multipliers (rows,) of the limits."""
        out = self.gain - np.append(prices.ravel(), 0.0)[self.cell]  # cell -1 is the last
        if len(multipliers):
            out -= self._weights_by_arc @ multipliers
        return out

    def onward(self, weight: FloatArray) -> tuple[FloatArray, IntArray]:
        """Value (nodes,) of the longest way on from every node, and its first arc (-1: none)."""
        value, best = np.zeros(len(self.ends)), np.zeros(len(self.ends), dtype=np.int64)
        arrays = (self.node_ptr, self.arc_ptr, self.head, weight, self.ends, value, best)
        in_blocks(kernels.longest, self.problem.n, *arrays, turns=self.arcs)
        return value, best

    def longest(self, weight: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) of the agents' longest paths, and the arcs on them."""
        value, best = self.onward(weight)
        node = self.node_ptr[:-1]
        values = value[node]
        node = node[np.isfinite(values)]
        found = []
        while len(node):
            arc = best[node]
            arc = arc[arc >= 0]
            found.append(arc)
            node = self.head[arc]
        return values, np.sort(np.concatenate(found)) if found else np.zeros(0, dtype=np.int64)

    def smoothed(self, weight: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,), and the probability of every arc (arcs,) under the Gibbs distribution of the paths."""
        value, mass, share = np.zeros(len(self.ends)), np.zeros(len(self.ends)), np.zeros(self.arcs)
        arrays = (self.node_ptr, self.arc_ptr, self.head, weight, self.ends, temperature, value, mass, share)
        in_blocks(kernels.smoothed, self.problem.n, *arrays, turns=5 * self.arcs)
        return value[self.node_ptr[:-1]], share

    def through(self, weight: FloatArray) -> FloatArray:
        """How much less than the agent's longest path the best path through every arc (arcs,) is worth."""
        onward, _ = self.onward(weight)
        before = np.zeros(len(self.ends))
        graph = (self.node_ptr, self.arc_ptr, self.head, weight)
        in_blocks(kernels.arrived, self.problem.n, *graph, before, turns=self.arcs)
        with np.errstate(invalid="ignore"):
            loss = onward[self.node_ptr[:-1]][self.agent] - (before[self.tail] + weight + onward[self.head])
        return np.where(np.isfinite(loss), np.maximum(loss, 0.0), np.inf)

    def usage(self, share: FloatArray) -> FloatArray:
        """Agents (T, m) on every task, for shares of the arcs."""
        T, m = self.problem.T, self.problem.m
        out: FloatArray = np.bincount(self._count_at, weights=share, minlength=T * m + 1).astype(np.float64)
        return out[: T * m].reshape(T, m)

    def plan_of(self, arcs: IntArray) -> IntArray:
        """Plan (T, n) of the arcs of one path for each agent."""
        T, n, m = self.problem.T, self.problem.n, self.problem.m
        plan = np.full((T, n), -1, dtype=np.int64)
        arcs = arcs[self.cell[arcs] >= 0]
        step, task = np.divmod(self.cell[arcs], m)
        plan[step, self.agent[arcs]] = task
        return plan

    def follow(self, plan: IntArray) -> IntArray | None:
        """The arcs of a plan (T, n), None if an agent may not follow it."""
        T, m = self.problem.T, self.problem.m
        held = np.arange(T)[:, None] * m + plan
        step = np.maximum(self.cell, 0) // m
        fits = ~self.holds | (self.cell == held[step, self.agent])
        values, arcs = self.longest(np.where(fits, self.gain, -np.inf))
        return arcs if np.isfinite(values).all() else None
