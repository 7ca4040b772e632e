"""From a `LocalModel` to its arcs: which states the agents can reach over a window, and what every move brings."""

from __future__ import annotations

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.arcs import ArcGraph
from sapopt.dynamics.paths.oracles import IDLE, LocalModel


def offsets(counts: list[IntArray]) -> IntArray:
    """Where each group begins, and where the last one ends."""
    return np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.int64)


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
        (T, n, m), n, offsets(node_count), offsets(arc_count), np.concatenate(head).astype(np.int64),
        np.concatenate(task).astype(np.int64), np.concatenate(gain), np.arange(n),
        offsets([np.array(listed_count)]), np.concatenate(listed).astype(np.int64),
    )  # fmt: skip


def _unlike(successor: IntArray, total: FloatArray, weights: FloatArray) -> np.ndarray:
    """Which tasks (m,) are not of the largest set with equal columns in both tables (states, m)."""
    finite = np.where(np.isfinite(total), total, -1e9)
    print_of = weights @ (finite + 0.618 * successor)
    _, first, counts = np.unique(print_of, return_index=True, return_counts=True)
    j = first[np.argmax(counts)]
    return np.asarray(((successor != successor[:, [j]]) | (total != total[:, [j]])).any(axis=0))
