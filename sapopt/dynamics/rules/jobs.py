"""Jobs: a task, once begun, keeps an agent busy for a while."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray, checked_cost, index_array
from sapopt.dynamics.base import AgentColumns, Setting
from sapopt.dynamics.rules.agent_local import AgentLocal, LocalStates


@dataclass(frozen=True, eq=False)
class Jobs(AgentLocal):
    """To hold a task whose benefit is not zero is to begin it; the agent is then busy for the length of the job.

    The benefit at the step of the beginning pays for the whole job. A busy agent begins nothing: such pairs are
    forbidden, so problems with this rule pass ``idle=True``, or have tasks of zero benefit. What is held over an
    interval is begun anew at every step of it, so `HAAL` looks no further than one step here. The local state is the
    step from which on an agent is free.

    Parameters
    ----------
    length : array_like of int
        Steps from the beginning of a job to that of the next one, at least 1: anything that broadcasts to
        ``(T, n, m)``, such as one number for each task.
    cost : float
        Of every job, not negative.

    Raises
    ------
    ValueError
        If a number is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from sapopt import SAP, solve
    >>> from sapopt.dynamics import Jobs
    >>> from sapopt.solvers import Exact
    >>> problem = SAP(np.ones((5, 1, 1)), Jobs([2]), idle=True)
    >>> solve(problem, Exact()).value  # begun at steps 0, 2 and 4
    3.0
    """

    length: IntArray
    cost: float = 0.0
    handover_limit = 0.0

    def __post_init__(self) -> None:
        length = index_array(self.length, "length")
        if length.ndim > 3 or (length < 1).any():
            raise ValueError("length must be whole numbers of at least 1 that broadcast to (T, n, m)")
        object.__setattr__(self, "length", length)
        object.__setattr__(self, "cost", checked_cost(self.cost))

    def __repr__(self) -> str:
        return f"Jobs(length={self.length.min(initial=1)}..{self.length.max(initial=1)}, cost={self.cost})"

    def validate(self, problem: Setting) -> None:
        """Check that the lengths fit the problem."""
        shape = (*np.ones(3 - self.length.ndim, dtype=np.int64), *self.length.shape)
        wanted = problem.T, problem.n
        tasks = int(problem.benefits.flat().indices.max(initial=-1)) + 1
        fits = shape[0] == 1 or shape[0] >= wanted[0]  # the first steps of a problem are one, too
        if not fits or shape[1] not in (1, wanted[1]) or (shape[2] != 1 and shape[2] < tasks):
            raise ValueError(
                f"length has shape {self.length.shape}, which does not broadcast to (T, n, m) = "
                f"{(problem.T, problem.n, problem.m)}"
            )

    def start(self, problem: Setting) -> IntArray:
        """All agents are free."""
        return np.zeros(problem.n, dtype=np.int64)

    def features(self, state: LocalStates) -> FloatArray:
        """For how many steps every agent is busy yet, shape ``(n, 1)``."""
        return np.maximum(state.local - state.step, 0)[:, None].astype(np.float64)

    def agent_columns(self, state: LocalStates) -> AgentColumns:
        """In how many steps every agent is free."""
        return AgentColumns({}, {"busy": np.maximum(state.local - state.step, 0)})

    def of_columns(self, columns: AgentColumns) -> LocalStates:
        """The agents before the first step of the benefits."""
        return LocalStates(0, columns.values["busy"])

    def rule(
        self, k: int, agent: IntArray, local: IntArray, task: IntArray, benefit: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Begin a job, or go on with what was begun."""
        begins = benefit != 0
        length = self.length.reshape((1,) * (3 - self.length.ndim) + self.length.shape)
        steps, agents, tasks = length.shape
        which = np.where(begins, task, 0) if tasks > 1 else np.zeros(len(task), dtype=np.int64)
        lasts = length[k if steps > 1 else 0, agent if agents > 1 else 0, which]
        eta = np.where(begins, -self.cost, 0.0)
        eta[begins & (local > k)] = -np.inf
        return eta, np.where(begins & (local <= k), k + lasts, np.maximum(local, k + 1))
