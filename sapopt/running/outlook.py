"""What a policy may know at a step, and what a policy is."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from sapopt.data.assignment import best_assignment
from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.matrices import GainMatrix, Matrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.data.windows import WindowSums
from sapopt.dynamics.base import Model
from sapopt.problem.sap import SAP
from sapopt.running.steps import StepRules

log = logging.getLogger(__name__)

Forecast = Callable[[int, int], Any]
"""``forecast(k, steps)``: predicted benefits of the steps ``k .. k + steps - 1`` as known at step k, shape
``(steps, n, m)`` (array, list of sparse matrices, or Benefits)."""


def _never() -> None:
    """The check of an outlook that nobody waits for."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """Everything a policy may use to decide step `k`.

    Attributes
    ----------
    k : int
        Current step, 0-based.
    end : int
        Steps ``k .. end - 1`` are known or forecast.
    state : object
        Current state.
    problem : SAP
        For sizes, dynamics and labels. The true future benefits in it are not for policies.
    windows : WindowSums
        Known or forecast benefits.
    parking : ndarray of int64, shape (m,)
        Order in which idle agents try free tasks.
    check : callable
        Raises `sapopt.running.control.Expired` when the run is over. A policy whose step takes long calls it now and
        then and lets the exception pass; the step then counts as not decided.
    allowance : float
        Seconds that this step may take if the steps left share the time left evenly; infinite without a time limit. A
        policy that gets better the longer it thinks keeps to a multiple of it rather than be cut off.
    rules : StepRules or None
        What capacities and limits allow at this step; None where every task takes one agent and there are no limits.
    deadline : float
        Time on `sapopt.kernels.clock.now` from which on a policy that can stop thinking should answer with what it has.
    shortened : callable
        Called by a policy that does less than it would have done without the deadline.
    goes_on : int
        Steps that follow the last one of the problem; a great number in a `sapopt.Session`, whose end is not known.
    """

    k: int
    end: int
    state: Any
    problem: SAP
    windows: WindowSums
    parking: IntArray
    check: Callable[[], None] = _never
    allowance: float = np.inf
    rules: StepRules | None = None
    deadline: float = np.inf
    shortened: Callable[[], None] = _never
    goes_on: int = 0

    @property
    def model(self) -> Model:
        """The dynamics, as the solvers see it."""
        return self.problem.model

    def benefits(self, steps: int) -> Benefits:
        """Benefits of the next steps, at most `steps` of them, from step k on."""
        return self.windows.slice(self.k, min(self.k + steps, self.end))

    def interval(self, start: int, stop: int, state: Any) -> Matrix:
        """Benefit of holding one assignment over ``start .. stop - 1``, entered in `state`."""
        return self.problem.model.interval(self.windows, start, stop, state)

    def entered(self, start: int, stop: int, state: Any) -> Matrix:
        """What Algorithm 2 assigns an interval by (thesis, lines 8 and 9): its summed benefits plus eta(state).

        The handover counts once, as if the state stayed what it is at the interval's first step. `interval` may know
        better: for batteries and rules of `AgentLocal` it counts what really happens on the way.
        """
        if (
            stop == start + 1 or self.model.switching() is not None
        ):  # there an interval is entered, and no more
            return self.interval(start, stop, state)
        first = self.interval(start, start + 1, state)
        later = self.windows.summed(start + 1, stop)
        if isinstance(first, GainMatrix):
            if not isinstance(later, np.ndarray) and not np.isneginf(later.data).any():
                return first.plus(later)
            first = first.toarray()
        return first + dense_step(later)

    def played(self, start: int, stop: int, state: Any, tasks: IntArray) -> tuple[FloatArray, Any]:
        """What an assignment that is held over ``start .. stop - 1`` brings every agent, (n,), and the state after it.

        The state moves at every step (thesis, Algorithm 2, lines 11 and 12).
        """
        gains = np.zeros(len(tasks))
        for k in range(start, stop):
            gains += self.windows.slice(k, k + 1).at(tasks[None])[0] + self.model.handover_at(k, state, tasks)
            state = self.problem.transition(k, state, tasks)
        return gains, state

    def beta_hat(self) -> Matrix:
        """State-dependent benefits of the current step."""
        return self.interval(self.k, self.k + 1, self.state)

    def assign(self, matrix: Matrix) -> IntArray:
        """Alpha of a matrix for the current step; within capacities and limits, where there are some."""
        return self.alpha(matrix, self.k, self.k + 1)

    def alpha(self, matrix: Matrix, start: int, stop: int, parking: IntArray | None = None) -> IntArray:
        """Alpha of a matrix for the steps ``start .. stop - 1``.

        Limits count at the current step alone: only its assignment is executed.

        Raises
        ------
        InfeasibleError
            If there is no such assignment.
        """
        order = self.parking if parking is None else parking
        try:
            if self.rules is not None:
                return self.rules.assign(matrix, start, stop)
            return best_assignment(matrix, order).tasks
        except InfeasibleError as error:
            raise InfeasibleError(f"step {self.k}: {error}") from None


@runtime_checkable
class Policy(Protocol):
    """Decides step by step. A policy is immutable; what it remembers between steps is its explicit memory.

    See `Recording` for a policy that tells the trace more.
    """

    @property
    def name(self) -> str:
        """Name with options, for tables."""

    def begin(self, problem: SAP, rng: np.random.Generator) -> Any:
        """Memory before the first step."""

    def act(self, outlook: Outlook, memory: Any) -> tuple[IntArray, Any]:
        """Assignment of the current step and the next memory."""


@runtime_checkable
class Recording(Policy, Protocol):
    """A policy that says something of every step."""

    def record(self, memory: Any) -> dict[str, Any]:
        """What goes into the trace, with equal keys throughout."""


class Change(NamedTuple):
    """What comes and goes between two decisions of a policy, and what of it was there before.

    Attributes
    ----------
    agents : ndarray of int64, shape (n,)
        Former index of every agent, -1 for a new one.
    tasks : ndarray of int64, shape (m,)
        Former index of every task, -1 for a new one; where agents may idle, idleness is the last.
    limits : ndarray of int64, shape (rows,)
        Former index of every row of the limits, -1 for a new one.
    steps : int
        Steps between the two decisions; 1 where one follows the other.
    """

    agents: IntArray
    tasks: IntArray
    limits: IntArray
    steps: int


@runtime_checkable
class Carrying(Policy, Protocol):
    """A policy whose memory goes on while agents and tasks come and go; that of any other policy begins anew each time.

    For `sapopt.Session`. Memories are never changed in place.
    """

    def carried(self, memory: Any, change: Change) -> Any:
        """The memory for the agents, tasks and limits that there are now, as if the last decision was a step ago."""

    def stored(self, memory: Any) -> dict[str, np.ndarray]:
        """All of the memory as arrays of numbers, for a file."""

    def restored(self, arrays: dict[str, np.ndarray]) -> Any:
        """Undo `stored`."""
