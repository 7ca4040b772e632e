"""Communication graphs in array form: links, components, distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from sapopt.data.types import IntArray

_KEPT = 4
"""Networks whose distances a `Networks` keeps; those of some thousand agents take tens of megabytes a step."""


@dataclass(frozen=True, eq=False)
class Network:
    """An undirected communication graph of n agents as adjacency lists.

    Attributes
    ----------
    link_start : ndarray of int64, shape (n + 1,)
    links : ndarray of int32
        Neighbours of agent i are ``links[link_start[i]:link_start[i + 1]]``, ascending.
    """

    link_start: IntArray
    links: np.ndarray

    @classmethod
    def from_graph(cls, graph: Any, n: int) -> Network:
        """Read a networkx graph with the nodes ``0 .. n - 1``; directions and self-loops are ignored.

        Raises
        ------
        ValueError
            If the graph has other nodes, or not n of them.
        """
        if isinstance(graph, Network):
            if graph.n != n:
                raise ValueError(f"graph has {graph.n} nodes, but the problem has {n} agents")
            return cls(graph.link_start, graph.links)
        if not _is_graph(graph):
            raise ValueError(
                f"graph must be a networkx graph or a list of one per step, got {type(graph).__name__}"
            )
        if graph.number_of_nodes() != n:
            raise ValueError(f"graph has {graph.number_of_nodes()} nodes, but the problem has {n} agents")
        if any(node not in graph for node in range(n)):
            raise ValueError(
                f"graph must have the nodes 0..{n - 1}; use networkx.convert_node_labels_to_integers"
            )
        # A graph a step, all read before the first one: no Python per edge here.
        rows = dict(graph.adjacency())
        counts = np.fromiter(map(len, rows.values()), np.int64, len(rows))
        heard = np.fromiter(chain.from_iterable(rows.values()), np.int64, int(counts.sum()))
        agents = np.repeat(np.fromiter(rows, np.int64, len(rows)), counts)
        return cls.from_pairs(np.stack([agents, heard], axis=1), n)

    @classmethod
    def from_pairs(cls, pairs: IntArray, n: int) -> Network:
        """Build from undirected edges, shape ``(edges, 2)``."""
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        codes = np.sort(np.concatenate([pairs[:, 0] * n + pairs[:, 1], pairs[:, 1] * n + pairs[:, 0]]))
        codes = codes[np.diff(codes, prepend=-1) > 0]
        start = np.concatenate([[0], np.cumsum(np.bincount(codes // n, minlength=n))])
        return cls(start.astype(np.int64), (codes % n).astype(np.int32))

    @classmethod
    def complete(cls, n: int) -> Network:
        """Every agent hears every other."""
        links = np.tile(np.arange(n, dtype=np.int32), (n, 1))[~np.eye(n, dtype=bool)]
        return cls(np.arange(n + 1, dtype=np.int64) * (n - 1), links)

    @property
    def n(self) -> int:
        """Number of agents."""
        return len(self.link_start) - 1

    @cached_property
    def degrees(self) -> IntArray:
        """Number of neighbours, shape ``(n,)``."""
        return np.diff(self.link_start)

    @cached_property
    def sources(self) -> IntArray:
        """Sending agent of every directed link, shape ``(links,)``; the receiver is ``links``."""
        return np.repeat(np.arange(self.n), self.degrees)

    @cached_property
    def reverse(self) -> IntArray:
        """For every directed link the position of its opposite, shape ``(links,)``."""
        # The links are sorted by (source, receiver); the opposite one is sorted by (receiver, source).
        return np.argsort(np.lexsort((self.sources, self.links)), kind="stable")

    @cached_property
    def distances(self) -> np.ndarray:
        """Hops between all pairs of agents, int16 of shape ``(n, n)``; -1 where there is no path."""
        from sapopt.solvers.distributed.network_kernels import hop_distances

        return hop_distances(self.link_start, self.links)

    @cached_property
    def rings(self) -> tuple[IntArray, np.ndarray]:
        """Agents by distance: those d hops from agent i are ``agents[i, start[i, d]:start[i, d + 1]]``.

        ``start`` has shape ``(n, most distant + 2)``, ``agents`` ``(n, n)``; agents out of reach come last in no ring.
        """
        n, distances = self.n, self.distances
        widths = int(distances.max()) + 1
        far = np.where(distances < 0, np.int16(widths), distances)
        small = np.int16 if n < 2**15 else np.int32
        agents = np.argsort(far, axis=1, kind="stable").astype(small)
        counts = np.bincount(
            (np.arange(n)[:, None] * (widths + 1) + far).ravel(), minlength=n * (widths + 1)
        ).reshape(n, widths + 1)
        start = np.zeros((n, widths + 1), dtype=np.int64)
        start[:, 1:] = np.cumsum(counts[:, :widths], axis=1)
        return start, agents

    @cached_property
    def components(self) -> IntArray:
        """Number of the connected component of every agent, shape ``(n,)``."""
        import scipy.sparse as sp
        from scipy.sparse.csgraph import connected_components

        graph = sp.csr_array(
            (np.ones(len(self.links), np.int8), self.links, self.link_start), shape=(self.n,) * 2
        )
        labels: IntArray = connected_components(graph, directed=False)[1].astype(np.int64)
        return labels

    @cached_property
    def diameters(self) -> IntArray:
        """Diameter of every component in hops, shape ``(components,)``."""
        out = np.zeros(int(self.components.max()) + 1, dtype=np.int64)
        np.maximum.at(out, self.components, self.distances.max(axis=1).astype(np.int64))
        return out

    def without(self, dead: np.ndarray, groups: Sequence[np.ndarray] = ()) -> Network:
        """The network without the links of dead agents and without the links that leave a group.

        Parameters
        ----------
        dead : ndarray of bool, shape (n,)
        groups : sequence of ndarray of bool, shape (n,)
            Members of every group that is cut off.
        """
        keep = ~(dead[self.sources] | dead[self.links])
        for group in groups:
            keep &= group[self.sources] == group[self.links]
        if keep.all():
            return self
        counts = np.bincount(self.sources[keep], minlength=self.n)
        return Network(np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), self.links[keep])


class Networks:
    """The networks of all steps, converted when they are needed.

    Parameters
    ----------
    graph : networkx graph, Network, sequence of T of them, or None
        None: every agent hears every other.
    n, T : int
        Agents and steps of the problem.

    Raises
    ------
    ValueError
        If the number of graphs or of their nodes does not fit.
    """

    def __init__(self, graph: Any, n: int, T: int) -> None:
        self.n = n
        self._kept: dict[int, Network] = {}
        self._graphs: list[Any]
        if graph is None:
            self._graphs = [Network.complete(n)]
        elif isinstance(graph, (list, tuple)):
            if len(graph) != T:
                raise ValueError(f"graph: {len(graph)} graphs for {T} steps; pass one graph, or one per step")
            self._graphs = list(graph)
        else:
            self._graphs = [Network.from_graph(graph, n)]
        for step, one in enumerate(self._graphs):
            nodes = one.number_of_nodes() if _is_graph(one) else one.n if isinstance(one, Network) else None
            if nodes != n:
                where = f" at step {step}" if len(self._graphs) > 1 else ""
                raise ValueError(f"graph{where} has {nodes} nodes, but the problem has {n} agents")

    @property
    def steps(self) -> range:
        """First step of every different graph."""
        return range(len(self._graphs))

    def at(self, step: int) -> Network:
        """Network of a step."""
        index = step if len(self._graphs) > 1 else 0
        if index not in self._kept:
            try:
                network = Network.from_graph(self._graphs[index], self.n)
            except ValueError as error:
                raise ValueError(f"step {step}: {error}") from None
            # The links stay converted; the distances found with them do not.
            self._graphs[index] = Network(network.link_start, network.links)
            if len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[index] = network
        return self._kept[index]


def _is_graph(graph: Any) -> bool:
    from networkx import Graph  # takes a while, and whoever has a graph has it already

    return isinstance(graph, Graph)
