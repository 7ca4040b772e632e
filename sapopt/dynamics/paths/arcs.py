"""Longest priced paths through the arcs between agent-local states, compiled and sparse.

An agent's states over a window form a layered graph: a node for every state it can be in before a step, an arc for
every task it may take there. Tasks that are worth nothing to an agent at a step are all the same to it, so one idle
arc stands for all of them; its price is that of the cheapest. The work is one visit to every arc, whatever m is.
Agents that are alike (same benefits, same rule) share one graph and differ only in where they start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sapopt.data.types import FloatArray, IntArray, root_mean_square
from sapopt.dynamics.paths import arcs_kernels as kernels
from sapopt.dynamics.paths.window import checked_prices


@dataclass(frozen=True, eq=False)
class ArcGraph:
    """States and moves of the agents over a window of T steps.

    Attributes
    ----------
    shape : (T, n, m)
    rows : int
        n, or 1 if the agents share a graph.
    node_ptr : ndarray of int64, shape ((T + 1) * rows + 1,)
        Nodes ``node_ptr[k * rows + r] ..`` are the states of row r before step k (k = T: after the last one).
    first : ndarray of int64, shape (nodes + 1,)
        Arcs ``first[v] .. first[v + 1] - 1`` leave node v.
    head : ndarray of int64, shape (arcs,)
        Node that an arc leads to.
    task : ndarray of int64, shape (arcs,)
        Task that is taken, -1 for idling.
    gain : ndarray, shape (arcs,)
        Benefit plus handover.
    source : ndarray of int64, shape (n,)
        Node of every agent before the first step.
    listed_ptr, listed : ndarray of int64
        Tasks ``listed[listed_ptr[k * rows + r] ..]`` are those with a benefit at step k; on all others a row idles.
    """

    shape: tuple[int, int, int]
    rows: int
    node_ptr: IntArray
    first: IntArray
    head: IntArray
    task: IntArray
    gain: FloatArray
    source: IntArray
    listed_ptr: IntArray
    listed: IntArray

    @property
    def arcs(self) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
        """Arrays in the order of the kernels."""
        return self.first, self.head, self.task, self.gain

    @property
    def listed_cells(self) -> tuple[IntArray, IntArray]:
        """Steps and tasks of `listed`, for agents that share a graph."""
        own = self.listed[self.listed_ptr[0] : self.listed_ptr[-1]]
        return np.repeat(np.arange(self.shape[0]), np.diff(self.listed_ptr)), own

    def after(self, assignment: IntArray) -> ArcGraph:
        """The graph of the later steps, once the agents held `assignment` (n,) at the first; it shares all arrays."""
        T, n, m = self.shape
        tasks = np.ascontiguousarray(assignment, dtype=np.int64)
        source = kernels.moved(self.arcs, self.source, tasks, self.rows, self.listed_ptr, self.listed)
        lost = np.flatnonzero(source < 0)
        if len(lost):
            raise ValueError(f"assignment: agent {lost[0]} may not take task {tasks[lost[0]]}")
        return replace(
            self, shape=(T - 1, n, m), node_ptr=self.node_ptr[self.rows :], source=source,
            listed_ptr=self.listed_ptr[self.rows :],
        )  # fmt: skip


class ArcPaths:
    """Path oracle of an `ArcGraph`: hard, soft and first values (see `sapopt.dynamics.paths.oracles`).

    An idle agent i takes task ``m - n + i`` where that is among the cheapest of its idle tasks, so that problems with
    an idle task per agent at the end have no conflicts about idling.
    """

    def __init__(self, graph: ArcGraph) -> None:
        self.graph = graph
        _, n, m = graph.shape
        self._own = np.arange(m - n, m)
        self._row_own = self._own if graph.rows == n else np.full(graph.rows, -1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window."""
        return self.graph.shape

    @cached_property
    def scale(self) -> float:
        """Typical gain of a move: root mean square."""
        first_arc = self.graph.first[self.graph.node_ptr[0]]
        gains = self.graph.gain[first_arc:][self.graph.task[first_arc:] >= 0]
        return root_mean_square(gains)

    @property
    def coldest(self) -> float:
        """Any temperature will do."""
        return 0.0

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        p = self._prices(prices)
        return self._paths(p, np.arange(self.shape[1]), 0, self.graph.rows)

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        row = agent if self.graph.rows > 1 else 0
        values, plan = self._paths(self._prices(prices), np.array([agent]), row, row + 1)
        return float(values[0]), plan[:, 0]

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count.

        -inf where the first task is forbidden.
        """
        g = self.graph
        p = self._prices(prices)
        _, idle_price = self._idle(p, 0, g.rows)
        value, _ = kernels.longest(g.arcs, g.node_ptr, g.rows, 0, g.rows, p, idle_price)
        out: FloatArray = kernels.values_of_first(
            g.arcs, g.source, value, g.rows, g.listed_ptr, g.listed, g.shape[2]
        )
        return out

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        g = self.graph
        T, _, m = g.shape
        p = self._prices(prices)
        idle_task, idle_price = self._idle(p, 0, g.rows)
        values, usage, idling = kernels.soft(
            g.arcs, g.node_ptr, g.rows, g.source, p, idle_price, float(temperature)
        )
        if g.rows == g.shape[1]:
            np.add.at(usage, (np.arange(T)[:, None], idle_task), idling)
        else:
            # Which agent idles is not known here; all the cheapest tasks are as good, so all take their share.
            free = np.ones((T, m), dtype=bool)
            free[g.listed_cells] = False
            cheapest = free & (p == idle_price)
            usage += cheapest * (idling / np.maximum(cheapest.sum(axis=1, keepdims=True), 1))
        return values, usage

    def after(self, assignment: IntArray) -> ArcPaths:
        """Paths of the later steps, once the agents held `assignment` (n,) at the first; nothing is built anew."""
        return ArcPaths(self.graph.after(assignment))

    def place(self, order: IntArray, closed: FloatArray, prices: FloatArray, plan: IntArray) -> None:
        """Let the agents of `order` move one by one: each gives up its cells and takes its best open path.

        Parameters
        ----------
        order : ndarray of int64
        closed : ndarray of float64, shape (T, m)
            Prices, not negative, with +inf at the cells that `plan` holds; kept so, in place.
        prices : ndarray of float64, shape (T, m)
            Prices of open cells.
        plan : ndarray of int64, shape (T, n)
            A feasible plan; changed in place.
        """
        g = self.graph
        kernels.place(
            g.arcs,
            g.node_ptr,
            g.rows,
            g.source,
            self._own,
            g.listed_ptr,
            g.listed,
            order,
            closed,
            prices,
            plan,
        )

    def _paths(self, p: FloatArray, agents: IntArray, low: int, high: int) -> tuple[FloatArray, IntArray]:
        g = self.graph
        T = g.shape[0]
        idle_task, idle_price = self._idle(p, low, high)
        value, choice = kernels.longest(g.arcs, g.node_ptr, g.rows, low, high, p, idle_price)
        source = g.source[agents]
        plan = kernels.follow(g.arcs, source, choice, T)
        if g.rows == g.shape[1]:
            idle = idle_task[:, agents]
        else:
            own = self._own[agents]
            is_free = np.ones(p.shape, dtype=bool)
            is_free[g.listed_cells] = False
            idle = np.where((p[:, own] == idle_price) & is_free[:, own], own, idle_task)
        return value[source], np.where(plan == -1, idle, np.maximum(plan, 0))

    def _idle(self, p: FloatArray, low: int, high: int) -> tuple[IntArray, FloatArray]:
        """Task and price (T, rows) of idling, for the rows ``low .. high - 1``."""
        g = self.graph
        task, price = kernels.idle_tasks(p, g.rows, low, high, self._row_own, g.listed_ptr, g.listed)
        return task, price

    def _prices(self, prices: FloatArray) -> FloatArray:
        return checked_prices(prices, self.shape)
