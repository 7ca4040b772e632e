"""A problem family that grows in every direction on its own: agents drift past tasks on a ring.

Agent i starts at place i / n of a ring and moves on; task j stands at j / m, shifted a little at random. An agent sees
the `visible` nearest tasks, `contact` steps long each, with a benefit that is highest overhead. Like a constellation,
but the number of visible pairs is exactly ``T n visible``, whatever n and m.
"""

from __future__ import annotations

import networkx as nx
import numpy as np
import scipy.sparse as sp

from sapopt import SAP


def ring(
    n: int, m: int, steps: int, visible: int = 5, seed: int = 0, contact: float = 6.0, cost: float = 0.5
) -> SAP:
    """The problem.

    Parameters
    ----------
    n, m, steps : int
    visible : int
        Tasks that an agent sees at a step.
    contact : float
        Steps that a task stays in view.
    """
    rng = np.random.default_rng(seed)
    visible = min(visible, m)
    priority = rng.uniform(1.0, 2.0, m)
    speed = visible / contact * rng.uniform(0.8, 1.2, n)  # tasks passed in a step
    place = np.arange(n) * (m / n) + rng.uniform(0.0, m / n, n)
    out = []
    for _ in range(steps):
        place = (place + speed) % m
        first = np.floor(place - visible / 2 + 1).astype(np.int64)
        tasks = first[:, None] + np.arange(visible)
        distance = 2.0 * np.abs(tasks - place[:, None]) / visible
        benefit = priority[tasks % m] * np.exp(-3.0 * distance**2)
        order = np.argsort(tasks % m, axis=1)
        indices = np.take_along_axis(tasks % m, order, axis=1).ravel()
        data = np.take_along_axis(benefit, order, axis=1).ravel()
        out.append(sp.csr_array((data, indices, np.arange(n + 1) * visible), shape=(n, m)))
    return SAP(out, cost)


def neighbours(n: int, reach: int = 4) -> nx.Graph:
    """Who hears whom: the next few agents on the ring, and some far away, so that the diameter stays small."""
    graph = nx.circulant_graph(n, range(1, min(reach, max(1, (n - 1) // 2)) + 1))
    far = max(1, int(np.sqrt(n)))
    graph.add_edges_from((i, (i + far) % n) for i in range(n) if far < n - far)
    return graph
