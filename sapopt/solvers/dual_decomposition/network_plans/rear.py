"""What lies behind the front of rolling windows, improved on another core while the front goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from types import TracebackType

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.rounds import GOLDEN
from sapopt.solvers.dual_decomposition.network_plans.window_search import EFFORTS, improve_window

_EFFORT = EFFORTS[0]


@dataclass(eq=False)
class Rear:
    """A thread that goes over the steps before the front, window by window, as long as it is entered.

    A window ends where the plan is kept, and the last step before the front is in none of them, so that the front may
    go on from it meanwhile.

    Attributes
    ----------
    arrays : Arrays
    prices : (T, m)
        Prices of the cells.
    rng : numpy.random.Generator
        Its own.
    seconds_left : callable
        A window is not begun, and given up, when there are none.
    """

    arrays: Arrays
    prices: FloatArray
    rng: np.random.Generator
    seconds_left: Callable[[], float]
    _plan: IntArray = field(init=False)
    _front: int = 0
    _next: int = 0
    _rounds: int = 0
    _over: bool = False
    _changed: threading.Condition = field(default_factory=threading.Condition)
    _pool: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1))
    _job: Future[None] = field(init=False)

    def __enter__(self) -> Rear:
        self._job = self._pool.submit(self._work)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._over = True
            self._changed.notify()
        self._pool.shutdown()
        if error is None:
            self._job.result()  # raises what it ended with

    def joined(self, plan: IntArray, front: int) -> IntArray:
        """``plan`` (T, n) with what was improved of it; its steps before ``front`` may be improved from now on."""
        with self._changed:
            if self._front > 0:
                plan = plan.copy()
                plan[: self._front] = self._plan[: self._front]
            self._plan, self._front = plan, front
            self._changed.notify()
            return plan

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._over and self._front - 1 < _EFFORT.length:
                    self._changed.wait()
                if self._over or self.seconds_left() <= 0.0:
                    return
                plan, (first, last) = self._plan, self._window()
            seed = int(self.rng.integers(2**63))
            better = improve_window(
                self.arrays, plan, self.prices, _EFFORT, first, last, seed, self._seconds_left
            )
            with self._changed:
                self._plan = self._plan.copy()
                self._plan[first:last] = better[first:last]

    def _window(self) -> tuple[int, int]:
        """The next window before the front; each round begins elsewhere."""
        if self._next + _EFFORT.length > self._front - 1:
            self._rounds += 1
            self._next = int(self._rounds * GOLDEN % 1.0 * min(_EFFORT.length, self._front - _EFFORT.length))
        self._next += _EFFORT.length
        return self._next - _EFFORT.length, self._next

    def _seconds_left(self) -> float:
        return 0.0 if self._over else self.seconds_left()
