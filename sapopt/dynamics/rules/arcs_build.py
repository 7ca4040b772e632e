"""From a rule to its arcs: which states the agents can reach over a window, and what every move brings."""

from __future__ import annotations

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.arcs import ArcGraph
from sapopt.dynamics.paths.arcs_build import offsets
from sapopt.dynamics.paths.oracles import IDLE
from sapopt.dynamics.rules.agent_local import AgentLocal, LocalStates


def arc_graph(dynamics: AgentLocal, benefits: Benefits, state: LocalStates, alike: bool) -> ArcGraph:
    """The states that can be reached over a window, and the moves between them; one call of the rule per step.

    Agents that are `alike` and have equal benefits share one graph.
    """
    T, n, m = benefits.shape
    flat = benefits.flat()
    ptr, listed, worth = flat.indptr, flat.indices.astype(np.int64), flat.data
    rows = n
    if alike and n > 1:
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
        (T, n, m), rows, offsets(node_count), offsets(arc_count), np.concatenate(head).astype(np.int64),
        np.concatenate(task).astype(np.int64), np.concatenate(gain), source.astype(np.int64), ptr, listed,
    )  # fmt: skip


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
