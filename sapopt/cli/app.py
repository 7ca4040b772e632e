"""The commands. ``sapopt.cli.main`` is the entry point of the ``sapopt`` program."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer.core import TyperGroup

import sapopt
from sapopt.cli.names import methods_help, parse_solver, parse_solvers
from sapopt.result import Status

log = logging.getLogger(__name__)

DEFAULT_SOLVERS = "no-handover,greedy,haa,haal:2,haal:3,haal:6"
EXIT_BAD_ARGUMENT = 2
EXIT_INTERRUPTED = 130


class _OneLineErrors(TyperGroup):
    """Turns every error of the user into one line on stderr and exit status 2."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command; `standalone_mode` ends the process with the exit status."""
        try:
            code = super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        except typer.Abort:
            code = EXIT_INTERRUPTED
        except SystemError as error:
            # Ctrl-C in the middle of a compiled kernel comes out like this.
            if not isinstance(error.__cause__, KeyboardInterrupt):
                raise
            code = EXIT_INTERRUPTED
        except Exception as error:
            message = _message(error)
            if message is None:
                raise
            log.debug("bad argument", exc_info=True)
            if message:
                print(f"sapopt: {message}", file=sys.stderr)
            code = EXIT_BAD_ARGUMENT
        if standalone_mode:
            sys.exit(code or 0)
        return code


def _message(error: Exception) -> str | None:
    """One line for an error that the user can mend, None for one that is ours."""
    if hasattr(error, "format_message"):  # a usage error of the argument parser
        text = str(error.format_message())
    elif isinstance(error, ValueError | OSError):
        text = str(error)
    else:
        return None
    return " ".join(text.split())


app = typer.Typer(
    cls=_OneLineErrors,
    name="sapopt",
    help="Sequential assignment problems: solve them, and prove how far each answer is from the optimum.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

InstanceArgument = Annotated[
    str, typer.Argument(metavar="INSTANCE", help="A built-in name (see `sapopt instances`) or an .npz file.")
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of a built-in instance and of the solvers.")]
Cost = Annotated[
    float | None, typer.Option(min=0.0, help="Handover cost of a built-in instance, instead of its own.")
]
TimeLimit = Annotated[
    float | None, typer.Option(help="Seconds for each solver; the best answer so far is kept.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Write JSON to stdout, and nothing else.")]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for JSON, npz and PNG files.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite files that exist.")]
Agent = Annotated[int, typer.Option(min=0, help="The agent whose benefit history is drawn.")]


def _version(wanted: bool) -> None:
    if wanted:
        print(sapopt.__version__)
        raise typer.Exit


@app.callback(invoke_without_command=False)
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and stop.", is_eager=True, callback=_version),
    ] = False,
) -> None:
    pass


@app.command(name="instances")
def _instances(as_json: AsJson = False) -> None:
    """List the built-in instances."""
    from rich.table import Table

    from sapopt.cli.show import print_json, print_table
    from sapopt.domains.instances import instances

    known = instances()
    if as_json:
        print_json(
            [
                {
                    "name": i.name,
                    "summary": i.summary,
                    "steps": i.shape[0],
                    "agents": i.shape[1],
                    "tasks": i.shape[2],
                    "cost": i.cost,
                }
                for i in known
            ]
        )
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in ("name", "what it is"):
        table.add_column(column, no_wrap=column == "name")
    for entry in known:
        table.add_row(entry.name, entry.summary)
    print_table(table)


