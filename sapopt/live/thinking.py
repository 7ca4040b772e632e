"""Work that has to be over at a given time, whatever it does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from sapopt.running.control import Expired

T = TypeVar("T")

_FIRST_REST = 0.25
"""Share of the budget that is left for what follows the policy, until it is known how long that takes."""
_MOST_REST = 0.6
_SAFETY = 1.3
_FORGETTING = 0.8
"""What is left, from call to call, of a time that was longer than the last."""
_LONGEST_PAUSE = 31
OVERHEAD_S = 0.004
"""Time for waking up, and for the answer itself."""


class Thought(Generic[T]):
    """Work in a thread of its own, which nobody has to wait for.

    Parameters
    ----------
    work : callable
        ``work(check)``; it calls `check` now and then and lets the exception that this may raise pass.
    """

    def __init__(self, work: Callable[[Callable[[], None]], T]) -> None:
        self._work = work
        self._told_to_stop = False
        self._result: T | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="sapopt session", daemon=True)
        self._thread.start()

    def _check(self) -> None:
        if self._told_to_stop:
            raise Expired

    def _run(self) -> None:
        try:
            self._result = self._work(self._check)
        except Expired:
            pass
        except BaseException as error:  # raised again where the answer is asked for
            self._error = error

    @property
    def is_over(self) -> bool:
        """Whether the work has come to its end."""
        return not self._thread.is_alive()

    def answer(self, until: float) -> T | None:
        """What the work has given by a time of `time.perf_counter`; None if nothing, and it is told to stop then.

        Raises
        ------
        BaseException
            What the work raised.
        """
        # the exact time left: a thread may wait for no time at all, but not for ever
        self._thread.join(min(max(until - time.perf_counter(), 0.0), threading.TIMEOUT_MAX))
        if not self.is_over:
            self._told_to_stop = True
            return None
        if self._error is not None:
            raise self._error
        return self._result


@dataclass
class Pace:
    """What a session knows of the machine it runs on, and what may still be going on there; no part of what it carries.

    Attributes
    ----------
    rest : float or None
        Seconds that lately went by between the policy's answer and that of the session.
    answered : float or None
        When the policy answered, within a call.
    missed, pause : int
        How often in a row the policy had no answer, and for how many calls it is not asked again: what was told to stop
        may go on for a while and takes the processor from those that follow.
    thought, proof : Thought or None
        The last work that was not waited for.
    """

    rest: float | None = None
    answered: float | None = None
    missed: int = 0
    pause: int = 0
    thought: Thought[Any] | None = None
    proof: Thought[Any] | None = None

    def times(self, began: float, budget: float | None) -> Times:
        """When the parts of a decision are due."""
        if budget is None:
            return Times(np.inf, np.inf)
        rest = _FIRST_REST * budget if self.rest is None else _SAFETY * self.rest
        return Times(began + budget, began + budget - min(rest + OVERHEAD_S, _MOST_REST * budget))

    def may_think(self) -> bool:
        """Whether to ask the policy at this call."""
        if self.pause:
            self.pause -= 1
            return False
        return self.thought is None or self.thought.is_over

    def heard(self, answered: bool) -> None:
        """The policy had an answer in time, or none."""
        self.answered = time.perf_counter()
        self.missed = 0 if answered else self.missed + 1
        self.pause = min(2**self.missed - 1, _LONGEST_PAUSE) if self.missed > 1 else 0

    def done(self) -> None:
        """A decision with a budget is made: learn from it."""
        if self.answered is not None:
            rest = time.perf_counter() - self.answered
            self.rest = rest if self.rest is None else max(rest, _FORGETTING * self.rest)
            self.answered = None


@dataclass(frozen=True)
class Times:
    """When a decision is due, on `time.perf_counter`; `think_until` leaves time for what follows the policy."""

    due: float
    think_until: float

    @property
    def left(self) -> float:
        """Seconds until the answer is due."""
        return self.due - OVERHEAD_S - time.perf_counter()

    def has_time(self, seconds: float = 0.0) -> bool:
        """Whether there is time for something that takes so long."""
        return self.left > seconds
