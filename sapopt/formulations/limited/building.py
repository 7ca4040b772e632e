"""Makes the graph of the agents' paths (`sapopt.formulations.limited.graph.PathGraph`).

The nodes are an agent's local states before a step, and, where a limit looks at take-ups, the task held before beside
them. For one switching cost the state is that task anyhow, and all moves of a step pass through one hub: 3 m arcs
instead of m^2. Where agents may idle, what they cannot gain by is left out (`sapopt.formulations.limited.useful`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import IntArray
from sapopt.dynamics.base import LocalRule
from sapopt.dynamics.paths.oracles import IDLE
from sapopt.formulations.limited.graph import PathGraph
from sapopt.formulations.limited.useful import (
    agent_benefits,
    kept_pairs,
    switching_rule,
    useful_pairs,
)
from sapopt.problem.sap import SAP

_MOST_ARCS = 20_000_000
"""Arcs beyond which memory runs out before anything could use them (3 GB)."""
_MOST_LOOKS = 20_000_000
"""Rows times arcs up to which arcs are looked for that break a limit alone."""


def path_graph(
    problem: SAP, state: Any = None, also: Sequence[tuple[int, int]] = (), tight: bool = True
) -> PathGraph:
    """The graph of a core problem (`SAP.core`).

    Parameters
    ----------
    problem : SAP
        Or the window of one (`sapopt.formulations.limited.window`).
    state : object, optional
        State before its first step, by default that of the problem.
    also : sequence of (agent, task), optional
        To be in the graph though the agent may gain nothing by it.
    tight : bool
        Leave out arcs whose agent alone would break a limit by them (`tightened`).

    Raises
    ------
    ValueError
        If the dynamics is not agent-local, or the graph would be too large.
    """
    rule, local = switching_rule(problem), problem.model.by_rule()
    state = problem.initial_state() if state is None else state
    if rule is not None and rule.uniform_cost is not None:
        graph = _hub_graph(problem, rule.uniform_cost, rule.idle_is_free, also)
    elif local is not None:
        graph = _rule_graph(problem, local, state, also)
    else:
        graph = _state_graph(problem, state)
    return tightened(graph) if tight else graph


def tightened(graph: PathGraph) -> PathGraph:
    """The graph without the arcs that no path within the limits uses: its least sum is beyond a hard upper bound.

    An agent that looks at a target once may not stay on it for a second step. The relaxation would let half an agent
    stay for two, and turn there for half the price.
    """
    rows = graph.problem.rows
    hard = np.isfinite(rows.high) & np.isinf(rows.penalty)
    if not hard.any() or hard.sum() * graph.arcs > _MOST_LOOKS:
        return graph
    keep = np.ones(graph.arcs, dtype=bool)
    for r in np.flatnonzero(hard):
        row = graph.weights[[r]]
        if (row.data <= 0).any() or not len(row.data):
            continue
        weight = np.zeros(graph.arcs)
        weight[row.indices] = -row.data
        values, _ = graph.onward(weight)
        least = -values[graph.node_ptr[:-1]]
        if (least <= rows.high[r]).all():
            keep &= least[graph.agent] + graph.through(weight) <= rows.high[r]
    return graph.restricted(keep)


def _hub_graph(problem: SAP, cost: float, idle_is_free: bool, also: Sequence[tuple[int, int]]) -> PathGraph:
    """Nodes of an agent: the source, then for every step the hub that leads in, and the tasks held at it."""
    T, m = problem.T, problem.m
    idle, initial = problem.rows.idle, problem.initial_assignment
    if idle < 0:  # then every pair counts, and the size is known before gigabytes are filled
        _check_size(problem.n * (3 * T - 2) * m)
    parts = []
    first, size = 0, 0  # node of the agent's source, arcs so far
    benefits = agent_benefits(problem)
    for i, useful in enumerate(useful_pairs(problem, benefits, False, also)):
        whole = benefits[i]
        if idle_is_free:  # a task may be taken up for free just before it earns anything
            useful[:-1] |= useful[1:]
        own = np.flatnonzero(useful.any(axis=0))
        kept = kept_pairs(useful, None if initial is None else int(initial[i]))[:, own]
        useful, benefit = useful[:, own], whole[:, own]
        charge = np.where(benefit > 0, cost, 0.0) if idle_is_free else np.full(benefit.shape, cost)
        if idle >= 0:
            charge[:, own == idle] = 0.0
        move = np.ones(len(own), dtype=bool) if initial is None else own != initial[i]
        # nodes of the pairs kept, step by step; node h[k] is the hub of step k, before them
        counts = kept.sum(axis=1)
        h = first + np.cumsum(counts) - counts + np.arange(T)
        node = h[:, None] + np.cumsum(kept, axis=1)
        step, place = np.nonzero(kept[:1])
        initially = (
            np.full(len(place), first), node[0, place],
            benefit[0, place] - (0.0 if initial is None else np.where(move, charge[0], 0.0)[place]), own[place],
            move[place],
        )  # fmt: skip
        step, place = np.nonzero(useful[:-1])
        none = np.zeros(len(step))
        leave = node[step, place], h[step + 1], none, np.full(len(step), -1), none > 0
        step, place = np.nonzero(kept[1:] & kept[:-1])
        stay = (
            node[step, place], node[step + 1, place], benefit[step + 1, place], (step + 1) * m + own[place],
            np.zeros(len(step), dtype=bool),
        )  # fmt: skip
        step, place = np.nonzero(useful[1:])
        enter = (
            h[step + 1], node[step + 1, place], (benefit - charge)[step + 1, place], (step + 1) * m + own[place],
            np.ones(len(step), dtype=bool),
        )  # fmt: skip
        parts.append(
            tuple(np.concatenate(columns) for columns in zip(initially, leave, stay, enter, strict=True))
        )
        size += len(parts[-1][0])
        _check_size(size)
        first = int(h[-1] + counts[-1]) + 1
        parts[-1] += (np.array([first]), np.arange(h[-1] + 1, first))
    tail, head, gain, cell, taken, stop, last = (np.concatenate(c) for c in zip(*parts, strict=True))
    return _graph(problem, np.concatenate([[0], stop]), (tail, head, gain, cell, taken), last)


def _graph(problem: SAP, node_ptr: IntArray, arcs: tuple[Any, ...], last: IntArray) -> PathGraph:
    """The graph of arcs (tail, head, gain, cell, taken) in any order; paths end at the nodes `last`."""
    order = np.argsort(arcs[0], kind="stable")
    tail, head, gain, cell, taken = (np.asarray(column)[order] for column in arcs)
    nodes = int(node_ptr[-1])
    ends = np.zeros(nodes, dtype=bool)
    ends[last] = True
    counts = np.bincount(tail, minlength=nodes)
    graph = PathGraph(
        problem, node_ptr.astype(np.int64), np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        head.astype(np.int64), gain.astype(np.float64), cell.astype(np.int64), taken.astype(bool), ends,
    )  # fmt: skip
    return graph.restricted(graph.gain > -np.inf)


def _rule_graph(problem: SAP, rule: LocalRule, state: Any, also: Sequence[tuple[int, int]]) -> PathGraph:
    """States that the agents can reach by a rule, and the moves between them; one call of the rule for each step."""
    T, n, m = problem.T, problem.n, problem.m
    remembers, initial = problem.rows.remembers, problem.initial_assignment
    benefits = agent_benefits(problem)
    offered = np.empty((T, n, m), dtype=bool)
    for i, useful in enumerate(useful_pairs(problem, benefits, True, also)):
        # Idling is one state whatever task is held, so holding a task for nothing is of use for a later take-up alone.
        first = None if initial is None else int(initial[i])
        offered[:, i] = kept_pairs(useful, first) if remembers else useful
    # A node is an agent, its local state and, where limits look back, the task held before (m: none).
    agent, local = np.arange(n), np.asarray(state.local, dtype=np.int64)
    held = initial if remembers and initial is not None else np.full(n, m)
    owner, tails, heads, gains, cells, takes = [agent], [], [], [], [], []
    nodes, size = n, 0
    for k in range(T):
        node, task = np.nonzero(offered[k][agent])
        benefit = benefits[agent[node], k, task]
        idles = benefit == 0
        eta, after = rule.rule(
            state.step + k,
            agent[node],
            local[node],
            np.where(idles, IDLE, task),
            np.where(idles, 0.0, benefit),
        )
        total = benefit + np.asarray(eta)
        keep = total > -np.inf
        node, task, total, after = (
            node[keep],
            task[keep],
            total[keep],
            np.asarray(after, dtype=np.int64)[keep],
        )
        low = int(after.min(initial=0))
        span = int(after.max(initial=0)) - low + 1
        follows = (agent[node] * span + (after - low)) * (m + 1) + (task if remembers else m)
        unique, place = np.unique(follows, return_inverse=True)
        tails.append(nodes - len(agent) + node)
        heads.append(nodes + place)
        gains.append(total)
        cells.append(k * m + task)
        takes.append(held[node] != task if remembers else np.ones(len(node), dtype=bool))
        size += len(node)
        _check_size(size)
        rest, held = np.divmod(unique, m + 1)
        agent, local = np.divmod(rest, span)
        local = local + low
        owner.append(agent)
        nodes += len(unique)
    # numbered by step so far; from here on by agent, and for each of them by step
    own = np.concatenate(owner)
    order = np.argsort(own, kind="stable")
    number = np.empty(nodes, dtype=np.int64)
    number[order] = np.arange(nodes)
    node_ptr = np.concatenate([[0], np.cumsum(np.bincount(own, minlength=n))])
    arcs = (
        number[np.concatenate(tails)], number[np.concatenate(heads)], np.concatenate(gains), np.concatenate(cells),
        np.concatenate(takes),
    )  # fmt: skip
    return _graph(problem, node_ptr, arcs, number[nodes - len(agent) :])


def _state_graph(problem: SAP, state: Any) -> PathGraph:
    """The same of any finite states, asked agent by agent and step by step."""
    model = problem.model
    states = model.local_model(problem.benefits, state) if model.is_agent_local else None
    if states is None:
        raise ValueError(
            f"dynamics: {problem.model.called} does not say that its state splits into one finite state per agent "
            "(method local_model), so limits and capacities have no prices"
        )
    T, n, m = problem.T, problem.n, problem.m
    remembers, initial = problem.rows.remembers, problem.initial_assignment
    tails, heads, gains, cells, takes, stops, last = [], [], [], [], [], [0], []
    node, size = 0, 0
    for i in range(n):
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
            tails.append(node + where)
            heads.append(node + len(layer) + place)
            gains.append(total[where, task])
            cells.append(k * m + task)
            takes.append(held[where] != task)
            node += len(layer)
            size += len(where)
            _check_size(size)
            layer = following
        last.append(node + np.arange(len(layer)))
        node += len(layer)
        stops.append(node)
    arcs = tuple(np.concatenate(columns) for columns in (tails, heads, gains, cells, takes))
    return _graph(problem, np.array(stops), arcs, np.concatenate(last))


class TooLargeError(ValueError):
    """The agents' paths have too many arcs for a graph in memory."""


def _check_size(arcs: int) -> None:
    if arcs > _MOST_ARCS:
        raise TooLargeError(
            f"the agents' paths have more than {_MOST_ARCS:,} arcs, too many for a problem with capacities, idleness, "
            "limits or tasks that disturb each other; policies such as HAAL plan it step by step"
        )
