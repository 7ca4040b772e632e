"""From a rule to its arcs: which states the agents can reach over a window, and what every move brings."""

from __future__ import annotations

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.arcs import ArcGraph
from sapopt.dynamics.paths.oracles import LocalModel
from sapopt.dynamics.rules.agent_local import IDLE, AgentLocal, LocalStates


def arc_graph(dynamics: AgentLocal, benefits: Benefits, state: LocalStates) -> ArcGraph:
    """The states that can be reached over a window, and the moves between them; one call of the rule per step."""
    T, n, m = benefits.shape
    flat = benefits.flat()
    ptr, listed, worth = flat.indptr, flat.indices.astype(np.int64), flat.data
    rows = n
    if dynamics.agents_alike and n > 1:
        first = _common_rows(ptr, listed, worth, T, n)
        if first is not None:
            rows, (ptr, listed, worth) = 1, first
    if rows == 1:
        local, source = np.unique(state.local, return_inverse=True)
        row = np.zeros(len(local), dtype=np.int64)
    else:
        local, source, row = state.local, np.arange(n), np.arange(n)
    node_count = [np.bincount(row, minlength=rows)]
    arc_count, head, task, gain = [], [], [], []
    nodes = len(local)  # numbered so far
    for k in range(T):
        counts = np.diff(ptr[k * rows : (k + 1) * rows + 1])[row] + 1
        node = np.repeat(np.arange(len(row)), counts)
        place = np.arange(len(node)) - np.repeat(np.cumsum(counts) - counts, counts)
        entry = np.maximum(ptr[k * rows + row[node]] + place - 1, 0)
        idles = place == 0
        tasks, benefit = np.full(len(node), IDLE), np.zeros(len(node))
        tasks[~idles], benefit[~idles] = listed[entry[~idles]], worth[entry[~idles]]
        eta, after = dynamics.rule(state.step + k, row[node], local[node], tasks, benefit)
        total = benefit + eta
        keep = total > -np.inf
        node, tasks, total, after = node[keep], tasks[keep], total[keep], np.asarray(after)[keep]
        low = int(after.min(initial=0))
        span = int(after.max(initial=0)) - low + 1
        unique, place = np.unique(row[node] * span + (after - low), return_inverse=True)
        arc_count.append(np.bincount(node, minlength=len(row)))
        head.append(nodes + place)
        task.append(tasks)
        gain.append(total)
        row, local = unique // span, unique % span + low
        nodes += len(unique)
        node_count.append(np.bincount(row, minlength=rows))
    arc_count.append(np.zeros(len(row), dtype=np.int64))
    return ArcGraph(
        (T, n, m), rows, _offsets(node_count), _offsets(arc_count), np.concatenate(head).astype(np.int64),
        np.concatenate(task).astype(np.int64), np.concatenate(gain), source.astype(np.int64), ptr, listed,
    )  # fmt: skip


def _offsets(counts: list[IntArray]) -> IntArray:
    return np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.int64)


def _common_rows(
    ptr: IntArray, listed: IntArray, worth: FloatArray, T: int, n: int
) -> tuple[IntArray, IntArray, FloatArray] | None:
    """Benefits of the first agent alone, if all agents have the same ones."""
    lengths = np.diff(ptr).reshape(T, n)
    if (lengths != lengths[:, :1]).any():
        return None
    keep = np.zeros(len(listed), dtype=bool)
    for k in range(T):
        block = slice(ptr[k * n], ptr[(k + 1) * n])
        for part in (listed[block], worth[block]):
            table = part.reshape(n, -1) if len(part) else part
            if len(part) and (table != table[0]).any():
                return None
        keep[ptr[k * n] : ptr[k * n + 1]] = True
    return np.concatenate([[0], np.cumsum(lengths[:, 0])]).astype(np.int64), listed[keep], worth[keep]


MOST_ARCS = 30_000_000
"""Arcs of a graph beyond which the plain dynamic programme is the better way (about 1 GB)."""


def model_graph(model: LocalModel, benefits: Benefits, most: int = MOST_ARCS) -> ArcGraph | None:
    """The moves of any `LocalModel`: `step` is asked once for every step and agent, and never again.

    Tasks that do the same to an agent, whatever its state, become one idle arc; they are the largest set of tasks with
    equal gains and successors in all states that it can be in. A model in which every task leads to a state of its own
    has no such set, and its graph is no smaller than its tables.

    Returns
    -------
    ArcGraph
        None if it would have more than `most` arcs.
    """
    T, n, m = benefits.shape
    layers = [np.array([model.start(i)]) for i in range(n)]
    node_count, arc_count = [np.ones(n, dtype=np.int64)], []
    head, task, gain, listed, listed_count = [], [], [], [], []
    nodes, arcs = n, 0
    weights = np.random.default_rng(0).random(
        model.state_count()
    )  # tell columns apart; verified where they agree
    for k in range(T):
        step = benefits.step(k)
        after_layers = []
        for i in range(n):
            benefit = step[i] if isinstance(step, np.ndarray) else step[[i]].toarray()[0]
            successor, handover = model.step(k, i, benefit)
            successor = np.broadcast_to(successor, handover.shape)[layers[i]]
            total = benefit[None, :] + np.asarray(handover)[layers[i]]
            others = _unlike(successor, total, weights[layers[i]])
            common = np.flatnonzero(~others)[0]
            tasks = np.append(np.flatnonzero(others), IDLE)
            columns = np.append(tasks[:-1], common)
            open_arcs = total[:, columns] > -np.inf
            origin, column = np.nonzero(open_arcs)
            target = successor[origin, columns[column]]
            layer, place = np.unique(target, return_inverse=True)
            arc_count.append(open_arcs.sum(axis=1))
            head.append(nodes + place)
            task.append(tasks[column])
            gain.append(total[origin, columns[column]])
            listed.append(tasks[:-1])
            listed_count.append(len(tasks) - 1)
            nodes += len(layer)
            arcs += len(target)
            after_layers.append(layer)
        if arcs > most:
            return None
        layers = after_layers
        node_count.append(np.array([len(layer) for layer in layers]))
    arc_count.append(np.zeros(int(node_count[-1].sum()), dtype=np.int64))
    return ArcGraph(
        (T, n, m), n, _offsets(node_count), _offsets(arc_count), np.concatenate(head).astype(np.int64),
        np.concatenate(task).astype(np.int64), np.concatenate(gain), np.arange(n),
        _offsets([np.array(listed_count)]), np.concatenate(listed).astype(np.int64),
    )  # fmt: skip


def _unlike(successor: IntArray, total: FloatArray, weights: FloatArray) -> np.ndarray:
    """Which tasks (m,) are not of the largest set with equal columns in both tables (states, m)."""
    finite = np.where(np.isfinite(total), total, -1e9)
    print_of = weights @ (finite + 0.618 * successor)
    _, first, counts = np.unique(print_of, return_index=True, return_counts=True)
    j = first[np.argmax(counts)]
    return np.asarray(((successor != successor[:, [j]]) | (total != total[:, [j]])).any(axis=0))
