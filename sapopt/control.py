"""The controls of one run: clock, seed, progress, interruption, warm start."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sapopt.types import IntArray


@dataclass(frozen=True)
class Progress:
    """What a running solver reports.

    Attributes
    ----------
    done, total : float
        Work done and in all (steps of a policy, seconds or iterations of a planner); `total` 0 where unknown.
    seconds : float
        Time since the start.
    value : float or None
        Value so far (policy) or of the incumbent (planner).
    bound : float or None
        Best proven upper bound.
    message : str
        Phase of the work.
    """

    done: float
    total: float
    seconds: float
    value: float | None = None
    bound: float | None = None
    message: str = ""

    @property
    def gap(self) -> float | None:
        """``(bound - value) / |bound|``, or None."""
        if self.value is None or not self.bound:
            return None
        return (self.bound - self.value) / abs(self.bound)


Callback = Callable[[Progress], bool | None]
"""Called with every report; returning True stops the run, which then returns its incumbent."""


@dataclass
class Run:
    """State of one run, handed to the solver. The clock starts when it is made.

    Parameters
    ----------
    seed : int
    time_limit : float or None
        Seconds.
    callback : callable or None
    start : ndarray or None, shape (T, n)
        Plan to start from.
    """

    seed: int = 0
    time_limit: float | None = None
    callback: Callback | None = None
    start: IntArray | None = None
    rng: np.random.Generator = field(init=False)
    began: float = field(init=False)
    stopped: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Time since the start."""
        return time.perf_counter() - self.began

    @property
    def seconds_left(self) -> float:
        """Time until the limit, infinite without one."""
        return np.inf if self.time_limit is None else self.time_limit - self.seconds

    @property
    def expired(self) -> bool:
        """Whether the time is up or the callback asked to stop."""
        return self.stopped or self.seconds_left <= 0

    def report(
        self,
        done: float,
        total: float,
        value: float | None = None,
        bound: float | None = None,
        message: str = "",
    ) -> bool:
        """Tell the callback; return whether the run should stop."""
        if self.callback is not None and self.callback(
            Progress(done, total, self.seconds, value, bound, message)
        ):
            self.stopped = True
        return self.expired
