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
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import dense_step
from sapopt.problem.sap import SAP
from sapopt.proofs.conditions import Conditions, conditions, handover_range

_NUMBERS = ("least_benefit", "least_benefit_by_entry", "handover_size", "c", "ratio", "refined_ratio")


@runtime_checkable
class Guaranteed(Protocol):
    """A solver that says whether the theorem is about it, with the options that it has."""

    @property
    def keeps_guarantee(self) -> bool:
        """Whether its plans are worth at least what a `Guarantee` promises."""


@dataclass(frozen=True)
class Guarantee:
    """A-priori guarantees of a problem.

    Attributes
    ----------
    least_benefit : float
        B, the least value of an assignment at any step, handovers left out.
    least_benefit_by_entry : float
        n times the smallest benefit; at most `least_benefit`, and cheaper. (Footnote 3 takes the smallest benefit
        itself, which is smaller still wherever B is not negative.)
    handover_size : float
        ``|H|``, the greatest less the least handover value of an assignment; NaN where the dynamics does not say.
    c : float
        The greatest c with ``least_benefit >= c * handover_size``; infinite if handovers cost nothing, NaN where
        unknown or negative.
    ratio : float
        ``c / (1 + c)``; 0 where nothing is promised.
    refined_ratio : float
        ``sum_k max(m_k, M_k + h) / sum_k (M_k + h')`` with the handover values between h and h'; 0 where nothing is
        promised.
    conditions : Conditions
    """

    least_benefit: float
    least_benefit_by_entry: float
    handover_size: float
    c: float
    ratio: float
    refined_ratio: float
    conditions: Conditions

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Guarantee:
        """Undo `dataclasses.asdict`.

        Raises
        ------
        TypeError, KeyError
            If the values are not of the kinds that a guarantee has.
        """
        for name in _NUMBERS:
            if isinstance(values[name], bool) or not isinstance(values[name], (int, float)):
                raise TypeError(f"{name} is no number")
            if isinstance(values[name], int) and abs(values[name]) > 2**53:
                raise TypeError(f"{name} is no float64")
        return cls(**{**values, "conditions": Conditions(**values["conditions"])})

    def excess(self, other: Guarantee) -> str:
        """What this promises beyond another guarantee, by name and the other's number; empty if nothing.

        The numbers are sums over a step in an order that depends on the machine, so a share of 1e-12 may differ.
        """
        for name in _NUMBERS:
            mine, theirs = float(getattr(self, name)), float(getattr(other, name))
            if math.isnan(mine) or mine == theirs:
                if math.isnan(mine) != math.isnan(theirs):
                    return f"{name} of {theirs!r}"
                continue
            near = math.isclose(mine, theirs, rel_tol=1e-12, abs_tol=0.0)
            if not near and not (mine > theirs if name == "handover_size" else mine < theirs):
                return f"{name} of {theirs!r}"
        return "" if repr(self.conditions) == repr(other.conditions) else "set of conditions that differs"

    @property
    def applies(self) -> bool:
        """Whether theorem 3.5.1 is known to apply: c > 0, and its conditions hold."""
        return not self.conditions.broken and self.c > 0

    @property
    def statement(self) -> str:
        """What is promised, and for which algorithms."""
        if self.refined_ratio <= 0:
            why = self.conditions.broken or "handovers may cost more than all benefits are worth"
            if not self.handover_size >= 0:
                why = "the dynamics does not say how much handovers can cost (handover_limit, handover_floor)"
            return f"Nothing is promised a priori: {self.conditions.broken or why}."
        who = "HAA, HAAL with lookahead 1 or 2, and HAAL with keep_plan=True reach at least"
        theorem = (
            f"theorem 3.5.1, c = {self.c:.4g}" if self.applies else "theorem 3.5.1 says nothing, for c is 0"
        )
        if not self.applies:
            return f"{who} {100 * self.refined_ratio:.4g} % of the optimum (the refined ratio; {theorem})."
        return (
            f"{who} {100 * self.ratio:.4g} % of the optimum ({theorem}; refined: "
            f"{100 * self.refined_ratio:.4g} %). HAAL with lookahead 3 or more is promised nothing."
        )

    def covers(self, solver: Any) -> bool:
        """Whether the ratios are promised for a solver: HAA, HAAL with lookahead at most 2 or ``keep_plan=True``.

        A solver says so itself (`Guaranteed`).
        """
        return not self.conditions.broken and isinstance(solver, Guaranteed) and solver.keeps_guarantee


def guarantee(problem: SAP) -> Guarantee:
    """Compute the a-priori guarantees of a problem.

    Parameters
    ----------
    problem : SAP

    Returns
    -------
    Guarantee
    """
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
