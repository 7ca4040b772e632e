"""The interval subproblems of HAAL (thesis, section 3.3): every way to cut a window into intervals, spelled out.

Each interval is one assignment problem over the sum of its benefits plus the handover from the state before it. This
is the plain form, sequence by sequence and without memory, for study and for testing the solver;
`sapopt.solvers.HAAL` is the fast one.

    refusal(problem) -> reason or None
    formulate(problem, k, lookahead, state) -> Intervals
    recover(intervals) -> assignment
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sapopt.data.assignment import best_assignment
from sapopt.data.benefits import dense_step
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.sap import SAP

_TIE = 1e-12
_MOST = 16

Sequence = tuple[tuple[int, int], ...]
"""Intervals ``(start, stop)``, each standing for the steps ``start .. stop - 1``."""


@dataclass(frozen=True, eq=False)
class Intervals:
    """The sequences of one window.

    Attributes
    ----------
    problem : SAP
    state : object
        State before the first step of the window.
    sequences : tuple
        All ``2^(L-1)`` ways to cut the window, shortest first interval first.
    """

    problem: SAP
    state: Any
    sequences: tuple[Sequence, ...]

    def matrix(self, start: int, stop: int, state: Any) -> FloatArray:
        """Benefit (n, m) of holding one assignment over ``start .. stop - 1``, entered in `state`."""
        total = dense_step(self.problem.benefits.step(start)).copy()
        for k in range(start + 1, stop):
            total += dense_step(self.problem.benefits.step(k))
        return total + self.problem.handover(start, state)

    def play(self, sequence: Sequence) -> tuple[list[IntArray], float]:
        """Assignments of the intervals, solved in turn, and the sum of their values; -inf if one has none."""
        state, total = self.state, 0.0
        held: list[IntArray] = []
        order = np.arange(self.problem.m)
        for start, stop in sequence:
            try:
                found = best_assignment(self.matrix(start, stop, state), order)
            except InfeasibleError:
                return held, -np.inf
            held.append(found.tasks)
            total += found.value
            for k in range(start, stop):
                state = self.problem.transition(k, state, found.tasks)
        return held, total


def cuts(start: int, stop: int) -> Iterator[Sequence]:
    """All ways to cut ``start .. stop - 1`` into intervals, shortest first interval first."""
    if start == stop:
        yield ()
    for middle in range(start + 1, stop + 1):
        for rest in cuts(middle, stop):
            yield ((start, middle), *rest)


def refusal(problem: SAP) -> str | None:
    """None: every problem has interval subproblems."""
    return None


def formulate(problem: SAP, k: int, lookahead: int, state: Any) -> Intervals:
    """The interval sequences of the window ``k .. min(k + lookahead, T) - 1``.

    Raises
    ------
    ValueError
        If the step or the lookahead is out of range.
    """
    if not 0 <= k < problem.T:
        raise ValueError(f"k: step {k} is outside 0..{problem.T - 1}")
    if not 1 <= lookahead <= _MOST:
        raise ValueError(f"lookahead must be 1..{_MOST} (there are 2^(L-1) sequences), got {lookahead!r}")
    return Intervals(problem, state, tuple(cuts(k, min(k + lookahead, problem.T))))


def recover(intervals: Intervals) -> IntArray:
    """First assignment (n,) of the best sequence; of equal ones, the first in order.

    Raises
    ------
    InfeasibleError
        If no sequence can be played to its end.
    """
    first: IntArray | None = None
    best = -np.inf
    for sequence in intervals.sequences:
        held, value = intervals.play(sequence)
        if value > -np.inf and (first is None or value > best + _TIE * abs(best)):
            first, best = held[0], value
    if first is None:
        raise InfeasibleError("no sequence of intervals is feasible")
    return first
