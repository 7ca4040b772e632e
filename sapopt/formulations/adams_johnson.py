"""Adams and Johnson's linearisation of a quadratic assignment problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import Programme


@dataclass
class _Rows:
    """Rows of a programme as they come: entries, and the interval of each row."""

    row: list[IntArray]
    column: list[IntArray]
    entry: list[FloatArray]
    low: list[FloatArray]
    high: list[FloatArray]
    count: int = 0

    def add(self, row: IntArray, column: IntArray, entry: float) -> None:
        """Entries of rows that are numbered from the first row of the present group."""
        self.row.append(self.count + row)
        self.column.append(column)
        self.entry.append(np.full(len(row), entry))

    def close(self, low: FloatArray, high: FloatArray) -> None:
        """End a group of rows."""
        self.low.append(low)
        self.high.append(high)
        self.count += len(low)


def adams_johnson(a: FloatArray, b: FloatArray, c: FloatArray) -> Programme:
    """The mixed-integer programme of ``maximise sum a[p, r] b[q, s] x[p, q] x[r, s] + sum c[p, q] x[p, q]``.

    A variable ``y[p, q, r, s]`` stands for each product ``x[p, q] x[r, s]`` with p != r and q != s; the two orders of a
    product share it. Given that r is at s, every other facility has its place and every other place at most one
    facility:

        sum_q y[p, q, r, s] = x[r, s]   for all p != r,      sum_p y[p, q, r, s] <= x[r, s]   for all q != s,

    with = in the second row too where there are as many facilities as places.

    Parameters
    ----------
    a : ndarray, shape (facilities, facilities)
    b : ndarray, shape (locations, locations)
    c : ndarray, shape (facilities, locations)
        -inf where a facility may not go.

    Notes
    -----
    Facilities and places fall into groups that have no allowed pair in common (the steps of a sequential problem).
    Products between groups whose `a` or `b` is zero throughout are left out, which changes nothing: every x in the hull
    of the matchings of its groups can be completed to such products.

    References
    ----------
    W. P. Adams and T. A. Johnson, Improved linear programming-based lower bounds for the quadratic assignment problem,
    DIMACS Series in Discrete Mathematics and Theoretical Computer Science 16, 1994, 43-75.
    """
    p, q = np.nonzero(np.isfinite(c))
    facilities, locations = c.shape
    rows = _Rows([], [], [], [], [])
    singles = np.arange(len(p))
    rows.add(p, singles, 1.0)
    rows.close(np.ones(facilities), np.ones(facilities))
    rows.add(q, singles, 1.0)
    rows.close(np.full(locations, -np.inf), np.ones(locations))
    gain = [c[p, q] + np.diagonal(a)[p] * np.diagonal(b)[q]]
    columns = len(p)
    group = _groups(np.isfinite(c))
    members = [np.flatnonzero(group[p] == g) for g in range(int(group.max(initial=-1)) + 1)]
    for first, mine in enumerate(members):
        for second in range(first, len(members)):
            other = members[second]
            if not _interact(a, b, p, q, mine, other):
                continue
            u, v = (grid.ravel() for grid in np.meshgrid(mine, other, indexing="ij"))
            apart = (p[u] != p[v]) & (q[u] != q[v]) & ((first != second) | (p[u] < p[v]))
            u, v = u[apart], v[apart]
            gain.append(a[p[u], p[v]] * b[q[u], q[v]] + a[p[v], p[u]] * b[q[v], q[u]])
            product = columns + np.arange(len(u))
            columns += len(u)
            if first == second:
                _consistent(
                    rows, p, q, mine, mine, np.append(u, v), np.append(v, u), np.append(product, product)
                )
            else:
                _consistent(rows, p, q, mine, other, u, v, product)
                _consistent(rows, p, q, other, mine, v, u, product)
    matrix = sp.csr_array(
        (np.concatenate(rows.entry), (np.concatenate(rows.row), np.concatenate(rows.column))),
        shape=(rows.count, columns),
    )
    return Programme(
        np.concatenate(gain), matrix, np.concatenate(rows.low), np.concatenate(rows.high), np.ones(columns),
        np.arange(columns) < len(p),
    )  # fmt: skip


def _groups(allowed: np.ndarray) -> IntArray:
    """Group of each facility: those that are joined by allowed pairs."""
    facilities = len(allowed)
    here, there = np.nonzero(allowed)
    graph = sp.coo_array(
        (np.ones(len(here)), (here, facilities + there)), shape=(facilities + allowed.shape[1],) * 2
    )
    label = connected_components(graph, directed=False)[1][:facilities]
    return np.unique(label, return_inverse=True)[1].astype(np.int64)


def _interact(
    a: FloatArray, b: FloatArray, p: IntArray, q: IntArray, mine: IntArray, other: IntArray
) -> bool:
    """Whether any product between two groups can have a weight."""
    here, there = (np.unique(p[mine]), np.unique(q[mine])), (np.unique(p[other]), np.unique(q[other]))
    weighs = False
    for left, right in ((here, there), (there, here)):
        flow = a[np.ix_(left[0], right[0])]
        if mine is other:
            flow = flow * ~np.eye(len(flow), dtype=bool)
        weighs |= bool(flow.any() and b[np.ix_(left[1], right[1])].any())
    return weighs


def _consistent(
    rows: _Rows,
    p: IntArray,
    q: IntArray,
    mine: IntArray,
    given: IntArray,
    u: IntArray,
    v: IntArray,
    product: IntArray,
) -> None:
    """The two kinds of rows for the pairs `given`, over the facilities and the places of the pairs `mine`.

    Product i joins the pair ``u[i]`` of `mine` and the pair ``v[i]`` of `given`.
    """
    number = np.full(len(p), -1)
    number[given] = np.arange(len(given))
    for label, full in ((p, True), (q, len(np.unique(p[mine])) == len(np.unique(q[mine])))):
        kinds = np.unique(label[mine])
        # One row for each pair that is given and each facility (place) that it does not take itself.
        grid = label[given][:, None] != kinds[None, :]
        at = np.full(grid.shape, -1)
        at[grid] = np.arange(int(grid.sum()))
        rows.add(at[number[v], np.searchsorted(kinds, label[u])], product, 1.0)
        pair, _ = np.nonzero(grid)
        rows.add(np.arange(len(pair)), given[pair], -1.0)
        rows.close(np.zeros(len(pair)) if full else np.full(len(pair), -np.inf), np.zeros(len(pair)))
