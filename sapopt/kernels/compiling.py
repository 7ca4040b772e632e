"""What surrounds numba's compiler: a cache that no read-only folder or damaged file can break, and a clock.

Importing this module loads numba; `sapopt.kernels.jit` does so when the first kernel is compiled.
"""

from __future__ import annotations

import gc
import hashlib
import inspect
import logging
import pickle
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile

from sapopt.kernels import clock
from sapopt.kernels.jit import Kernel

log = logging.getLogger(__name__)

_DIGEST = hashlib.sha256().digest_size


class _Files(IndexDataCacheFile):  # type: ignore[misc]  # numba is untyped
    """Cache files of which every one with compiled code begins with a digest of the rest."""

    def load(self, key: Any) -> Any:
        """The entry of a key; None, and no more files, if one is cut or damaged."""
        try:
            return super().load(key)
        except Exception as error:  # pickle raises what it likes on a damaged file
            log.warning("numba cache: threw away %s (%s)", self._index_path, error or type(error).__name__)
            self._discard()
            return None

    def save(self, key: Any, data: Any) -> None:
        """Keep an entry, unless the folder cannot take it."""
        try:
            super().save(key, data)
        except OSError as error:
            log.info("numba cache: %s", error)
        except Exception as error:  # saving reads the index first, which may be damaged
            log.warning("numba cache: threw away %s (%s)", self._index_path, error or type(error).__name__)
            self._discard()
            super().save(key, data)

    def _discard(self) -> None:
        try:
            Path(self._index_path).unlink(missing_ok=True)
        except OSError as error:
            log.info("numba cache: %s", error)

    def _save_data(self, name: str, data: Any) -> None:
        code = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(hashlib.sha256(code).digest() + code)

    def _load_data(self, name: str) -> Any:
        content = Path(self._data_path(name)).read_bytes()
        digest, code = content[:_DIGEST], content[_DIGEST:]
        if hashlib.sha256(code).digest() != digest:
            raise ValueError(f"{name} is damaged")
        return pickle.loads(code)


class _Cache(FunctionCache):  # type: ignore[misc]  # numba is untyped
    """numba's cache of one function, with `_Files`; stale as soon as any kernel that the function calls has changed."""

    def __init__(self, kernel: Kernel) -> None:
        super().__init__(kernel.py_func)
        files = sorted({inspect.getfile(reached.py_func) for reached in _reached(kernel, set())})
        sources = hashlib.sha256()
        for file in files:
            sources.update(Path(file).read_bytes())
        self._cache_file = _Files(self._cache_path, self._impl.filename_base, sources.hexdigest())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Compiled code from the cache, None where there is none that can be used."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:
            log.warning("numba cache: %s cannot be used (%s)", self, error)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep compiled code, unless the folder has gone or cannot be written."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            log.info("numba cache: %s", error)


def _reached(kernel: Kernel, seen: set[Kernel]) -> set[Kernel]:
    """A kernel and all that it calls."""
    if kernel not in seen:
        seen.add(kernel)
        for callee in _callees(kernel):
            _reached(callee, seen)
    return seen


def _callees(kernel: Kernel) -> Iterator[Kernel]:
    code, names = kernel.py_func.__code__, kernel.py_func.__globals__
    for name in code.co_names:
        value = names.get(name)
        if isinstance(value, Kernel):
            yield value
        elif inspect.ismodule(value):  # called as module.kernel
            yield from (
                v for v in (getattr(value, other, None) for other in code.co_names) if isinstance(v, Kernel)
            )


def cache(dispatcher: Any, kernel: Kernel) -> None:
    """Let compiled code be kept from run to run where that is possible."""
    try:
        dispatcher._cache = _Cache(kernel)
    except (RuntimeError, OSError) as error:  # numba: "no locator available"
        log.info(
            "%r is compiled anew in every process: no folder for the cache can be written (%s)", kernel, error
        )


class _Listener(event.Listener):  # type: ignore[misc]  # numba is untyped
    """Tells the clock when the compiler starts and stops; what it compiles on the way is part of the outermost.

    Meanwhile no garbage is collected: of the objects that the compiler makes by the million nearly all stay until it is
    done, and walking through them again and again takes a seventh of its time.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._depth = 0
        self._collects = False

    def on_start(self, event: Any) -> None:
        with self._lock:
            if self._depth == 0:
                self._collects = gc.isenabled()
                gc.disable()
            self._depth += 1
        clock.compiler_starts(str(event.data["dispatcher"].py_func.__name__))

    def on_end(self, event: Any) -> None:
        clock.compiler_ends()
        with self._lock:
            self._depth -= 1
            if self._depth == 0 and self._collects:
                gc.enable()


_watching = False


def watch() -> None:
    """Have the clock count the seconds of compiling from now on."""
    global _watching
    if not _watching:
        _watching = True
        event.register("numba:compile", _Listener())
