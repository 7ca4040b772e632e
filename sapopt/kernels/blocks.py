"""Compiled loops in blocks, which the threads of this process share out among themselves.

A kernel that visits agents (steps, tasks) one by one takes the begin and the end of a block as its first two
arguments, is compiled with ``nogil=True``, and writes to arrays that it is given. The functions here cut the whole
range into blocks; the calling thread and a few helpers take one block after another until none is left. This is the
only place that knows how many threads there are.

Plain threads instead of numba's ``parallel=True``: no OpenMP runtime is loaded, so a process may fork after a solve,
many threads may solve at once, and nobody spins while waiting. The caller works itself and takes back what no helper
has begun, so it never waits for a queue: helpers that are busy with other callers, or that cannot be had any more
(an interpreter that shuts down starts no threads), cost speed alone.
"""

from __future__ import annotations

import math
import os
import threading
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

OWN_VARIABLE = "SAPOPT_NUM_THREADS"
"""Environment variable that says how many threads share the work; without it numba's own, NUMBA_NUM_THREADS, counts."""

_WORTH = 30_000
"""Inner turns of a loop, a nanosecond or a few each, below which asking another thread (10 to 20 us) does not pay."""
_BLOCKS_PER_THREAD, _LEAST_BLOCK = 4, 40_000
"""More blocks than threads even out the agents' different numbers of tasks; fewer turns are not worth a call."""
_PARTS, _LEAST_PART, _PART_TURNS = 8, 32, 40_000
"""Most partial sums, and the least of agents and turns for each: adding up arrays costs more than the threads save."""

_APART = 128
"""Bytes between the work arrays of two threads: two lines of a cache, as processors fetch them in pairs."""


def thread_count() -> int:
    """How many threads share the work: as the environment says, else the processors that this process may use.

    Raises
    ------
    ValueError
        If SAPOPT_NUM_THREADS is not a positive whole number.
    """
    own = os.environ.get(OWN_VARIABLE)
    if own is not None:
        if not own.isdecimal() or int(own) < 1:
            raise ValueError(f"{OWN_VARIABLE}: expected a positive whole number, got {own!r}")
        return int(own)
    numbas = os.environ.get("NUMBA_NUM_THREADS", "")
    if numbas.isdecimal() and int(numbas) > 0:
        return int(numbas)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_blocks(
    kernel: Callable[..., object],
    count: int,
    *arguments: object,
    scratch: Callable[[], tuple[object, ...]] = tuple,
    turns: float,
) -> None:
    """Call ``kernel(begin, end, *arguments, *scratch())`` for blocks that cover ``range(count)``.

    Parameters
    ----------
    kernel : callable
        Compiled with ``nogil=True``. The items of the range must not depend on each other: what is written must not
        depend on the blocks.
    count : int
        Agents, or whatever the kernel visits.
    arguments
        Shared by all blocks.
    scratch : callable, optional
        Makes the work arrays of one thread, which it uses for one block after another.
    turns : float
        Inner turns of the whole loop, roughly; little work stays on this thread.
    """
    helpers = _helpers(count, turns)
    if helpers == 0:
        kernel(0, count, *arguments, *scratch())
        return
    threads = helpers + 1
    todo = _blocks(count, max(threads, int(min(_BLOCKS_PER_THREAD * threads, turns / _LEAST_BLOCK))))

    def work() -> None:
        own = scratch()
        for _, begin, end in _taken(todo):
            kernel(begin, end, *arguments, *own)

    _together(work, helpers, todo)


