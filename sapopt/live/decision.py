"""What a session answers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from sapopt.live.names import Name

Assignment = dict[Name, Name | None]
"""Task of every agent by their ids; None for nothing."""


class Outcome(Enum):
    """How a decision came about."""

    COMPLETE = "complete"
    SHORT = "short"
    FALLBACK = "fallback"
    FROZEN = "frozen"

    @property
    def message(self) -> str:
        """What it means."""
        return _MESSAGES[self]


_MESSAGES = {
    Outcome.COMPLETE: "The policy came to the end of its work.",
    Outcome.SHORT: "The budget ended the policy's search; what it had found by then is played.",
    Outcome.FALLBACK: "The policy had no answer within the budget, or one that is worth less over the window than the "
    "best assignment of the step (HAA), so this one is played.",
    Outcome.FROZEN: "The step was announced and frozen: nothing was left to decide.",
}


@dataclass(frozen=True, eq=False)
class Decision:
    """The answer to one call of `Session.step`.

    Attributes
    ----------
    assignment : dict
        ``{agent id: task id or None}`` for the step that begins now.
    plan : tuple of dict
        The steps announced: the assignment, and what is to follow as far as is known today (`Session`, `announce`).
    value : float
        What a plan that begins with the assignment is worth over the whole window: benefits, handovers, limits that are
        paid for, teams, and changes of what was announced. The rest of that plan is the policy's announcement, then the
        best assignment of each step.
    bound : float or None
        No plan of this window is worth more, from the state that there is, with what is frozen. None if nothing is
        proven: the dynamics is not agent-local, a part of the agents is frozen, or there was no time.
    gained : float
        What the step that begins now is worth alone: benefits, handovers and changes, without limits and teams.
    seconds : float
        Time from the call to the answer.
    status : Outcome
    step : int
        Number of the call, from 0 on.
    changes : tuple of agent ids
        Who does not do now what was announced for now, though the task is still there and still worth something.
    """

    assignment: Assignment
    plan: tuple[Assignment, ...]
    value: float
    bound: float | None
    gained: float
    seconds: float
    status: Outcome
    step: int
    changes: tuple[Name, ...] = ()

    @property
    def gap(self) -> float | None:
        """``(bound - value) / |bound|``, or None without a bound."""
        if self.bound is None:
            return None
        if self.bound == 0:
            return 0.0 if self.value == 0 else float("inf")
        return (self.bound - self.value) / abs(self.bound)

    def __repr__(self) -> str:
        proof = "" if self.bound is None else f", bound={self.bound:.6g}"
        return (
            f"Decision(step={self.step}, value={self.value:.6g}{proof}, gained={self.gained:.6g}, "
            f"status={self.status.value}, {1000 * self.seconds:.0f} ms, {len(self.assignment)} agents)"
        )
