"""What can be promised about HAA and HAAL before solving anything: the c / (1 + c) theorem, and a better bound.

With B the least value that any assignment has at any step and ``|H|`` the difference between the greatest and the least
handover value of an assignment, the thesis (theorem 3.5.1) promises HAAL at least c / (1 + c) of the optimum, with c
the greatest number such that ``B >= c |H|``, if c > 0 and the handover matrix vanishes for agents that stay. What holds
of it (docs/theorem.md): it is true for lookahead 1 and 2 (HAA is lookahead 1) and for HAAL with ``keep_plan=True`` at
any lookahead; for HAAL with lookahead 3 or more it is false (small counterexamples). Nothing holds where pairs are
forbidden, for then an agent may be unable to stay.

The refined guarantee holds for the same algorithms. With m_k and M_k the least and the greatest value of an assignment
at step k, and h <= 0 <= h' the least and the greatest handover value, every one of them collects at least
``max(m_k, M_k + h)`` at every step, and the optimum at most ``M_k + h'``. It is never below c / (1 + c), and says
something where B = 0.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import dense_step
from sapopt.problem.sap import SAP
from sapopt.proofs.conditions import conditions, handover_range
from sapopt.proofs.promises import Guarantee, nothing_promised


def guarantee(problem: SAP) -> Guarantee:
    """Compute the a-priori guarantees of a problem.

    Parameters
    ----------
    problem : SAP

    Returns
    -------
    Guarantee
    """
    if not problem.is_plain:
        return nothing_promised(problem.benefits.forbids())
    spans = [_span(problem, k) for k in range(problem.T)]
    least = float(min(low for low, _ in spans))
    handovers = handover_range(problem)
    holds = conditions(problem)
    size = handovers.size
    c = math.nan
    if size >= 0 and least >= 0:
        c = math.inf if size == 0 else least / size
    ratio = refined = 0.0
    if not holds.broken and size >= 0:
        ratio = 0.0 if not c > 0 else 1.0 if size == 0 else least / (least + size)
        best = math.fsum(high + max(handovers.greatest, 0.0) for _, high in spans)
        sure = math.fsum(max(low, high + min(handovers.least, 0.0)) for low, high in spans)
        refined = max(0.0, sure / best) if best > 0 else 0.0
    entry = min(float(dense_min(problem, k)) for k in range(problem.T))
    return Guarantee(least, problem.n * entry, size, c, ratio, refined, holds)


def dense_min(problem: SAP, k: int) -> float:
    """Smallest allowed benefit at a step."""
    step = problem.benefits.step(k)
    if isinstance(step, np.ndarray):
        return float(step[np.isfinite(step)].min())
    entries = step.data[np.isfinite(step.data)]
    smallest = float(entries.min()) if len(entries) else 0.0
    return smallest if step.nnz == problem.n * problem.m else min(smallest, 0.0)


def _span(problem: SAP, k: int) -> tuple[float, float]:
    """Least and greatest value of an assignment at step k, handovers left out."""
    from scipy.optimize import linear_sum_assignment

    step = problem.benefits.step(k)
    if not isinstance(step, np.ndarray) and step.nnz and step.data.min() >= 0 and _can_idle(step, problem.m):
        return 0.0, _most(step)
    dense = dense_step(step)
    low_rows = linear_sum_assignment(np.where(np.isfinite(dense), dense, np.inf))
    return float(dense[low_rows].sum()), float(dense[linear_sum_assignment(dense, maximize=True)].sum())


def _most(step: Any) -> float:
    """Greatest value of an assignment of benefits that are not negative, where every agent may also hold nothing.

    By scipy and not by the library's own kernels, so that a certificate shares nothing with the solvers.
    """
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    n, m = step.shape
    agents = np.arange(n)
    row = np.concatenate([np.repeat(agents, np.diff(step.indptr)), agents])
    column = np.concatenate([step.indices, m + agents])  # one column of its own for every idle agent
    gain = np.concatenate([step.data, np.zeros(n)])
    # A power of two changes no bit of a gain, and far from both ends of float64 no sum under- or overflows. scipy drops
    # entries of weight zero, so an idle agent gains the least number there is.
    scaled = np.ldexp(gain, 100 - int(np.frexp(gain.max())[1])) if gain.max() > 0 else gain
    graph = sp.csr_array((np.maximum(scaled, np.nextafter(0.0, 1.0)), (row, column)), shape=(n, m + n))
    held = min_weight_full_bipartite_matching(graph, maximize=True)[1]
    chosen = sp.csr_array((gain, (row, column)), shape=(n, m + n))[agents, held]
    return math.fsum(np.asarray(chosen).ravel().tolist())


def _can_idle(step: Any, m: int) -> bool:
    """Whether all agents can be given tasks that are worth nothing to them; False if that takes more than greed."""
    taken = np.zeros(m, dtype=bool)
    for i in range(step.shape[0]):
        blocked = taken.copy()
        blocked[step.indices[step.indptr[i] : step.indptr[i + 1]]] = True
        free = int(np.argmin(blocked))
        if blocked[free]:
            return False
        taken[free] = True
    return True
