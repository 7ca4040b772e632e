"""The command ``warm``: compile all kernels before they are needed."""

from __future__ import annotations

import contextlib
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Annotated

import typer

from sapopt.cli.app import AsJson, app
from sapopt.cli.progress import Reporter
from sapopt.kernels.blocks import thread_count

_BOUND = "bound"


@app.command(name="warm")
def warm(
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Processes that compile side by side; one a processor if omitted."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the kernels of every method and leave them in the cache, so that no later call waits for them."""
    from sapopt.cli.show import environment, print_json
    from sapopt.solvers.names import METHODS

    jobs = thread_count() if jobs is None else jobs
    # The longest first; who comes later finds in the cache what they have in common.
    names = [_BOUND, *reversed([method.name for method in METHODS])]
    began = time.perf_counter()
    seconds = {}
    with Reporter() as reporter, reporter.phase("compiling kernels", total=len(names)) as phase:
        # spawn: children of this process's own interpreter, whatever threads it may have
        with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
            runs = {pool.submit(compile_kernels, name): name for name in names}
            for done, run in enumerate(as_completed(runs), 1):
                seconds[runs[run]] = run.result()
                phase.update(done, note=runs[run])
        phase.note = f"{len(names)} methods on {jobs} {'processes' if jobs > 1 else 'process'}"
    wall = time.perf_counter() - began
    if as_json:
        compiled = {name: seconds[name] for name in sorted(seconds)}
        print_json({"jobs": jobs, "seconds": wall, "compile_seconds": compiled, "environment": environment()})
    else:
        print(f"all kernels are compiled ({wall:.1f} s)")


def compile_kernels(name: str) -> float:
    """Run one method (or ``bound``) on tiny problems of every kind; returns the seconds of compiling that it took.

    Last comes what ``sapopt compare`` and its like do before their clock starts, on a small constellation: a problem of
    another size takes other ways, and building it has kernels of its own.
    """
    import logging

    from sapopt.domains.instances import instance
    from sapopt.domains.tiny import tiny_problems
    from sapopt.kernels.clock import compile_seconds
    from sapopt.kernels.jit import compiled_always
    from sapopt.solvers.names import parse_solver
    from sapopt.warming import parts, run_tiny, warm_up

    logging.getLogger("sapopt").setLevel(logging.ERROR)  # runs cut short are no news here
    solver = None if name == _BOUND else parse_solver(name).solver
    before = compile_seconds()
    with compiled_always():
        for _, problem in tiny_problems():
            run_tiny(problem, solver)
        with contextlib.suppress(ValueError):  # the method does not take a switching cost
            toy = instance("constellation-toy")
            for part in parts(solver, toy):
                warm_up(toy, part)
    return compile_seconds() - before
