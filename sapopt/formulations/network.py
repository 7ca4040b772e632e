"""The time-expanded network: one path per agent over (step, local state) nodes, coupled by the task capacities.

Every arc on which an agent takes a task carries the slot (step, task) it fills; a slot holds one agent. For a
uniform switching cost the nodes are the places (step, task) and one hub per step and agent, through which every
move passes: 3 m arcs a step instead of m^2. An idle agent is a path like any other, so parking occupies tasks and
pays as the strict rule wants. Any other agent-local dynamics is expanded over its reachable local states.

A `sapopt.formulations.reduction.Formulation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import LocalModel
from sapopt.formulations.highs import Programme
from sapopt.formulations.local import local_model, not_local
from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class Network:
    """Arcs of all agents, sorted by rank (all arcs into a node have a lower rank than those out of it).

    Attributes
    ----------
    shape : (T, n, m)
    tail, head : ndarray of int64, shape (arcs,)
        Nodes; the agents share none.
    gain : ndarray, shape (arcs,)
    slot : ndarray of int64, shape (arcs,)
        ``k * m + j`` where the arc takes task j at step k, else -1.
    agent, step : ndarray of int64, shape (arcs,)
        Whose arc, and the step it leads into.
    ranks : ndarray of int64
        Arcs ``ranks[r] .. ranks[r + 1] - 1`` have rank r.
    source : ndarray of int64, shape (n,)
        First node of every agent.
    last : ndarray of bool, shape (nodes,)
        Whether a path may end in the node.
    """

    shape: tuple[int, int, int]
    tail: IntArray
    head: IntArray
    gain: FloatArray
    slot: IntArray
    agent: IntArray
    step: IntArray
    ranks: IntArray
    source: IntArray
    last: np.ndarray

    @property
    def arcs(self) -> int:
        """Number of arcs."""
        return len(self.tail)

    @cached_property
    def _takes(self) -> np.ndarray:
        return self.slot >= 0

    def priced(self, prices: FloatArray) -> FloatArray:
        """Gains less the prices (T, m) of the slots."""
        out = self.gain.copy()
        out[self._takes] -= prices.ravel()[self.slot[self._takes]]
        return out

    def forward(self, weight: FloatArray) -> FloatArray:
        """Longest way from the source to every node, -inf where there is none."""
        value = np.full(len(self.last), -np.inf)
        value[self.source] = 0.0
        for a, b in zip(self.ranks[:-1], self.ranks[1:], strict=True):
            np.maximum.at(value, self.head[a:b], value[self.tail[a:b]] + weight[a:b])
        return value

    def backward(self, weight: FloatArray) -> FloatArray:
        """Longest way from every node to an end."""
        value = np.where(self.last, 0.0, -np.inf)
        for a, b in zip(self.ranks[-2::-1], self.ranks[:0:-1], strict=True):
            np.maximum.at(value, self.tail[a:b], value[self.head[a:b]] + weight[a:b])
        return value

    def through(self, prices: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values of the agents' best paths (n,) and of the best path through every arc (arcs,) under prices."""
        weight = self.priced(prices)
        backward = self.backward(weight)
        return backward[self.source], self.forward(weight)[self.tail] + weight + backward[self.head]

    def best_paths(self, weight: FloatArray) -> tuple[FloatArray, np.ndarray]:
        """Value of every agent's longest path (n,) and the mask of the arcs on them; weights of -inf close arcs."""
        value = self.forward(weight)
        entered = np.full(len(self.last), -1)
        tight = np.flatnonzero(value[self.tail] + weight == value[self.head])
        entered[self.head[tight]] = tight
        n = self.shape[1]
        ends = np.flatnonzero(self.last)
        owner = np.full(len(self.last), -1)
        owner[self.head] = self.agent
        order = ends[np.lexsort((-value[ends], owner[ends]))]
        first = np.unique(owner[order], return_index=True)
        node = np.full(n, -1)
        node[first[0][first[0] >= 0]] = order[first[1][first[0] >= 0]]
        values = np.where(node >= 0, value[node], -np.inf)
        used = np.zeros(self.arcs, dtype=bool)
        node = node[np.isfinite(values)]
        while True:
            arc = entered[node]
            arc = arc[arc >= 0]
            if not len(arc):
                return values, used
            used[arc] = True
            node = self.tail[arc]

    def follow(self, plan: IntArray) -> FloatArray:
        """The point of the programme that stands for a plan (T, n): 1.0 on the arcs the agents use."""
        T, n, m = self.shape
        held = np.arange(T)[:, None] * m + plan
        fits = ~self._takes | (self.slot == held[self.step, self.agent])
        values, used = self.best_paths(np.where(fits, self.gain, -np.inf))
        if not np.isfinite(values).all():
            raise ValueError(f"plan: agent {int(np.argmin(values))} may not follow it")
        return used.astype(np.float64)

    def programme(self, keep: np.ndarray | None = None) -> Programme:
        """Flow conservation per agent and capacity per slot, over the arcs of the mask `keep`."""
        kept = np.arange(self.arcs) if keep is None else np.flatnonzero(keep)
        count = len(kept)
        column = np.arange(count)
        tail, head, slot = self.tail[kept], self.head[kept], self.slot[kept]
        takes = slot >= 0
        inner = ~self.last[head]
        nodes, node_row = np.unique(np.concatenate([tail, head[inner], self.source]), return_inverse=True)
        slots, slot_row = np.unique(slot[takes], return_inverse=True)
        out_row, in_row = node_row[:count], node_row[count : count + int(inner.sum())]
        rows = sp.csr_array(
            (
                np.concatenate([np.ones(count), -np.ones(len(in_row)), np.ones(len(slot_row))]),
                (
                    np.concatenate([out_row, in_row, len(nodes) + slot_row]),
                    np.concatenate([column, column[inner], column[takes]]),
                ),
            ),
            shape=(len(nodes) + len(slots), count),
        )
        supply = np.isin(nodes, self.source).astype(np.float64)
        low = np.concatenate([supply, np.full(len(slots), -np.inf)])
        high = np.concatenate([supply, np.ones(len(slots))])
        return Programme(self.gain[kept], rows, low, high, np.ones(count), takes)

    def slots_of(self, used: np.ndarray) -> IntArray:
        """Plan (T, n) read off a mask of arcs, one path per agent."""
        T, n, m = self.shape
        plan = np.full((T, n), -1)
        arcs = np.flatnonzero(used & self._takes)
        plan[self.step[arcs], self.agent[arcs]] = self.slot[arcs] % m
        return plan


