"""Seconds of compiling, so that a run's clock can leave them out, and word of it while it takes long."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

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


def when_long(tell: Callable[[str], object]) -> None:
    """Have `tell` called with a line of text, in a thread of its own, once compiling has taken longer than a second."""
    _listeners.append(tell)


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
    text = (
        "compiling kernels; later runs find them in the cache (`sapopt warm` compiles all of them beforehand)"
    )
    log.info(text)
    for tell in _listeners:
        tell(text)
