"""Longest paths through a graph whose arcs carry weights, and their log-sum-exp smoothing.

The nodes of an agent are numbered in an order in which every arc leads onward; the arcs out of node v are
``arc_ptr[v] .. arc_ptr[v + 1] - 1``. A node without arcs is an end, or, where `ends` says no, a dead end.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from sapopt.kernels.jit import SMALL, njit


@njit(cache=True, nogil=True, small=SMALL)
def longest(begin, end, node_ptr, arc_ptr, head, weight, ends, value, best):
    """Fill `value` (nodes,) with the longest way on from every node of some agents, and `best` with its first arc."""
    for i in range(begin, end):
        for v in range(node_ptr[i + 1] - 1, node_ptr[i] - 1, -1):
            top = 0.0 if ends[v] else -np.inf
            arc = -1
            for a in range(arc_ptr[v], arc_ptr[v + 1]):
                total = weight[a] + value[head[a]]
                if total > top:
                    top = total
                    arc = a
            value[v] = top
            best[v] = arc


@njit(cache=True, nogil=True, small=SMALL)
def smoothed(begin, end, node_ptr, arc_ptr, head, weight, ends, temperature, value, mass, share):
    """Soft values (nodes,), and the probability `share` (arcs,) of every arc; `mass` (nodes,) is scratch of zeros."""
    for i in range(begin, end):
        for v in range(node_ptr[i + 1] - 1, node_ptr[i] - 1, -1):
            if ends[v]:
                value[v] = 0.0
                continue
            top = -np.inf
            for a in range(arc_ptr[v], arc_ptr[v + 1]):
                total = weight[a] + value[head[a]]
                if total > top:
                    top = total
            if top == -np.inf:
                value[v] = top
                continue
            whole = 0.0
            for a in range(arc_ptr[v], arc_ptr[v + 1]):
                share[a] = np.exp((weight[a] + value[head[a]] - top) / temperature)
                whole += share[a]
            for a in range(arc_ptr[v], arc_ptr[v + 1]):
                share[a] /= whole
            value[v] = top + temperature * np.log(whole)
        mass[node_ptr[i]] = 1.0
        for v in range(node_ptr[i], node_ptr[i + 1]):
            for a in range(arc_ptr[v], arc_ptr[v + 1]):
                share[a] *= mass[v]
                mass[head[a]] += share[a]


@njit(cache=True, nogil=True, small=SMALL)
def arrived(begin, end, node_ptr, arc_ptr, head, weight, value):
    """Fill `value` (nodes,) with the longest way from the source to every node of some agents."""
    for i in range(begin, end):
        for v in range(node_ptr[i], node_ptr[i + 1]):
            value[v] = -np.inf
        value[node_ptr[i]] = 0.0
        for v in range(node_ptr[i], node_ptr[i + 1]):
            for a in range(arc_ptr[v], arc_ptr[v + 1]):
                total = value[v] + weight[a]
                if total > value[head[a]]:
                    value[head[a]] = total