def summed_in_blocks(
    kernel: Callable[..., object],
    count: int,
    shapes: tuple[tuple[int, ...], ...],
    *arguments: object,
    scratch: Callable[[], tuple[object, ...]] = tuple,
    turns: float,
) -> list[NDArray[np.float64]]:
    """Call ``kernel(begin, end, *arguments, *scratch(), *sums)`` for blocks; return the sums over all items.

    Every block adds to arrays of its own, and these are added in the order of the blocks. The blocks depend on
    `count` and `turns` alone, so the result is the same bit for bit, however many threads there are.

    Parameters
    ----------
    shapes : tuple of shapes
        Of the sums, which a kernel finds filled with zeros.
    """
    todo = _blocks(count, int(min(_PARTS, count // _LEAST_PART, turns / _PART_TURNS)))
    helpers = min(_helpers(count, turns), len(todo) - 1)
    sums: list[list[NDArray[np.float64]]] = [[] for _ in todo]

    def work() -> None:
        own = scratch()
        for part, begin, end in _taken(todo):
            sums[part] = [work_array(shape, fill=0.0) for shape in shapes]
            kernel(begin, end, *arguments, *own, *sums[part])

    _together(work, helpers, todo)
    for others in sums[1:]:
        for total, addend in zip(sums[0], others, strict=True):
            total += addend
    return sums[0]


def work_array(
    shape: int | tuple[int, ...], dtype: Any = np.float64, fill: float | None = None
) -> NDArray[Any]:
    """Work array of one thread (`scratch` above), at a distance from whatever lies beside it in memory.

    Two threads that write to the same line of the processors' caches, each to an array of its own, wait for each other
    at every write; small arrays that are made one after another do lie on the same line.
    """
    size = math.prod(shape) if isinstance(shape, tuple) else shape
    apart = _APART // np.dtype(dtype).itemsize
    array = np.empty(size + 2 * apart, dtype=dtype)[apart : apart + size].reshape(shape)
    if fill is not None:
        array.fill(fill)
    return array


Blocks = deque[tuple[int, int, int]]


def _blocks(count: int, wanted: int) -> Blocks:
    """At most `wanted` blocks of nearly equal size: (number, first, last + 1) each."""
    wanted = max(1, min(wanted, count))
    edges = [number * count // wanted for number in range(wanted + 1)]
    return deque((number, begin, end) for number, (begin, end) in enumerate(pairwise(edges)))


def _taken(todo: Blocks) -> Any:
    """Blocks that no other thread has taken, until none is left."""
    while True:
        try:
            yield todo.popleft()
        except IndexError:
            return


def _helpers(count: int, turns: float) -> int:
    return min(thread_count(), count) - 1 if turns >= _WORTH else 0


def _together(work: Callable[[], None], helpers: int, todo: Blocks) -> None:
    """Do the work on this thread and on helpers as far as there are any; what one of them raises is raised."""
    asked: list[_Errand] = []
    try:
        for _ in range(helpers):
            errand = _ask(work)
            if errand is None:
                break
            asked.append(errand)
        work()
    finally:
        todo.clear()  # after an error or an interruption the helpers stop at the end of their block
        for errand in asked:
            errand.end()


class _Errand:
    """Work that a helper is asked to join. Whoever gets hold of `begun` first, helper or caller, decides about it."""

    __slots__ = ("begun", "done", "error", "work")

    def __init__(self, work: Callable[[], None]) -> None:
        self.work = work
        self.begun = threading.Lock()
        self.done = threading.Lock()
        self.done.acquire()
        self.error: BaseException | None = None

    def run(self) -> None:
        """Join the work, unless it has been taken back."""
        if self.begun.acquire(blocking=False):
            try:
                self.work()
            except BaseException as error:  # the caller raises it
                self.error = error
            finally:
                self.done.release()

    def end(self) -> None:
        """Take the work back, or wait for a helper that has begun, and raise what it met with."""
        if self.begun.acquire(blocking=False):
            return
        self.done.acquire()
        if self.error is not None:
            raise self.error


class _Pool:
    """The helpers of this process: threads that are started when they are first asked for.

    A ThreadPoolExecutor does the same, but its futures and semaphores cost 20 to 30 us more at every call, and the
    price ascent makes a call every 300 us.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self.lock = threading.Lock()
        self.helpers = 0
        self.errands: SimpleQueue[_Errand] = SimpleQueue()


_pool = _Pool()


def _ask(work: Callable[[], None]) -> _Errand | None:
    """Ask a helper to join the work; None where there are none and will be none any more."""
    if _pool.helpers == 0 or _pool.helpers < thread_count() - 1:
        with _pool.lock:
            try:
                while _pool.helpers < max(1, thread_count() - 1):
                    threading.Thread(target=_help, args=(_pool.errands,), name="sapopt", daemon=True).start()
                    _pool.helpers += 1
            except RuntimeError:  # the interpreter is shutting down, or the system has no more threads
                if _pool.helpers == 0:
                    return None
    errand = _Errand(work)
    _pool.errands.put(errand)
    return errand


def _help(errands: SimpleQueue[_Errand]) -> None:
    """The life of a helper: one errand after another."""
    while True:
        errands.get().run()  # bound to no name, so that nothing of an errand is kept until the next one


if hasattr(os, "register_at_fork"):
    # A child has none of its parent's threads, and a lock that another thread held would stay locked for ever.
    os.register_at_fork(after_in_child=_pool.forget)
