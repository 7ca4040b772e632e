"""The long stretches of the commands: build a problem, compile, solve, prove a bound; each shows its progress."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from sapopt import api as verbs
from sapopt import warming
from sapopt.cli import own
from sapopt.cli.alongside import Helpers, Job
from sapopt.cli.links import shortened
from sapopt.cli.progress import Phase, Reporter
from sapopt.data.types import FloatArray
from sapopt.domains.instances import find_instance, instances, scenario
from sapopt.domains.scenario import Scenario
from sapopt.kernels.clock import compile_seconds
from sapopt.problem.result import Result, Status
from sapopt.problem.sap import SAP
from sapopt.proofs.certificate import Bound
from sapopt.running.control import Callback, Progress, Run, interruptible
from sapopt.running.display import describe
from sapopt.solvers.dual_decomposition import DualDecomposition
from sapopt.solvers.names import NamedSolver, nearest


def check_instance(name: str) -> None:
    """Raise ValueError, before any work, if `name` is neither a built-in instance nor a file."""
    path = Path(name)
    if path.suffix == ".npz" or path.is_file() or len(path.parts) > 1:
        if not path.is_file():
            raise ValueError(f"there is no file {name}")
        return
    known = [entry.name for entry in instances()]
    if name not in known:
        raise ValueError(nearest(name, known, "instance"))


def load(name: str, seed: int, cost: float | None, reporter: Reporter) -> tuple[str, SAP]:
    """Name and problem of a built-in instance, or of a file written by ``SAP.save``."""
    return load_scenario(name, seed, cost, reporter)[:2]


def load_scenario(
    name: str, seed: int, cost: float | None, reporter: Reporter
) -> tuple[str, SAP, Scenario | None]:
    """The same, and the scenario that the problem was made of; None for a file."""
    check_instance(name)
    path = Path(name)
    if path.is_file():
        if cost is not None:
            raise ValueError("--cost applies to built-in instances; a file has its own costs")
        with reporter.phase(f"reading {name}") as phase:
            problem = SAP.load(path, own.dynamics())
            phase.note = _size(problem)
        return path.stem, problem, None
    found = find_instance(name)
    steps, n, m = found.shape
    with reporter.phase(f"building {name}") as phase:
        phase.update(note=f"{n} agents, {m} tasks, {steps} steps")
        built: Scenario = scenario(name, seed)
        problem = built.problem(cost=found.cost if cost is None else cost)
        phase.note = _size(problem)
    return name, problem, built


def _size(problem: SAP) -> str:
    return f"{problem.n} agents, {problem.m} tasks, {problem.T} steps"


def warm_up(problem: SAP, solvers: list[NamedSolver], reporter: Reporter, helpers: Helpers) -> None:
    """Compile what the solvers and the bound need, so that no time reported contains it."""
    small = warming.first_steps(problem)
    # What a run turns to later, if at all, is compiled then: it is as much as all the rest, and the clock stands still.
    jobs: list[Job] = []
    for name, solver in ((named.name, named.solver) for named in shortened(solvers, small.T)):
        if isinstance(solver, DualDecomposition) and small.is_plain:
            # It begins with what the one before it and the bound do: a helper, which has done those, has less to do.
            at = max(len(jobs) - 1, 0)
            jobs[at:at] = [(f"{name}, windows", warming.Windows(solver)), (name, solver)]
        else:
            jobs.append((name, solver))
    jobs.append(("bound", None))
    todo = deque(jobs)
    done: list[str] = []
    with reporter.phase("compiling kernels", total=len(jobs)) as phase:

        def run(job: Job) -> None:
            phase.update(len(done), note=job[0])
            warming.warm_up(small, job[1])
            done.append(job[0])

        begun = compile_seconds()
        with (
            helpers.helped(small, todo) as common,
            suppress(IndexError),
        ):  # nothing left: helpers take from the other end
            while True:
                run(todo.popleft())
                if compile_seconds() > begun:
                    common.set()
        for job in jobs:
            if job[0] not in done:  # from the cache now
                run(job)
        phase.note = ""


def _announce() -> None:
    with suppress(OSError):  # nobody listens, or the disk behind it is full: the run goes on
        os.write(2, b"\nstopping after this step; press Ctrl-C again to stop at once\n")


def run_solver(
    problem: SAP, named: NamedSolver, seed: int, time_limit: float | None, reporter: Reporter
) -> Result:
    """Solve, showing step after step, or bound and incumbent. Ctrl-C ends the run with what it has."""
    with reporter.phase(named.name) as phase, interruptible(shown := Run(), _announce):
        result = verbs.solve(
            problem, named.solver, seed=seed, time_limit=time_limit, callback=_shown(phase, shown)
        )
        phase.note = f"value {result.value:,.1f}"
        if result.bound is not None:
            phase.note += f"  bound {result.bound:,.1f}  gap {100 * (result.gap or 0.0):.2f} %"
        if result.status in (Status.TIME_LIMIT, Status.INTERRUPTED):
            phase.note += f"  ({result.status.value})"
    return result


def prove_bound(problem: SAP, seed: int, time_limit: float | None, reporter: Reporter) -> Bound:
    """Prove an upper bound of the problem. Ctrl-C ends the run with the bound proven so far."""
    with reporter.phase("proving a bound") as phase, interruptible(shown := Run(), _announce):
        proven = verbs.bound(problem, seed=seed, time_limit=time_limit, callback=_shown(phase, shown))
        phase.note = f"bound {proven.value:,.1f}"
    return proven


@contextmanager
def watched(text: str, reporter: Reporter) -> Iterator[tuple[Phase, Callback]]:
    """A phase, and a callback that shows a run in it; the first Ctrl-C makes the callback end the run."""
    with reporter.phase(text) as phase, interruptible(shown := Run(), _announce):
        yield phase, _shown(phase, shown)


def _shown(phase: Phase, shown: Run) -> Callback:
    """A callback that shows the reports of a run, and ends it when the user has stopped `shown`."""

    def show(progress: Progress) -> bool:
        phase.update(progress.done, progress.total or None, describe(progress))
        return shown.stopped

    return show


@dataclass(frozen=True)
class Comparison:
    """The results by solver name, the best bound known with its prices, and whether the user ended the run early."""

    results: dict[str, Result]
    bound: float | None
    prices: FloatArray | None
    interrupted: bool


def compare(
    problem: SAP,
    solvers: list[NamedSolver],
    seed: int,
    time_limit: float | None,
    reporter: Reporter,
    helpers: Helpers,
) -> Comparison:
    """Run the solvers one after the other. Ctrl-C ends the run; what is there until then is kept."""
    results: dict[str, Result] = {}
    interrupted = False
    proven: list[tuple[float, FloatArray | None]] = []
    try:
        warm_up(problem, solvers, reporter, helpers)
        for named in solvers:
            results[named.name] = run_solver(problem, named, seed, time_limit, reporter)
            if results[named.name].status is Status.INTERRUPTED:
                raise KeyboardInterrupt
        if all(result.bound is None for result in results.values()):
            found = prove_bound(problem, seed, time_limit, reporter)
            proven.append((found.value, found.prices))
    except KeyboardInterrupt:
        if not results:
            raise
        interrupted = True
    proven += [(result.bound, result.prices) for result in results.values() if result.bound is not None]
    bound, prices = min(proven, key=lambda pair: pair[0], default=(None, None))
    return Comparison(results, bound, prices, interrupted)
