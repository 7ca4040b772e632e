"""Iterated assignment: a policy for benefits that depend on the other assignments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sapopt.data.matrices import GainMatrix, checked_matrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.base import EXTRAS, check_lookahead
from sapopt.solvers.policy import Generator, myopic


@dataclass(frozen=True)
class IteratedAssignment:
    """At every step: fix what the others do, linearise, assign, repeat, and play the best assignment met.

    The step's value is quadratic in the assignment. With the other agents' assignments fixed it is linear for each
    agent, so alpha of the generated matrix plus what every pair would lose is the best common answer; what "the others
    do" is a running mean of the answers, so that agents who keep evading each other settle.

    Parameters
    ----------
    iterations : int
        Most assignments at a step, the first one (blind to the interaction) among them.
    damping : float
        Share of the running mean that is kept at every iteration, 0 to below 1.
    generator : callable
        What is assigned besides the interaction, see `AssignmentPolicy`; beta_hat by default.

    Notes
    -----
    Promised: the assignment played is worth, with the interaction, at least as much at this step as alpha of the
    generator. Not promised: that it is the best of the step (the iteration finds assignments that no single reaction
    improves, if it settles at all), nor anything about later steps.
    """

    iterations: int = 12
    damping: float = 0.5
    generator: Generator = myopic

    takes: ClassVar[frozenset[str]] = EXTRAS

    def __post_init__(self) -> None:
        check_lookahead(self.iterations, "iterations")
        if not 0 <= self.damping < 1:
            raise ValueError(f"damping must be at least 0 and below 1, got {self.damping!r}")
        if not callable(self.generator):
            raise ValueError(f"generator must be callable as generator(outlook), got {self.generator!r}")

    @property
    def name(self) -> str:
        """Name with options."""
        suffix = "" if self.generator is myopic else f", {getattr(self.generator, '__name__', 'generator')}"
        return f"IteratedAssignment(iterations={self.iterations}{suffix})"

    def begin(self, problem: SAP, rng: np.random.Generator) -> None:
        """Nothing to remember."""
        if not problem.model.interacts:
            raise ValueError(
                f"IteratedAssignment is for benefits that depend on the other assignments, such as Interference; "
                f"{problem.model.called} has no interaction, so take HAA or AssignmentPolicy"
            )
        return None

    def act(self, outlook: Outlook, memory: None) -> tuple[IntArray, None]:
        """Iterate on the current step."""
        matrix = checked_matrix(self.generator(outlook))
        alone: FloatArray = matrix.toarray() if isinstance(matrix, GainMatrix) else matrix
        model, k, state = outlook.model, outlook.k, outlook.state
        agents = np.arange(outlook.problem.n)
        mean = np.zeros(alone.shape)
        best, top = np.empty(0, dtype=np.int64), -np.inf
        answer = outlook.assign(matrix)
        for turn in range(self.iterations):
            outlook.check()  # an assignment problem of many agents takes a good part of a second
            value = float(alone[agents, answer].sum() + model.interaction(k, state, answer).sum())
            if value > top:
                best, top = answer, value
            pure = np.zeros(alone.shape)
            pure[agents, answer] = model.serves(k, state, answer)
            keep = self.damping if turn else 0.0
            mean = keep * mean + (1.0 - keep) * pure
            reply = outlook.assign(alone + model.marginal(k, state, mean.sum(axis=0) - mean))
            if np.array_equal(reply, answer) and np.array_equal(mean, pure):
                break
            answer = reply
        return best, None