_MOST_ARCS = 20_000_000
"""Arcs of a network of states beyond which memory runs out before any solver could use them (3 GB)."""


class NetworkOracle:
    """Longest priced paths of the agents through a network (a `sapopt.dynamics.paths.oracles.PathOracle`)."""

    def __init__(self, network: Network) -> None:
        self.network = network

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m)."""
        return self.network.shape

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) under `prices` (T, m)."""
        values, used = self.network.best_paths(self.network.priced(prices))
        return values, np.maximum(self.network.slots_of(used), 0)

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent."""
        values, plan = self.best_paths(prices)
        return float(values[agent]), plan[:, agent]


def refusal(problem: SAP) -> str | None:
    """None, or the reason why the problem has no time-expanded network."""
    return not_local(problem)


def formulate(problem: SAP) -> Network:
    """The time-expanded network of a problem.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local.
    """
    reason = refusal(problem)
    if reason:
        raise ValueError(f"dynamics: {reason}")
    rule = problem.model.switching()
    if rule is not None and rule.uniform_cost is not None:
        return _hub_network(problem, rule.uniform_cost, rule.idle_is_free)
    states = local_model(problem)
    assert states is not None
    return _state_network(problem, states)


def recover(network: Network, x: FloatArray, keep: np.ndarray | None = None) -> IntArray:
    """Plan (T, n) of an integral point of ``network.programme(keep)``."""
    whole = np.zeros(network.arcs, dtype=bool)
    whole[slice(None) if keep is None else np.flatnonzero(keep)] = x > 0.5
    return network.slots_of(whole)


def _hub_network(problem: SAP, cost: float, idle_is_free: bool) -> Network:
    T, n, m = problem.benefits.shape
    layer = n + n * m
    agent = np.repeat(np.arange(n), m)
    task = np.tile(np.arange(m), n)
    place = 2 * n + np.arange(n * m)  # of step 0
    parts = []
    for k in range(T):
        benefit = dense_step(problem.benefits.step(k)).ravel()
        here = place + k * layer
        slot = k * m + task
        if k == 0:
            gain = benefit + problem.handover(0, problem.initial_state()).ravel()
            parts.append((agent, here, gain, slot, agent, k, 0))
            continue
        hub = n + k * layer + agent
        charged = (benefit > 0) * cost if idle_is_free else 0.0
        leaving = np.full(n * m, 0.0 if idle_is_free else -cost)
        parts.append((here - layer, hub, leaving, np.full(n * m, -1), agent, k, 2 * k - 1))
        parts.append((hub, here, benefit - charged, slot, agent, k, 2 * k))
        parts.append((here - layer, here, benefit, slot, agent, k, 2 * k))
    return _sorted(problem.benefits.shape, parts, np.arange(n), n + T * layer)


def _state_network(problem: SAP, states: LocalModel) -> Network:
    T, n, m = problem.benefits.shape
    S = states.state_count()
    parts = []
    arcs = 0
    for i in range(n):
        reached = np.zeros(S, dtype=bool)
        reached[states.start(i)] = True
        for k in range(T):
            benefit = dense_step(problem.benefits.step(k))[i]
            successor, handover = states.step(k, i, benefit)
            gain = benefit + np.asarray(handover)
            state, task = np.nonzero(reached[:, None] & (gain > -np.inf))
            target = np.asarray(successor)[state, task]
            tail = (k * n + i) * S + state
            head = ((k + 1) * n + i) * S + target
            full = np.full(len(state), i)
            parts.append((tail, head, gain[state, task], k * m + task, full, k, k))
            reached = np.zeros(S, dtype=bool)
            reached[target] = True
            arcs += len(state)
            if arcs > _MOST_ARCS:
                raise ValueError(
                    f"the network of all states has more than {_MOST_ARCS:,} arcs, too many for an exact method; "
                    "DualDecomposition gives a plan and a bound at this size"
                )
    source = np.arange(n) * S + np.array([states.start(i) for i in range(n)])
    return _sorted(problem.benefits.shape, parts, source, (T + 1) * n * S)


def _sorted(shape: tuple[int, int, int], parts: list, source: IntArray, nodes: int) -> Network:
    """Join the arcs (tail, head, gain, slot, agent, step, rank), without those that are forbidden."""
    tail, head, gain, slot, agent = (np.concatenate([part[c] for part in parts]) for c in range(5))
    counts = [len(part[0]) for part in parts]
    step = np.repeat([part[5] for part in parts], counts)
    rank = np.repeat([part[6] for part in parts], counts)
    open_arcs = np.flatnonzero(gain > -np.inf)
    order = open_arcs[np.argsort(rank[open_arcs], kind="stable")]
    rank = rank[order]
    ranks = np.searchsorted(rank, np.arange(int(rank[-1]) + 2 if len(rank) else 1))
    last = np.zeros(nodes, dtype=bool)
    final = order[(step[order] == shape[0] - 1) & (slot[order] >= 0)]
    last[head[final]] = True
    return Network(
        shape,
        tail[order],
        head[order],
        gain[order],
        slot[order],
        agent[order],
        step[order],
        ranks,
        source,
        last,
    )
