"""Policies that play alpha of a generated benefit matrix, and the generators themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sapopt.data.matrices import GainMatrix, Matrix, checked_matrix
from sapopt.data.types import IntArray
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook

Generator = Callable[[Outlook], Any]
"""``generator(outlook)`` returns an ``(n, m)`` matrix: array, sparse matrix or GainMatrix."""


def myopic(outlook: Outlook) -> Matrix:
    """The state-dependent benefits beta_hat of the current step."""
    return outlook.beta_hat()


def no_handover(outlook: Outlook) -> Any:
    """The static benefits beta of the current step, blind to the state."""
    return outlook.benefits(1).step(0)


def power_constrained(outlook: Outlook) -> Matrix:
    """beta_hat of a problem with batteries, without the work that would kill the agent (thesis, section 6.4).

    Raises
    ------
    ValueError
        If the dynamics is not a `Battery`.
    """
    from sapopt.solvers.energy import priced_work

    return priced_work(outlook, lambda charge: np.zeros(len(charge)))


def energy_price(outlook: Outlook) -> Matrix:
    """`power_constrained`, with every step of work charged 0.05 + 1.2 (1 - charge) for the energy it takes.

    The emptier an agent's battery, the more a task must be worth to it; a reference that looks at no later step.
    Charge counts as a share of the capacity.

    Raises
    ------
    ValueError
        If the dynamics is not a `Battery`.
    """
    from sapopt.solvers.energy import priced_work

    return priced_work(outlook, lambda charge: 0.05 + 1.2 * (1.0 - charge))


@dataclass(frozen=True)
class AssignmentPolicy:
    """Play alpha(generator(outlook)) at every step.

    Parameters
    ----------
    generator : callable
        ``generator(outlook)`` returns the ``(n, m)`` benefits that are assigned; for example `myopic`.
    """

    generator: Generator

    def __post_init__(self) -> None:
        if not callable(self.generator):
            raise ValueError(f"generator must be callable as generator(outlook), got {self.generator!r}")

    @property
    def name(self) -> str:
        """Name of the generator."""
        return f"AssignmentPolicy({getattr(self.generator, '__name__', type(self.generator).__name__)})"

    def begin(self, problem: SAP, rng: np.random.Generator) -> None:
        """Nothing to remember."""
        return None

    def act(self, outlook: Outlook, memory: None) -> tuple[IntArray, None]:
        """Assign the generated benefits."""
        try:
            matrix = checked_matrix(self.generator(outlook))
        except ValueError as error:
            raise ValueError(f"generator at step {outlook.k}: {error}") from error
        expected = (outlook.problem.n, outlook.problem.m)
        if matrix.shape != expected:
            raise ValueError(
                f"generator returned a matrix of shape {matrix.shape} at step {outlook.k}; expected {expected}"
            )
        return outlook.assign(matrix), None


@dataclass(frozen=True)
class NoHandover:
    """Assign the static benefits at every step as if changing task were free (thesis, section 4.1: alpha(beta))."""

    @property
    def name(self) -> str:
        """Name."""
        return "NoHandover"

    def begin(self, problem: SAP, rng: np.random.Generator) -> None:
        """Nothing to remember."""
        return None

    def act(self, outlook: Outlook, memory: None) -> tuple[IntArray, None]:
        """Assign beta of the current step."""
        return AssignmentPolicy(no_handover).act(outlook, None)


@dataclass(frozen=True)
class Greedy:
    """The greedy algorithm (GA; thesis, section 4.1): agents choose in ascending index, the best free task each.

    An agent without a free task of positive gain over idling keeps its task if it is free and good, else it is parked
    like an idle agent of alpha. The initial assignment counts: its agents pay for leaving their tasks.
    """

    @property
    def name(self) -> str:
        """Name."""
        return "Greedy"

    def begin(self, problem: SAP, rng: np.random.Generator) -> None:
        """Nothing to remember."""
        return None

    def act(self, outlook: Outlook, memory: None) -> tuple[IntArray, None]:
        """Choose agent by agent from beta_hat of the current step."""
        matrix = outlook.beta_hat()
        return _greedy_sparse(matrix, outlook) if isinstance(matrix, GainMatrix) else _greedy_dense(
            matrix, outlook
        ), None


def _greedy_sparse(matrix: GainMatrix, outlook: Outlook) -> IntArray:
    from sapopt.kernels.matching import greedy, park

    rows = (matrix.row_start, matrix.tasks, matrix.gains, matrix.held, matrix.held_gain)
    chosen, owner = greedy(*rows, matrix.m)
    if park(*rows, chosen, owner, outlook.parking, matrix.has_negative):
        return chosen
    return _greedy_dense(matrix.toarray(), outlook)


def _greedy_dense(matrix: np.ndarray, outlook: Outlook) -> IntArray:
    open_tasks = np.ones(matrix.shape[1], dtype=bool)
    chosen = np.empty(matrix.shape[0], dtype=np.int64)
    for i, row in enumerate(matrix):
        values = np.where(open_tasks, row, -np.inf)
        chosen[i] = int(np.argmax(values))
        if values[chosen[i]] == -np.inf:
            # An earlier agent took the only allowed task of this one: greed alone has no full assignment here.
            return outlook.assign(matrix)
        open_tasks[chosen[i]] = False
    return chosen
