"""Run jobs over processes or a cluster; what is finished is on disk at once, and never done again.

joblib hands out the jobs: to processes of this machine, or with `cluster` to a Dask cluster, which gives the jobs of a
worker that dies to another one. A job's file is written where the job ran, if that machine sees the folder, so that a
job that is finished stays so even if its worker dies the moment after; and else by this process, when the result is
here. So the machines of a cluster need no common file system, but gain a little by it.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
import socket
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

from sapopt.data.files import write_text

log = logging.getLogger(__name__)

_ABANDONED_SECONDS = (
    24 * 3600.0
)  # a part of a file that has not grown for so long was left by a killed process
_ATTEMPTS = 3
"""Times in a row that workers may die without a single job finishing."""

_INSTALL = "sweeps need joblib and, for a cluster, dask.distributed: pip install 'sapopt[distributed]'"


@dataclass(frozen=True)
class Job:
    """One piece of work.

    Attributes
    ----------
    label : str
        For people: in progress, tables and file names.
    spec : mapping
        All that the work depends on, as plain JSON values; two jobs are the same if these are.
    """

    label: str
    spec: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Name of the job's file, without its suffix: the label and a fingerprint of the specification."""
        text = json.dumps(self.spec, sort_keys=True, allow_nan=False)
        readable = re.sub(r"[^A-Za-z0-9.+]+", "-", self.label).strip("-")[:80]
        return f"{readable}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


@dataclass(frozen=True)
class Finished:
    """What a job left behind.

    Attributes
    ----------
    job : Job
    record : dict or None
        What the function returned; None if it failed.
    error : str or None
        Why it failed: the exception in one line.
    seconds : float
        Time the job took where it ran.
    fresh : bool
        False if an earlier run had finished it.
    """

    job: Job
    record: dict[str, Any] | None
    error: str | None
    seconds: float
    fresh: bool = True


def run_jobs(
    function: Callable[[dict[str, Any]], dict[str, Any]],
    jobs: Sequence[Job],
    folder: str | Path,
    *,
    cluster: str | None = None,
    workers: int | None = None,
    on_finished: Callable[[Finished], None] | None = None,
) -> list[Finished]:
    """Run the jobs that `folder` does not hold yet.

    Parameters
    ----------
    function : callable
        ``function(spec) -> record``, both of plain JSON values; must be importable where the workers are.
    jobs : sequence of Job
        No two of the same key.
    folder : path
        Gets one file ``KEY.json`` for every job that succeeded, as soon as it has, whole or not at all. Jobs whose file
        is there are not done again; failed ones are. A damaged file, or one of another job, is set aside as
        ``KEY.damaged`` and its job done again.
    cluster : str, optional
        Address of a Dask scheduler such as ``tcp://host:8786``; processes of this machine by default.
    workers : int, optional
        Processes, without a cluster; as many as there are cores by default.
    on_finished : callable, optional
        Called with every job that is finished, in this process, those of an earlier run first. An exception from it
        ends the sweep; what has landed stays.

    Returns
    -------
    list of Finished
        In the order of `jobs`.

    Raises
    ------
    ValueError
        If two jobs are the same, the folder cannot be used, or the cluster does not answer.
    RuntimeError
        If workers die again and again and no job finishes.
    ImportError
        Without joblib, or with `cluster` without dask.distributed.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers must be a whole number of at least 1, got {workers!r}")
    folder = _usable(Path(folder).absolute())
    by_key = {job.key: job for job in jobs}
    if len(by_key) < len(jobs):
        twice = next(job for at, job in enumerate(jobs) if job.key in {other.key for other in jobs[:at]})
        raise ValueError(f"jobs: {twice.label!r} is listed twice")
    done: dict[str, Finished] = {}

    def take(finished: Finished) -> None:
        done[finished.job.key] = finished
        if on_finished is not None:
            on_finished(finished)

    for job in jobs:
        known = _known(folder, job)
        if known is not None:
            take(known)
    with _mark(folder) as mark, _backend(cluster, workers, mark) as parallel:
        fruitless = 0
        while len(done) < len(jobs):
            before = len(done)
            todo = [job for job in jobs if job.key not in done]
            try:
                for key, record, error, seconds in parallel(function, todo):
                    if record is not None and not (folder / f"{key}.json").exists():
                        _write(folder, by_key[key], record, seconds)
                    take(Finished(by_key[key], record, error, seconds))
            except _deaths() as death:
                fruitless = fruitless + 1 if len(done) == before else 0
                if fruitless == _ATTEMPTS:
                    left = len(jobs) - len(done)
                    raise RuntimeError(
                        f"workers keep dying and {left} jobs are left, the first of them {todo[0].label!r}; "
                        f"they may need more memory or fewer workers ({type(death).__name__})"
                    ) from death
                log.warning("a worker died (%s); its jobs are tried again", type(death).__name__)
    return [done[job.key] for job in jobs]


def _usable(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"folder {folder}: {error.strerror or error}") from None
    if not os.access(folder, os.W_OK):
        raise ValueError(f"folder {folder}: no permission to write there")
    return folder


def _known(folder: Path, job: Job) -> Finished | None:
    """What an earlier run left of a job; None if there is nothing, or nothing readable, which is set aside."""
    path = folder / f"{job.key}.json"
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        if held["job"] != json.loads(json.dumps(job.spec)):
            raise ValueError("it holds another job")
        return Finished(job, dict(held["record"]), None, float(held["seconds"]), fresh=False)
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        aside = path.with_suffix(".damaged")
        log.warning("%s is damaged; it is set aside as %s, and the job is done again", path, aside.name)
        with suppress(FileNotFoundError):  # another worker was first
            path.replace(aside)
        return None


@contextmanager
def _mark(folder: Path) -> Iterator[Path]:
    """A file by which workers know that they see the very folder of this sweep."""
    _tidy(folder)
    path = folder / f".sweep-{uuid4().hex}"
    write_text(path, json.dumps({"host": socket.gethostname(), "pid": os.getpid()}))
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


def _tidy(folder: Path) -> None:
    """Remove the marks of sweeps on this machine whose process is no more, and parts of files that nobody writes."""
    for mark in folder.glob(".sweep-*"):
        with suppress(OSError, ValueError, KeyError, TypeError):
            owner = json.loads(mark.read_text(encoding="utf-8"))
            if owner["host"] == socket.gethostname() and not _is_alive(int(owner["pid"])):
                mark.unlink()
    for part in folder.glob(".sapopt-*.part"):
        with suppress(OSError):
            if time.time() - part.stat().st_mtime > _ABANDONED_SECONDS:
                part.unlink()


def _is_alive(pid: int) -> bool:
    if sys.platform == "win32":  # there, a signal of 0 ends the process
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _write(folder: Path, job: Job, record: Mapping[str, Any], seconds: float) -> None:
    """Write a job's file, whole or not at all."""
    path = folder / f"{job.key}.json"
    content = {"label": job.label, "job": job.spec, "seconds": seconds, "record": record}
    write_text(path, json.dumps(content, indent=1, allow_nan=False))


