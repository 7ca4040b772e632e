"""What may be promised about a problem before it is solved, as data: `Guarantee` and the `Conditions` it rests on.

`sapopt.proofs.guarantees` makes them, `sapopt.proofs.plain_guarantee` computes them anew for who verifies a
certificate; the two share these definitions and nothing else.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

_NUMBERS = ("least_benefit", "least_benefit_by_entry", "handover_size", "c", "ratio", "refined_ratio")

Answer = Literal["yes", "no", "unknown"]
Distance = Callable[[Any, Any], float]
"""``distance(s, s')``: how far two states are apart, not negative, 0 for equal ones."""

ENUMERATED = 20_000
"""Pairs of state and assignment, and of two states, that are tried to decide the conditions of a user's dynamics."""
CLOSE = 1e-12
"""Relative to the handovers of a step: values nearer than that count as equal."""


@dataclass(frozen=True)
class Conditions:
    """Properties of the dynamics that the theorem is about.

    Attributes
    ----------
    vanishing : {"yes", "no", "unknown"}
        Repeating the last assignment never costs (definition 3.5.1: eta >= 0 there; staying may pay).
    strict_penalty : {"yes", "no", "unknown"}
        Of two assignments, the one that moves the state as far or farther has the same or a smaller handover value
        (definition 3.2.2).
    domination : float
        The least D such that an assignment leads from any two states to states at most D apart (definition 3.2.1,
        "assignment-dominated"); NaN where unknown. 0: the state is a function of the last assignment.
    fair_start : {"yes", "no", "unknown"}
        Some assignment costs nothing at the first step, as after a step before it. The proof needs it; the thesis takes
        it for granted.
    all_allowed : {"yes", "no"}
        No pair is forbidden. Otherwise an agent may be unable to stay, and the theorem says nothing.
    one_each : {"yes", "no"}
        Every agent takes one task, every task one agent, and there are no limits.
    """

    vanishing: Answer
    strict_penalty: Answer
    domination: float
    fair_start: Answer
    all_allowed: Answer
    one_each: Answer = "yes"

    @property
    def broken(self) -> str:
        """What keeps the theorem from applying, in words; empty if nothing does."""
        reasons = []
        if self.one_each != "yes":
            return "the theorem is about one task for each agent and one agent for each task, without limits"
        if self.all_allowed != "yes":
            reasons.append("some pairs are forbidden, so that an agent may be unable to stay")
        for answer, what in (
            (self.vanishing, "staying is free (the handover matrix vanishes)"),
            (self.fair_start, "some assignment is free at the first step"),
        ):
            if answer != "yes":
                reasons.append(f"{'it is not so' if answer == 'no' else 'it is not known'} that {what}")
        return "; ".join(reasons)


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


def hamming(one: Any, other: Any) -> float:
    """In how many agents two states differ: rows of arrays, entries of lists; else 1 if they differ at all."""
    if one is None or other is None:
        present = other if one is None else one
        return 0.0 if present is None else _length(present)
    parts, others = _parts(one), _parts(other)
    if parts is None or others is None or len(parts) != len(others):
        return float(one is not other and not _equal(one, other))
    lengths = {len(part) for part in (*parts, *others) if np.ndim(part)}
    if len(lengths) != 1:
        return float(any(not _equal(a, b) for a, b in zip(parts, others, strict=True)))
    differs = np.zeros(lengths.pop(), dtype=bool)
    for a, b in zip(parts, others, strict=True):
        if np.ndim(a) and np.ndim(b):
            unequal = np.asarray(a) != np.asarray(b)
            differs |= unequal.reshape(len(differs), -1).any(axis=1)
        elif not _equal(a, b):
            differs[:] = True
    return float(differs.sum())


def _parts(state: Any) -> list[Any] | None:
    """A state as a list of arrays, one row an agent, and of single values."""
    if isinstance(state, np.ndarray) and state.ndim:
        return [state]
    if dataclasses.is_dataclass(state):
        return [getattr(state, item.name) for item in dataclasses.fields(state)]
    if isinstance(state, tuple) and type(state) is not tuple:  # a named one: its parts differ in kind
        return list(state)
    if isinstance(state, (tuple, list)) and any(isinstance(part, np.ndarray) and part.ndim for part in state):
        return list(state)
    if isinstance(state, (tuple, list)):
        array = np.empty(len(state), dtype=object)
        array[:] = state
        return [array]
    return None


def _length(state: Any) -> float:
    parts = _parts(state)
    lengths = [len(part) for part in parts or () if np.ndim(part)]
    return float(max(lengths, default=1))


def _equal(one: Any, other: Any) -> bool:
    return bool(np.array_equal(one, other)) if np.ndim(one) or np.ndim(other) else bool(one == other)


def nothing_promised(forbids: bool) -> Guarantee:
    """The guarantee of a problem with capacities, idleness or limits, which the theorem is not about: none.

    Parameters
    ----------
    forbids : bool
        Whether a pair is forbidden.
    """
    unknown = Conditions("unknown", "unknown", math.nan, "unknown", "no" if forbids else "yes", "no")
    return Guarantee(math.nan, math.nan, math.nan, math.nan, 0.0, 0.0, unknown)
