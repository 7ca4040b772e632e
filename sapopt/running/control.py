"""The controls of one run: clock, seed, progress, interruption, warm start."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType

import numpy as np

from sapopt.data.types import IntArray
from sapopt.kernels import clock


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


class Expired(Exception):
    """The run is over in the middle of a step; `sapopt.running.rollout.rollout` turns it into the incumbent."""


@dataclass
class Run:
    """State of one run, handed to the solver. The clock starts when it is made, and stands while kernels are compiled.

    Parameters
    ----------
    seed : int
    time_limit : float or None
        Seconds.
    callback : callable or None
    start : ndarray or None, shape (T, n)
        Plan to start from.
    parent : Run or None
        The run that this one is a part of: when that one is stopped, so is this.
    """

    seed: int = 0
    time_limit: float | None = None
    callback: Callback | None = None
    start: IntArray | None = None
    parent: Run | None = None
    rng: np.random.Generator = field(init=False)
    began: float = field(init=False)
    _compiled: float = field(init=False, repr=False)
    stopped: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.began = clock.now()
        self._compiled = clock.compile_seconds()

    @property
    def seconds(self) -> float:
        """Time since the start, without that of compiling kernels."""
        return clock.now() - self.began

    @property
    def compile_seconds(self) -> float:
        """Seconds of compiling since the start, which count neither in `seconds` nor against the limit."""
        return clock.compile_seconds() - self._compiled

    @property
    def seconds_left(self) -> float:
        """Time until the limit, infinite without one."""
        return np.inf if self.time_limit is None else self.time_limit - self.seconds

    @property
    def expired(self) -> bool:
        """Whether the time is up or the callback asked to stop."""
        if self.parent is not None and self.parent.expired:
            self.stopped = self.stopped or self.parent.stopped
            return True
        return self.stopped or self.seconds_left <= 0

    def check(self) -> None:
        """Raise `Expired` if the run is over."""
        if self.expired:
            raise Expired

    def part(self, seconds: float = np.inf) -> Run:
        """A run of at most `seconds` inside this one, which ends with it."""
        left = min(seconds, self.seconds_left)
        return Run(self.seed, None if np.isinf(left) else max(left, 0.0), parent=self)

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


@contextmanager
def interruptible(run: Run, announce: Callable[[], None] | None = None) -> Iterator[None]:
    """Within the block the first Ctrl-C stops the run, which then ends with its incumbent; the second one interrupts.

    The only handler of Ctrl-C in this library. Blocks may be nested: all their runs are stopped. `announce` is called
    when a run is stopped so.

    A KeyboardInterrupt raised in the middle of a compiled kernel would come out of it as a SystemError, no solver would
    recognise it, and what was found so far would be lost. So the first one is no exception at all. A handler that
    somebody else has installed is called too, instead of the interruption. Signals belong to the main thread: in any
    other the block changes nothing.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    own = before is signal.default_int_handler

    def ask(number: int, frame: FrameType | None) -> None:
        second, run.stopped = run.stopped, True
        if announce is not None and not second:
            announce()
        if second or not own:
            before(number, frame)

    signal.signal(signal.SIGINT, ask)
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)
