"""Every agent's paths as a graph whose arcs know what they add to each limit.

The nodes are an agent's local states before a step, and, where a limit looks at take-ups, the task held before beside
them. For one switching cost the state is that task anyhow, and all moves of a step pass through one hub: 3 m arcs
instead of m^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Switching
from sapopt.dynamics.idle import IdlePlace
from sapopt.formulations.limited import kernels
from sapopt.kernels.blocks import in_blocks
from sapopt.problem.sap import SAP

_MOST_ARCS = 20_000_000
"""Arcs beyond which memory runs out before anything could use them (3 GB)."""


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
        out = self.gain.copy()
        out[self.holds] -= prices.ravel()[self.cell[self.holds]]
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
        held = self.cell[self.holds]
        out: FloatArray = np.bincount(held, weights=share[self.holds], minlength=T * m).astype(np.float64)
        return out.reshape(T, m)

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


def path_graph(problem: SAP, state: Any = None, also: tuple[int, int] | None = None) -> PathGraph:
    """The graph of a core problem (`SAP.core`).

    Parameters
    ----------
    problem : SAP
        Or the window of one (`sapopt.formulations.limited.window`).
    state : object, optional
        State before its first step, by default that of the problem.
    also : (agent, task), optional
        To be in the graph though the agent may gain nothing by it.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local, or the graph would be too large.
    """
    rule = switching_rule(problem)
    if rule is not None and rule.uniform_cost is not None:
        return _hub_graph(problem, rule.uniform_cost, rule.idle_is_free, also)
    return _state_graph(problem, problem.initial_state() if state is None else state)


def switching_rule(problem: SAP) -> Switching | None:
    """The plain switching rule of a core, also where idleness is a place beside it."""
    model = problem.model
    return model.inner.switching() if isinstance(model, IdlePlace) else model.switching()


def _hub_graph(problem: SAP, cost: float, idle_is_free: bool, also: tuple[int, int] | None) -> PathGraph:
    """Nodes of an agent: the source, then for every step the hub that leads in, and the tasks held at it."""
    T, m = problem.T, problem.m
    idle, initial = problem.rows.idle, problem.initial_assignment
    # A copy of the benefits for each agent: (T, m), read in its loop below.
    benefits = np.stack([dense_step(problem.benefits.step(k)) for k in range(T)], axis=1)
    places = _places(problem, benefits)
    if also is not None:
        places[also[0]] = np.union1d(places[also[0]], also[1])
    _check_size(3 * T * sum(len(own) for own in places))
    heads, gains, cells, takes, counts, ends, sizes = [], [], [], [], [], [], []
    first = 0  # node of the agent's source
    for i, own in enumerate(places):
        size = len(own)
        benefit = benefits[i][:, own]
        charge = np.where(benefit > 0, cost, 0.0) if idle_is_free else np.full(benefit.shape, cost)
        if idle >= 0:
            charge[:, own == idle] = 0.0
        move = np.ones(size, dtype=bool) if initial is None else own != initial[i]
        place, step = np.arange(size), np.arange(1, T)[:, None]
        heads.append(first + 1 + place)
        gains.append(benefit[0] - (0.0 if initial is None else np.where(move, charge[0], 0.0)))
        cells.append(own)
        takes.append(move)
        counts.append(np.array([size]))
        # Out of every task held at step k - 1: to the hub of step k, or to stay; and out of the hub to every task.
        hub = first + 1 + step * (size + 1) - 1
        stay = np.stack([np.broadcast_to(hub, (T - 1, size)), hub + 1 + place], axis=2).reshape(
            T - 1, 2 * size
        )
        heads.append(np.concatenate([stay, hub + 1 + place], axis=1).ravel())
        stay = np.stack([np.zeros((T - 1, size)), benefit[1:]], axis=2).reshape(T - 1, 2 * size)
        gains.append(np.concatenate([stay, benefit[1:] - charge[1:]], axis=1).ravel())
        held = step * m + own
        stay = np.stack([np.full((T - 1, size), -1), held], axis=2).reshape(T - 1, 2 * size)
        cells.append(np.concatenate([stay, held], axis=1).ravel())
        takes.append(np.tile(np.repeat([False, True], [2 * size, size]), T - 1))
        counts.append(np.tile(np.append(np.full(size, 2), size), T - 1))
        counts.append(np.zeros(size, dtype=np.int64))
        nodes = 1 + size + (T - 1) * (size + 1)
        ends.append(np.arange(nodes) >= nodes - size)
        sizes.append(nodes)
        first += nodes
    graph = PathGraph(
        problem, _starts([np.array(sizes)]), _starts(counts), np.concatenate(heads).astype(np.int64),
        np.concatenate(gains), np.concatenate(cells).astype(np.int64), np.concatenate(takes), np.concatenate(ends),
    )  # fmt: skip
    return graph.restricted(graph.gain > -np.inf)


def _places(problem: SAP, benefits: FloatArray) -> list[IntArray]:
    """The tasks that each agent may ever gain by holding; all of them where nobody may idle.

    An agent that may idle has no use for a task that never earns it anything, alone, in a limit or in a team: idling
    earns as much, costs nothing, and is free to begin.
    """
    n, m, rows = problem.n, problem.m, problem.rows
    by = rows.taken_by
    # A row that wants take-ups, or pays for them, may be served by taking up anything.
    wants = bool(np.isfinite(rows.low[by.row]).any() or (by.weight < 0).any())
    if rows.idle < 0 or wants:
        return [np.arange(m)] * n
    useful: np.ndarray = np.any(benefits > 0.0, axis=1)
    for weights in (rows.pair, rows.taken, rows.stayed):
        agent, task = np.divmod(weights.cell % (n * m), m)
        useful[agent, task] = True
    useful[:, rows.team_cell % m] = True
    useful[:, rows.idle] = True
    if problem.initial_assignment is not None:
        useful[np.arange(n), problem.initial_assignment] = True
    return [np.flatnonzero(row) for row in useful]


def _state_graph(problem: SAP, state: Any) -> PathGraph:
    model = problem.model
    states = model.local_model(problem.benefits, state) if model.is_agent_local else None
    if states is None:
        raise ValueError(
            f"dynamics: {problem.model.called} does not say that its state splits into one finite state per agent "
            "(method local_model), so limits and capacities have no prices"
        )
    T, n, m = problem.T, problem.n, problem.m
    remembers, initial = problem.rows.remembers, problem.initial_assignment
    heads, gains, cells, takes, counts, ends, sizes = [], [], [], [], [], [], []
    node, size = 0, 0
    for i in range(n):
        begin = node
        # a node is a local state and, where limits look back, the task held before (m: none)
        before = m if initial is None else int(initial[i])
        layer = np.array([states.start(i) * (m + 1) + (before if remembers else m)])
        for k in range(T):
            benefit = dense_step(problem.benefits.step(k))[i]
            successor, handover = states.step(k, i, benefit)
            local, held = np.divmod(layer, m + 1)
            total = benefit[None, :] + np.broadcast_to(handover, (states.state_count(), m))[local]
            onward = np.broadcast_to(successor, (states.state_count(), m))[local]
            where, task = np.nonzero(total > -np.inf)
            after = onward[where, task] * (m + 1) + (task if remembers else m)
            following, place = np.unique(after, return_inverse=True)
            heads.append(node + len(layer) + place)
            gains.append(total[where, task])
            cells.append(k * m + task)
            takes.append(held[where] != task)
            counts.append(np.bincount(where, minlength=len(layer)))
            ends.append(np.zeros(len(layer), dtype=bool))
            node += len(layer)
            size += len(where)
            _check_size(size)
            layer = following
        counts.append(np.zeros(len(layer), dtype=np.int64))
        ends.append(np.ones(len(layer), dtype=bool))
        node += len(layer)
        sizes.append(node - begin)
    return PathGraph(
        problem, _starts([np.array(sizes)]), _starts(counts), np.concatenate(heads).astype(np.int64),
        np.concatenate(gains), np.concatenate(cells).astype(np.int64), np.concatenate(takes), np.concatenate(ends),
    )  # fmt: skip


def _starts(counts: list[IntArray]) -> IntArray:
    return np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.int64)


def _check_size(arcs: int) -> None:
    if arcs > _MOST_ARCS:
        raise ValueError(
            f"the agents' paths have more than {_MOST_ARCS:,} arcs, too many for a problem with capacities, idleness "
            "or limits; policies such as HAAL plan it step by step"
        )
