"""Compile side by side: processes that warm up one half of the solvers while this one warms up the other."""

from __future__ import annotations

import logging
import multiprocessing
import signal
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from sapopt import warming
from sapopt.kernels.blocks import thread_count
from sapopt.kernels.clock import compile_seconds
from sapopt.problem.sap import SAP

log = logging.getLogger(__name__)

Job = tuple[str, warming.Part]
"""A name for the user, and what is warmed up."""

_COLD = 0.2
"""Seconds of compiling after which the cache counts as empty: as long as a small kernel takes."""
_PAUSE = 0.05


class Helpers:
    """The processes of a command that compile along; a context manager, at whose end all of them are gone.

    One is called up as soon as this process compiles anything, say to build the problem: it takes a while to start, and
    is there when there is work.
    """

    def __init__(self) -> None:
        self._given = threading.Event()  # there is work
        self._finished = threading.Event()
        self._common = threading.Event()  # what the methods have in common is compiled
        self._problem: SAP | None = None
        self._todo: deque[Job] = deque()
        self._processes: list[tuple[SpawnProcess, Connection]] = []
        self._watcher = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Helpers:
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._finished.set()
        self._given.set()
        self._common.set()
        self._terminate()  # whoever waits for a job that a process has taken hears of it
        self._watcher.join()
        self._dismiss()

    @contextmanager
    def helped(self, problem: SAP, todo: deque[Job]) -> Iterator[threading.Event]:
        """Within the block, once this process has compiled anything, others take jobs from the end of `todo`.

        They leave compiled code in the cache. The block gets an event: it sets it when the kernels that all methods
        share are compiled, and only then do the others go beyond their first job. A job that they have taken is done at
        the end of the block, or not at all if a process fails: then whoever needs the code compiles it, as without
        help. There is one such block.
        """
        self._problem, self._todo = problem, todo
        self._given.set()
        try:
            yield self._common
        except BaseException:
            todo.clear()  # nothing more is begun, nor waited for
            raise
        self._finished.set()
        self._common.set()
        self._watcher.join()
        self._dismiss()

    def _terminate(self) -> None:
        for process, _ in self._processes:
            process.terminate()

    def _dismiss(self) -> None:
        self._terminate()
        for process, end in self._processes:
            process.join()
            end.close()
        self._processes = []

    def _watch(self) -> None:
        """Wait until this process has compiled for a while and there is work, and hand it out until all is done."""
        begun = compile_seconds()
        while compile_seconds() - begun < _COLD:
            if self._finished.wait(_PAUSE):
                return
        if thread_count() < 2 or not self._call_up():
            return
        self._given.wait()
        while len(self._processes) < min(thread_count() - 1, len(self._todo)) and self._call_up():
            pass
        threads = [
            threading.Thread(target=self._hand_out, args=(end,), daemon=True) for _, end in self._processes
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def _call_up(self) -> bool:
        """Start a process; False if there is none to be had."""
        # spawn: children of this process's own interpreter, whatever threads it may have
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there,), daemon=True)
        try:
            process.start()
        except Exception as error:
            log.info("kernels are compiled without help: %s", error)
            return False
        there.close()
        self._processes.append((process, here))
        return True

    def _hand_out(self, end: Connection) -> None:
        """Give one job after another to a process.

        All methods have the assignment kernel in common, which this process is about to compile; the bound has not.
        """
        try:
            end.send(self._problem)
        except Exception as error:  # a problem that cannot be sent, or the process has ended
            log.info("kernels are compiled without help: %s", error)
            return
        for turn in count():
            if turn > 0:
                self._common.wait()
            try:
                job = self._todo.pop()
            except IndexError:
                return
            try:
                end.send(job)
                end.recv()
            except (EOFError, OSError) as error:
                log.info("a process that compiled kernels has ended: %s", error or type(error).__name__)
                return


def _work(end: Connection) -> None:
    """Warm up for one job after another on the problem that comes first, in a process of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    logging.getLogger("sapopt").setLevel(logging.ERROR)
    try:
        problem = end.recv()
        while True:
            _, solver = end.recv()
            warming.warm_up(problem, solver)
            end.send(None)
    except (EOFError, OSError):
        return
