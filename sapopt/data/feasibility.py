"""Whether a full assignment exists, and which agents are short of tasks where none does."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.naming import Naming


class InfeasibleError(ValueError):
    """No full assignment exists; the message names the agents that are short of tasks."""


def explain_infeasible(allowed: Any, naming: Naming | None = None) -> str:
    """Say which agents are short of tasks, given the mask (n, m) of allowed pairs, an array or CSR, and their names."""
    from scipy.sparse.csgraph import breadth_first_order, maximum_bipartite_matching

    graph = sp.csr_array(allowed)
    graph.eliminate_zeros()
    n, m = graph.shape
    tasks = maximum_bipartite_matching(graph, perm_type="column")
    unmatched = np.flatnonzero(tasks < 0)
    if not len(unmatched):
        return ""
    # Agents reachable by alternating paths from an unmatched one compete for fewer tasks than they are (Hall).
    owner = np.full(m, -1)
    owner[tasks[tasks >= 0]] = np.flatnonzero(tasks >= 0)
    step = sp.csr_array(graph[:, owner >= 0] != 0)
    onward = sp.csr_array((step.data, owner[owner >= 0][step.indices], step.indptr), shape=(n, n))
    agents = np.sort(breadth_first_order(onward, int(unmatched[0]), return_predecessors=False))
    share = len(np.unique(sp.csr_array(graph[agents]).indices))
    names = (naming or Naming()).several(agents)
    return (
        f"no full assignment exists: {names} ({len(agents)} in all) are allowed only {share} tasks together"
    )
