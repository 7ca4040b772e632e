"""Runs behind figures 4.3 and 4.4: every method on one constellation, in worker processes, kept in a file."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sapopt import SAP
from sapopt.data.files import write_text
from sapopt.domains.instances import scenario
from sapopt.running.rollout import rollout
from sapopt.solvers import CBBA, HAAL, HAALD, DistributedDualLookahead, Greedy, NoHandover
from sapopt.solvers.distributed import play

EPSILON = 0.01
LABELS = {
    "HAAL": "HAAL",
    "HAALD": "HAAL-D",
    "CBBA": "CBBA",
    "dual": "distributed dual lookahead (ours)",
    "greedy": "greedy",
    "no handover": "no handover",
}


@dataclass(frozen=True)
class Job:
    """One method with one lookahead on one instance."""

    instance: str
    seed: int
    steps: int
    method: str
    lookahead: int


@dataclass(frozen=True)
class Run:
    """What came of a job; rounds, messages and megabytes are means over the steps."""

    job: Job
    value: float
    handovers: int
    seconds_per_step: float
    rounds: float = 0.0
    messages: float = 0.0
    megabytes: float = 0.0


def policy_of(job: Job, graphs: Any) -> Any:
    """The policy of a job."""
    makers: dict[str, Callable[[], Any]] = {
        "HAAL": lambda: HAAL(job.lookahead),
        "HAALD": lambda: HAALD(job.lookahead, EPSILON, graphs),
        "CBBA": lambda: CBBA(job.lookahead, graphs),
        "dual": lambda: DistributedDualLookahead(job.lookahead, EPSILON, graphs),
        "greedy": Greedy,
        "no handover": NoHandover,
    }
    return makers[job.method]()


def run(job: Job) -> Run:
    """Play one job."""
    constellation = scenario(job.instance, job.seed)
    whole = constellation.problem()
    steps = min(job.steps, whole.T)
    problem = SAP(whole.benefits.slice(0, steps), whole.dynamics)
    talks = job.method in ("HAALD", "CBBA", "dual")
    graphs = constellation.graphs(steps=range(steps)) if talks else None
    policy = policy_of(job, graphs)
    began = time.perf_counter()
    if not talks:
        plan, traffic = rollout(problem, policy).plan, []
    else:
        played, traffic = play(problem, policy)
        plan = played.plan
    seconds = (time.perf_counter() - began) / steps
    result = problem.evaluate(plan)  # raises if a task is given to two agents
    means = [
        float(np.mean([getattr(t, name) for t in traffic])) if traffic else 0.0
        for name in ("rounds", "messages", "bytes")
    ]
    return Run(job, result.value, result.handovers, seconds, means[0], means[1], means[2] / 1e6)


def run_all(jobs: list[Job], path: Path, workers: int) -> list[Run]:
    """Run the jobs that the file does not hold yet, longest first, with progress; keep each as it ends."""
    known = {one.job: one for one in read(path)}
    todo = sorted((job for job in jobs if job not in known), key=lambda j: (j.method != "CBBA", -j.lookahead))
    os.environ["NUMBA_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"  # for the workers: one core each
    began = time.perf_counter()
    with ProcessPoolExecutor(workers) as pool:
        futures = [pool.submit(run, job) for job in todo]
        for done, future in enumerate(as_completed(futures), 1):
            one = future.result()
            known[one.job] = one
            write(path, list(known.values()))
            elapsed = time.perf_counter() - began
            print(
                f"[{done:3d}/{len(todo)}] {elapsed:5.0f} s  seed {one.job.seed} {LABELS[one.job.method]:34s} "
                f"L={one.job.lookahead}  value {one.value:8.1f}  {one.rounds:5.1f} rounds  "
                f"{1e3 * one.seconds_per_step:6.0f} ms a step",
                flush=True,
            )
    return [known[job] for job in jobs]


def read(path: Path) -> list[Run]:
    """Runs kept in a file."""
    if not path.exists():
        return []
    return [Run(**(row | {"job": Job(**row["job"])})) for row in json.loads(path.read_text())]


def write(path: Path, runs: list[Run]) -> None:
    """Keep runs in a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps([asdict(one) for one in runs], indent=1))


def curve(runs: list[Run], method: str, what: str) -> tuple[list[int], np.ndarray]:
    """Lookaheads, and a row of values for each over the seeds."""
    lookaheads = sorted({one.job.lookahead for one in runs if one.job.method == method})
    rows = [
        [getattr(one, what) for one in runs if one.job.method == method and one.job.lookahead == length]
        for length in lookaheads
    ]
    return lookaheads, np.array(rows)