Function = Callable[[dict[str, Any]], dict[str, Any]]
Outcome = tuple[str, dict[str, Any] | None, str | None, float]
"""Key of a job, its record or else the reason why it failed, seconds."""


def _attempt(function: Function, job: Job, mark: Path) -> Outcome:
    """One job, on a worker: an exception is an outcome like any other, and ends no other job."""
    shared = mark.exists()
    if (
        shared and (known := _known(mark.parent, job)) is not None
    ):  # the worker that did it died with the news
        return job.key, known.record, None, known.seconds
    began = time.perf_counter()
    try:
        record = function(dict(job.spec))
        json.dumps(record, allow_nan=False)
    except Exception as error:
        log.debug("%s", traceback.format_exc())
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return job.key, None, reason, time.perf_counter() - began
    seconds = time.perf_counter() - began
    if shared:
        _write(mark.parent, job, record, seconds)
    return job.key, record, None, seconds


def _deaths() -> tuple[type[BaseException], ...]:
    """What comes out of joblib when a worker dies and the backend does not make up for it itself."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    try:
        from distributed.scheduler import KilledWorker
    except ImportError:
        return (TerminatedWorkerError,)
    return TerminatedWorkerError, KilledWorker


@contextmanager
def _backend(
    cluster: str | None, workers: int | None, mark: Path
) -> Iterator[Callable[[Function, Sequence[Job]], Iterator[Outcome]]]:
    """A function that runs jobs and yields their outcomes as they come."""
    try:
        from joblib import Parallel, delayed, parallel_config
    except ImportError:
        raise ImportError(_INSTALL) from None

    def parallel(function: Function, jobs: Sequence[Job]) -> Iterator[Outcome]:
        calls = (delayed(_attempt)(function, job, mark) for job in jobs)
        yield from Parallel(return_as="generator_unordered", batch_size=1)(calls)

    if cluster is None:
        with parallel_config(backend="loky", n_jobs=workers or os.cpu_count()):
            yield parallel
        return
    if workers is not None:
        raise ValueError("workers: a cluster has its own workers; leave the number out")
    try:
        from distributed import Client
    except ImportError:
        raise ImportError(_INSTALL) from None
    try:
        client = Client(cluster, timeout="10s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(f"cluster {cluster}: no Dask scheduler answers there ({error})") from None
    with client, parallel_config(backend="dask", client=client, n_jobs=-1):
        yield parallel
