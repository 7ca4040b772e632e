"""A clock that stands still while kernels are compiled, and word of it when compiling takes long.

Compiling happens once on a machine, whoever asks first; a time limit is about the work. So runs measure their time by
`now`, and tell apart how much went into compiling.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

log = logging.getLogger(__name__)

_LONG = 1.0
"""Seconds of compiling after which a waiting user is told, once a process."""

_lock = threading.Lock()
_depth = 0  # the compiler calls itself for what a kernel calls
_began = 0.0
_seconds = 0.0
_timer: threading.Timer | None = None
_told = False
_listeners: list[Callable[[str], object]] = []


def compile_seconds() -> float:
    """Seconds in which this process has been compiling kernels so far; those of now running compilation included."""
    with _lock:
        return _seconds + (time.perf_counter() - _began if _depth else 0.0)


def now() -> float:
    """Seconds on a clock that stands still while this process compiles kernels, in whatever thread."""
    with _lock:
        return (_began if _depth else time.perf_counter()) - _seconds


@contextmanager
def told_when_long(tell: Callable[[str], object]) -> Iterator[None]:
    """Within the block `tell` is called, in a thread of its own, with one line once compiling takes over a second."""
    _listeners.append(tell)
    try:
        yield
    finally:
        _listeners.remove(tell)


def compiler_starts(name: str) -> None:
    """The compiler begins a function."""
    global _depth, _began, _timer
    with _lock:
        _depth += 1
        if _depth > 1:
            return
        _began = time.perf_counter()
        if not _told:
            _timer = threading.Timer(max(_LONG - _seconds, 0.0), _tell)
            _timer.daemon = True
            _timer.start()
    log.debug("compiling %s", name)


def compiler_ends() -> None:
    """The compiler is done with a function."""
    global _depth, _seconds, _timer
    with _lock:
        _depth -= 1
        if _depth > 0:
            return
        _seconds += time.perf_counter() - _began
        if _timer is not None:
            _timer.cancel()
            _timer = None


def _tell() -> None:
    global _told
    with _lock:
        if _told:
            return
        _told = True
    text = "compiling kernels; later runs find them in the cache (`sapopt warm` compiles all of them at once)"
    log.info(text)
    for tell in list(_listeners):
        tell(text)
