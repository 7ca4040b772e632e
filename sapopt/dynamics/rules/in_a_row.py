"""Rosters: nobody works more than so many days in a row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray, checked_cost, index_array
from sapopt.dynamics.base import Setting
from sapopt.dynamics.rules.agent_local import AgentLocal, LocalStates


@dataclass(frozen=True, eq=False)
class AtMostInARow(AgentLocal):
    """Agents work at most so many steps on end, then rest for one at least; to begin again costs something.

    An agent works where it holds a task whose benefit is not zero, and rests elsewhere. Whoever has worked `most` steps
    on end may hold no such task at the next one: problems with this rule pass ``idle=True``, or have tasks of zero
    benefit. The local state is the number of steps worked on end.

    Parameters
    ----------
    most : int
        At least 1.
    cost : float
        Of the first step of work after a rest, not negative.
    worked : array_like of int, shape (n,), optional
        Steps worked on end before the first one; none if omitted.

    Raises
    ------
    ValueError
        If a number is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from sapopt import SAP, solve
    >>> from sapopt.dynamics import AtMostInARow
    >>> from sapopt.solvers import Exact
    >>> problem = SAP(np.ones((5, 1, 1)), AtMostInARow(2, 0.1), idle=True)
    >>> round(solve(problem, Exact()).value, 3)
    3.8
    """

    most: int
    cost: float = 0.0
    worked: IntArray | None = None
    agents_alike = True
    handover_limit = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.most, bool) or int(self.most) != self.most or self.most < 1:
            raise ValueError(f"most must be a whole number of steps, at least 1, got {self.most!r}")
        object.__setattr__(self, "most", int(self.most))
        object.__setattr__(self, "cost", checked_cost(self.cost))
        if self.worked is not None:
            worked = index_array(self.worked, "worked")
            if worked.ndim != 1 or (worked < 0).any() or (worked > self.most).any():
                raise ValueError(f"worked must be a list of whole numbers in 0..{self.most}")
            object.__setattr__(self, "worked", worked)

    def __repr__(self) -> str:
        return f"AtMostInARow({self.most}, cost={self.cost})"

    def validate(self, problem: Setting) -> None:
        """Check that the past fits the agents."""
        if self.worked is not None and len(self.worked) != problem.n:
            raise ValueError(f"worked has {len(self.worked)} entries for {problem.n} agents")

    def start(self, problem: Setting) -> IntArray:
        """What was worked before; an initial assignment tells nothing about it."""
        return np.zeros(problem.n, dtype=np.int64) if self.worked is None else self.worked.copy()

    def features(self, state: LocalStates) -> FloatArray:
        """The steps worked on end as a share of the most, shape ``(n, 1)``."""
        return (state.local / self.most)[:, None].astype(np.float64)

    def rule(
        self, k: int, agent: IntArray, local: IntArray, task: IntArray, benefit: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Work one more step, if that may be, or rest."""
        works = benefit != 0
        eta = np.where(works & (local == 0), -self.cost, 0.0)
        eta[works & (local >= self.most)] = -np.inf
        return eta, np.where(works, np.minimum(local + 1, self.most), 0)
