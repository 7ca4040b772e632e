"""Work that has to be over at a given time, whatever it does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from sapopt.running.control import Expired

T = TypeVar("T")


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