@app.command(name="compare")
def _compare(
    instance: InstanceArgument,
    solvers: Annotated[
        str, typer.Option(metavar="LIST", help=f"Separated by commas, from: {methods_help()}.")
    ] = DEFAULT_SOLVERS,
    seed: Seed = 0,
    cost: Cost = None,
    time_limit: TimeLimit = 40.0,
    agent: Agent = 0,
    as_json: AsJson = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Run several solvers on one problem and show the share of the proven bound that each reaches."""
    from sapopt.cli import show, work
    from sapopt.cli.output import Output
    from sapopt.cli.progress import Reporter

    chosen = parse_solvers(solvers)
    work.check_instance(instance)
    _check_time(time_limit)
    output = Output(out, ["compare.json", "compare.npz", "compare.png", "history.png"], force)
    with Reporter() as reporter:
        name, problem = work.load(instance, seed, cost, reporter)
        _check_agent(agent, problem.n)
        run = work.compare(problem, chosen, seed, time_limit, reporter)
        records = {key: show.result_record(result, run.bound) for key, result in run.results.items()}
        report = {
            **show.problem_record(name, problem),
            "bound": run.bound,
            "seed": seed,
            "time_limit": time_limit,
            "interrupted": run.interrupted,
            "solvers": records,
            "environment": show.environment(),
        }
        if out is not None:
            with reporter.phase(f"writing {out}"):
                output.json("compare.json", report)
                plans: dict[str, Any] = {key: result.plan for key, result in run.results.items()}
                output.npz("compare.npz", lambda path: np.savez_compressed(path, **plans))
                show.compare_figures(output, problem, run.results, run.bound, agent)
    if as_json:
        show.print_json(report)
    else:
        title = f"{name}: {problem.n} agents, {problem.m} tasks, {problem.T} steps, {problem.dynamics!r}"
        proof = (
            "no bound was proven"
            if run.bound is None
            else f"proven upper bound of every plan: {run.bound:,.1f}"
        )
        lines = [proof, *(f"wrote {path}" for path in output.written)]
        show.print_table(show.results_table(records), *lines, title=title)
    if run.interrupted:
        raise typer.Exit(EXIT_INTERRUPTED)


@app.command(name="solve")
def _solve(
    instance: InstanceArgument,
    solver: Annotated[str, typer.Option(help=f"One of: {methods_help()}.")] = "haal",
    lookahead: Annotated[
        int | None, typer.Option("--lookahead", "--window", "-L", help="Steps that the solver looks ahead.")
    ] = None,
    seed: Seed = 0,
    cost: Cost = None,
    time_limit: TimeLimit = None,
    with_bound: Annotated[
        bool, typer.Option("--bound/--no-bound", help="Also prove a bound, if the solver does not.")
    ] = True,
    agent: Agent = 0,
    as_json: AsJson = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Solve one problem with one solver."""
    from sapopt.cli import show, work
    from sapopt.cli.output import Output
    from sapopt.cli.progress import Reporter

    named = parse_solver(solver, lookahead)
    work.check_instance(instance)
    _check_time(time_limit)
    output = Output(out, ["solve.json", "solve.npz", "history.png", "timeline.png", "gap.png"], force)
    with Reporter() as reporter:
        name, problem = work.load(instance, seed, cost, reporter)
        _check_agent(agent, problem.n)
        work.warm_up(problem, [named], reporter)
        result = work.run_solver(problem, named, seed, time_limit, reporter)
        if with_bound and result.bound is None and result.status is not Status.INTERRUPTED:
            result = result.with_bound(work.prove_bound(problem, reporter).value)
        record = show.result_record(result, None)
        report = {**show.problem_record(name, problem), **record, "environment": show.environment()}
        if out is not None:
            with reporter.phase(f"writing {out}"):
                output.json("solve.json", report | {"trace": result.trace})
                output.npz("solve.npz", result.save)
                show.solve_figures(output, problem, named.name, result, agent)
    if as_json:
        show.print_json(report | {"plan": result.plan})
    else:
        title = f"{name}: {problem.n} agents, {problem.m} tasks, {problem.T} steps, {problem.dynamics!r}"
        lines = [result.status.message, *(f"wrote {path}" for path in output.written)]
        show.print_table(show.results_table({named.name: record}), *lines, title=title)
    if result.status is Status.INTERRUPTED:
        raise typer.Exit(EXIT_INTERRUPTED)


@app.command(name="bound")
def _bound(
    instance: InstanceArgument,
    seed: Seed = 0,
    cost: Cost = None,
    as_json: AsJson = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Prove an upper bound of the value of every plan."""
    from sapopt.cli import show, work
    from sapopt.cli.output import Output
    from sapopt.cli.progress import Reporter

    work.check_instance(instance)
    output = Output(out, ["bound.json", "bound.npz"], force)
    with Reporter() as reporter:
        name, problem = work.load(instance, seed, cost, reporter)
        began = time.perf_counter()
        proven = work.prove_bound(problem, reporter)
        seconds = time.perf_counter() - began
    report = {
        **show.problem_record(name, problem),
        "bound": proven.value,
        "method": proven.method,
        "seconds": seconds,
        "seed": seed,
        "environment": show.environment(),
    }
    output.json("bound.json", report)
    if proven.prices is not None:
        prices = proven.prices
        output.npz("bound.npz", lambda path: np.savez_compressed(path, prices=prices))
    if as_json:
        show.print_json(report)
    else:
        print(f"{name}: no plan is worth more than {proven.value:,.4f} ({proven.method}, {seconds:.1f} s)")
        for path in output.written:
            print(f"wrote {path}")


def _check_time(time_limit: float | None) -> None:
    if time_limit is not None and not 0 < time_limit < float("inf"):
        raise ValueError(f"--time-limit must be a positive number of seconds, got {time_limit}")


def _check_agent(agent: int, n: int) -> None:
    if agent >= n:
        raise ValueError(f"--agent must lie in 0..{n - 1}, got {agent}")


def main() -> None:
    """Run the ``sapopt`` program."""
    app()
