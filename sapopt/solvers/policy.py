"""Policies that play alpha of a generated benefit matrix, and the generators themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sapopt.data.matrices import Matrix, checked_matrix
from sapopt.data.types import IntArray
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.base import EXTRAS

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
    takes: ClassVar[frozenset[str]] = EXTRAS

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

    takes: ClassVar[frozenset[str]] = EXTRAS

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
