"""The one decorator through which kernels are compiled: lazily, safely cached, and not at all for small work.

``njit`` takes the options of ``numba.njit`` and gives a `Kernel`. numba is loaded when the first kernel really has to
be compiled, which small problems never ask for: a kernel that is given `small` runs its plain Python source while its
arguments hold few numbers and the process has not yet spent `PATIENCE` seconds that way. Compiled or not, it is the
same source and the same arithmetic, so the answers are the same to the last bit (tests/kernels/test_interpreted.py).

For that a kernel must not rely on integers that wrap around, nor on the order in which ``sum`` adds.
"""

from __future__ import annotations

import functools
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

PATIENCE = 0.6
"""Seconds that a process may spend in interpreted kernels: about what loading numba and a few cached kernels takes."""

SMALL = 2_000
"""Numbers in the arguments up to which most kernels are interpreted; that takes them a few milliseconds."""

KERNELS: list[Kernel] = []
"""All kernels of the modules imported so far."""


class _Here(threading.local):
    """Whether this thread is inside an interpreted kernel, whose callees are then interpreted as well."""

    interpreting = False


_here = _Here()
_spent = 0.0  # seconds in interpreted kernels so far
_always_compile = False


class Kernel:
    """A function that is compiled when it is first needed. Python calls it as the function; so do other kernels.

    Parameters
    ----------
    function : callable
        The plain function.
    small : int
        Most numbers in the arguments for which the plain function may run instead.
    options : dict
        Options of ``numba.njit``. A kernel with ``no_cpython_wrapper`` is a helper of others: Python has no way into
        the compiled one, so a call from Python (from a test) runs the plain function.
    """

    def __init__(self, function: Callable[..., Any], small: int, options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self.small = small
        self.options = options
        self.is_helper = bool(options.get("no_cpython_wrapper"))
        self._dispatcher: Any = None
        self._run: Any = None  # what calls go to once the kernel is compiled

    def __call__(self, *args: Any) -> Any:
        if self._run is not None:
            return self._run(*args)
        if _here.interpreting:
            return self.py_func(*args)
        if self.is_helper or _without_numba() or self._is_small(args):
            return self._interpret(args)
        self._run = self.dispatcher
        return self._run(*args)

    @property
    def dispatcher(self) -> Any:
        """numba's object for this function."""
        if self._dispatcher is None:
            import numba

            from sapopt.kernels import compiling

            compiling.watch()
            dispatcher = numba.njit(**self.options)(self.py_func)
            compiling.cache(dispatcher, self)
            self._dispatcher = dispatcher
        return self._dispatcher

    @property
    def targetoptions(self) -> dict[str, Any]:
        """Where numba looks whether a kernel with ``inline="always"`` is to be part of the one that calls it."""
        return self.options

    @property
    def _numba_type_(self) -> Any:
        """How other kernels see this one."""
        return self.dispatcher._numba_type_

    def __reduce__(self) -> str:
        return str(self.__qualname__)  # type: ignore[attr-defined]  # set by update_wrapper

    def __repr__(self) -> str:
        return f"<kernel {self.py_func.__module__}.{self.py_func.__qualname__}>"

    def _is_small(self, args: tuple[Any, ...]) -> bool:
        return not _always_compile and self.small > 0 and _spent < PATIENCE and _size(args) <= self.small

    def _interpret(self, args: tuple[Any, ...]) -> Any:
        global _spent
        began = time.thread_time()
        _here.interpreting = True
        try:
            with np.errstate(all="ignore"):  # infinities are numbers like others to a kernel
                return self.py_func(*args)
        finally:
            _here.interpreting = False
            _spent += time.thread_time() - began


def njit(
    function: Any = None, *, small: int = 0, borrows: bool = False, cache: bool = True, **options: Any
) -> Any:
    """Make a `Kernel` of a function; the options are those of ``numba.njit``, and `small` as in `Kernel`.

    Parameters
    ----------
    borrows : bool
        The kernel makes no array and returns none: it only works on those that it is given. Then numba leaves out
        the counting of references. Counters are atomic and shared, so threads that take views of the same arrays, or
        hand them to helpers, would wait for each other at every turn (a quarter of the time even on one thread). A
        kernel that borrows is not inlined into one that does not: helpers go with the kernel that calls them often.
    cache : bool
        Changes nothing: compiled code is always cached where a folder for it can be written.
    """
    if borrows:
        options["_nrt"] = False
    if options.get("no_cpython_wrapper"):
        # A helper never holds the lock that `nogil` lets go; without that option it shares what numba has compiled for
        # its own functions (np.empty, np.zeros, max), of which there is one copy for each set of options.
        options.pop("nogil", None)

    def decorate(function: Callable[..., Any]) -> Kernel:
        kernel = Kernel(function, small, options)
        KERNELS.append(kernel)
        return kernel

    return decorate if function is None else decorate(function)


@contextmanager
def compiled_always() -> Iterator[None]:
    """Within the block no kernel that Python calls is interpreted, however small the work."""
    global _always_compile
    before, _always_compile = _always_compile, True
    try:
        yield
    finally:
        _always_compile = before


def _without_numba() -> bool:
    """Whether compiling is switched off, for debugging or to measure coverage."""
    return os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")


def _size(args: tuple[Any, ...]) -> int:
    """Numbers in the arrays among some arguments, which may be nested in tuples."""
    total = 0
    for entry in args:
        if isinstance(entry, np.ndarray):
            total += entry.size
        elif isinstance(entry, tuple):
            total += _size(entry)
    return total
