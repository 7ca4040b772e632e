"""A global state that one agent sets for all: the dictator (thesis, section 6.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray, index_array, real_array
from sapopt.dynamics.base import Model, Setting


@dataclass(frozen=True, eq=False)
class Dictator(Model):
    """The task that one agent holds decides the next state, and the state decides what all agents' tasks are worth.

    Parameters
    ----------
    values : array_like of shape (S, n, m)
        What each of the S states adds to the benefits: ``eta(s) = values[s]``.
    leads_to : array_like of int, shape (S, m)
        State after the dictator held each task, in every state.
    leader : int
        The dictator's index among the agents.
    start : int
        State before the first step. An initial assignment of the problem does not change it.

    Raises
    ------
    ValueError
        If a shape or a number does not fit.

    Notes
    -----
    The state is not local to the agents, so prices prove nothing: `Exact(method="dp")` solves small problems exactly,
    and `bound` takes alpha of the benefits plus the largest value.
    """

    values: FloatArray
    leads_to: IntArray
    leader: int = 0
    start: int = 0

    def __post_init__(self) -> None:
        values = real_array(self.values, "values")
        leads_to = index_array(self.leads_to, "leads_to")
        if values.ndim != 3 or 0 in values.shape:
            raise ValueError(f"values must have shape (S, n, m), got {values.shape}")
        if not np.isfinite(values).all():
            raise ValueError("values must be finite; forbid a pair by -inf in the benefits")
        S, n, m = values.shape
        if leads_to.shape != (S, m) or leads_to.min() < 0 or leads_to.max() >= S:
            raise ValueError(f"leads_to must hold states 0..{S - 1} and have shape (S, m) = {(S, m)}")
        for name, count in (("leader", n), ("start", S)):
            number = getattr(self, name)
            if isinstance(number, bool) or int(number) != number or not 0 <= number < count:
                raise ValueError(f"{name} must be a whole number in 0..{count - 1}, got {number!r}")
            object.__setattr__(self, name, int(number))
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "leads_to", leads_to)

    def __repr__(self) -> str:
        return f"Dictator(states={len(self.values)}, leader={self.leader}, start={self.start})"

    @property
    def handover_limit(self) -> float:  # type: ignore[override]  # a property is a number too
        """Largest entry that the handover matrix can have."""
        return float(self.values.max())

    def validate(self, problem: Setting) -> None:
        """Check that the values fit the benefits."""
        if self.values.shape[1:] != (problem.n, problem.m):
            raise ValueError(
                f"values are for {self.values.shape[1]} agents and {self.values.shape[2]} tasks, "
                f"the benefits for {problem.n} and {problem.m}"
            )

    def initial_state(self, problem: Setting) -> int:
        """The state `start`."""
        return self.start

    def handover(self, k: int, state: int) -> FloatArray:
        """What the state adds to every pair, shape ``(n, m)``."""
        return self.values[state]

    def handover_at(self, k: int, state: int, assignment: IntArray) -> FloatArray:
        """What the state adds to every agent under an assignment, shape ``(n,)``."""
        return np.asarray(self.values[state, np.arange(len(assignment)), assignment])

    def transition(self, k: int, state: int, assignment: IntArray) -> int:
        """The state that the dictator's task leads to."""
        return int(self.leads_to[state, assignment[self.leader]])

    def key(self, state: int) -> int:
        """Fingerprint of a state."""
        return state
