"""Odd-cycle cuts for the relaxation over stays.

Take an odd number of rows (steps of agents, steps of tasks), each filled at most once. Half their sum, rounded down,
says that the stays that fill two of h rows (three count as one, four as two) number at most (h - 1) / 2: a
Chvatal-Gomory cut with multipliers one half. It is violated where stays of about one half conflict in a ring. Such
rings are shortest odd closed walks in the graph of conflicts, whose edges weigh ``1 - x_u - x_v`` (Groetschel, Lovasz
and Schrijver, 1988).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.stays import Stays

_LEAST = 0.01
"""Violation from which a cut is worth having."""
_TINY = 1e-6
_LONGEST = 25
_TURNS = 6
_CHOICES = 4


def violated(
    stays: Stays,
    chosen: IntArray,
    x: FloatArray,
    most: int,
    rng: np.random.Generator,
    stop: Callable[[], bool] = lambda: False,
) -> list[IntArray]:
    """Row sets of the most violated cuts, each of odd size.

    Parameters
    ----------
    stays : Stays
    chosen : ndarray of int64
        Stays in the relaxation.
    x : ndarray
        Their shares.
    most : int
        Cuts wanted.
    rng : Generator
        Varies the walks and the rows that are taken for a conflict.
    stop : callable
        Asked before every turn; a true answer ends the search for further cuts.
    """
    part = np.flatnonzero((x > 1e-4) & (x < 1 - 1e-4))
    if len(part) < 3:
        return []
    rows = sp.csr_array(stays.rows(chosen[part]))
    columns = sp.csc_array(rows)
    share = x[part]
    members_of = [columns.indices[columns.indptr[c] : columns.indptr[c + 1]] for c in range(len(part))]
    first, second = _conflicts(rows)
    weight = np.maximum(1.0 - share[first] - share[second], 0.0)
    found: dict[bytes, tuple[float, IntArray]] = {}
    tried: set[tuple[int, ...]] = set()
    for turn in range(_TURNS):
        if stop():
            break
        noise = _TINY + (0.05 * rng.random(len(weight)) if turn else 0.0)
        for ring in _rings(first, second, weight + noise, len(part)):
            name = tuple(sorted(ring))
            if name in tried:
                continue
            tried.add(name)
            between = [
                np.intersect1d(members_of[a], members_of[b])
                for a, b in zip(ring, ring[1:] + ring[:1], strict=True)
            ]
            for _ in range(_CHOICES):
                members = np.unique([int(rng.choice(options)) for options in between])
                if len(members) != len(ring):
                    continue
                fill = np.asarray(rows[members].sum(axis=0)).ravel() // 2
                violation = float(fill @ share) - (len(members) - 1) / 2
                if violation > _LEAST:
                    found[members.tobytes()] = (violation, members)
    best = sorted(found.values(), key=lambda cut: -cut[0])
    return [members for _, members in best[:most]]


def _rings(first: IntArray, second: IntArray, weight: FloatArray, count: int) -> Iterator[list[int]]:
    """Shortest odd rings through every stay, where they weigh less than one."""
    # Walks alternate between two copies of the graph: one that comes back to the other copy is odd.
    tail = np.concatenate([first, second, first + count, second + count])
    head = np.concatenate([second + count, first + count, second, first])
    graph = sp.csr_array((np.tile(weight, 4), (tail, head)), shape=(2 * count, 2 * count))
    distance, before = dijkstra(graph, indices=np.arange(count), return_predecessors=True, limit=1.3)
    length = distance[np.arange(count), np.arange(count) + count]
    for start in np.flatnonzero(length < 1.3):
        ring = _ring(before[start], int(start), count)
        if ring is not None:
            yield ring


def coefficients(stays: Stays, cuts: list[IntArray]) -> tuple[sp.csr_array, FloatArray]:
    """Coefficients of all stays, shape (cuts, stays), and the right-hand sides."""
    T, n, _ = stays.shape
    parts = []
    for members in cuts:
        fill = np.zeros(len(stays), dtype=np.int64)
        for member in members:
            label, k = divmod(int(member), T)
            owner = stays.agent == label if label < n else stays.task == label - n
            fill += owner & (stays.first <= k) & (stays.stop > k)
        parts.append(sp.csr_array((fill // 2).astype(np.float64)[None]))
    right = np.array([(len(members) - 1) // 2 for members in cuts], dtype=np.float64)
    if not parts:
        return sp.csr_array((0, len(stays))), right
    return sp.csr_array(sp.vstack(parts)), right


def _conflicts(rows: sp.csr_array) -> tuple[IntArray, IntArray]:
    """Pairs of stays (the lower first) that fill a common row."""
    shared = sp.coo_array(sp.triu(rows.T @ rows, k=1))
    return shared.row.astype(np.int64), shared.col.astype(np.int64)


def _ring(before: IntArray, start: int, count: int) -> list[int] | None:
    """Stays along the shortest odd closed walk from `start`; None if it visits one twice."""
    node, ring = start + count, [start]
    while True:
        node = int(before[node])
        if node == start:
            break
        if node < 0 or len(ring) > _LONGEST:
            return None
        ring.append(node % count)
    return ring if len(set(ring)) == len(ring) and len(ring) % 2 else None
