"""Links between satellites, for the distributed solvers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.constellation.view import checked_positions

if TYPE_CHECKING:
    import networkx as nx


def linked_pairs(positions_km: FloatArray, range_km: float = 2500.0) -> IntArray:
    """Pairs of satellites closer than `range_km` at one step, found with a k-d tree.

    Parameters
    ----------
    positions_km : ndarray, shape (n, 3)

    Returns
    -------
    ndarray of int, shape (pairs, 2)
        Each pair once, the lower index first, in lexicographic order.
    """
    if not (np.isfinite(range_km) and range_km > 0):
        raise ValueError(f"range_km must be a positive number of kilometres, got {range_km}")
    pairs = cKDTree(positions_km).query_pairs(range_km, output_type="ndarray").astype(np.int64)
    # The tree counts satellites at exactly the range; the rule is "closer than".
    apart = np.linalg.norm(positions_km[pairs[:, 0]] - positions_km[pairs[:, 1]], axis=1)
    pairs = np.sort(pairs[apart < range_km], axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def links(positions_km: FloatArray, range_km: float = 2500.0) -> list[nx.Graph]:
    """Communication graphs of a constellation, one per step: an edge between satellites closer than `range_km`.

    A graph of some thousand satellites has hundreds of thousands of edges and takes some 100 MB: pass only the steps
    that are needed.

    Parameters
    ----------
    positions_km : ndarray, shape (T, n, 3)
    range_km : float
        2500 in the thesis. The Earth does not block such links above an altitude of 125 km.

    Returns
    -------
    list of networkx.Graph
        T graphs with the nodes 0 .. n-1.

    Raises
    ------
    ValueError
        If the positions have the wrong shape or the range is not positive.
    """
    import networkx as nx

    positions = checked_positions(positions_km)
    graphs = []
    for now in positions:
        graph: nx.Graph[int] = nx.Graph()
        graph.add_nodes_from(range(len(now)))
        graph.add_edges_from(linked_pairs(now, range_km).tolist())
        graphs.append(graph)
    return graphs
