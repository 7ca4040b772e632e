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


@contextmanager
def helped(problem: SAP, todo: deque[Job]) -> Iterator[threading.Event]:
    """Within the block, once this process compiles, others take jobs from the end of `todo`.

    They leave compiled code in the cache. The block gets an event: it sets it when the kernels that all methods share
    are compiled, and only then do the others go beyond their first job. A job that they have taken is done at the end
    of the block, or not at all if a process fails: then whoever needs the code compiles it, as without help.
    """
    helpers = _Helpers(problem, todo)
    starter = threading.Thread(target=helpers.start_when_cold, daemon=True)
    starter.start()
    try:
        yield helpers.common
        helpers.finished.set()
        helpers.common.set()
        starter.join()
        for thread in helpers.threads:
            thread.join()
    finally:
        helpers.finished.set()
        helpers.common.set()
        starter.join()
        for process in helpers.processes:
            process.terminate()
            process.join()
        for end in helpers.ends:
            end.close()


class _Helpers:
    def __init__(self, problem: SAP, todo: deque[Job]) -> None:
        self.problem = problem
        self.todo = todo
        self.finished = threading.Event()
        self.common = threading.Event()  # what the methods have in common is compiled
        self.processes: list[SpawnProcess] = []
        self.threads: list[threading.Thread] = []
        self.ends: list[Connection] = []

    def start_when_cold(self) -> None:
        """Wait until this process has compiled for a while, and start the others."""
        begun = compile_seconds()
        while compile_seconds() - begun < _COLD:
            if self.finished.wait(_PAUSE):
                return
        # spawn: children of this process's own interpreter, whatever threads it may have
        context = multiprocessing.get_context("spawn")
        for _ in range(min(thread_count() - 1, len(self.todo))):
            here, there = context.Pipe()
            process = context.Process(target=_work, args=(there, self.problem), daemon=True)
            try:
                process.start()
            except Exception as error:  # no process to be had, or a problem that cannot be sent to one
                log.info("kernels are compiled without help: %s", error)
                return
            there.close()
            thread = threading.Thread(target=self._hand_out, args=(here,), daemon=True)
            thread.start()
            self.ends.append(here)
            self.processes.append(process)
            self.threads.append(thread)

    def _hand_out(self, end: Connection) -> None:
        """Give one job after another to a process.

        All methods have the assignment kernel in common, which this process is about to compile; the bound has not.
        """
        for turn in count():
            if turn > 0:
                self.common.wait()
            try:
                job = self.todo.pop()
            except IndexError:
                return
            try:
                end.send(job)
                end.recv()
            except (EOFError, OSError) as error:
                log.info("a process that compiled kernels has ended: %s", error or type(error).__name__)
                return


def _work(end: Connection, problem: SAP) -> None:
    """Warm up for one job after another, in a process of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    logging.getLogger("sapopt").setLevel(logging.ERROR)
    while True:
        try:
            _, solver = end.recv()
        except (EOFError, OSError):
            return
        warming.warm_up(problem, solver)
        end.send(None)
