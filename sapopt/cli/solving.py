"""The commands that solve: ``compare`` and ``solve``."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from sapopt.cli import links, show, work
from sapopt.cli.alongside import Helpers
from sapopt.cli.app import (
    DEFAULT_SOLVER,
    EXIT_INTERRUPTED,
    Agent,
    AsJson,
    Cost,
    Force,
    InstanceArgument,
    Lookahead,
    Out,
    RangeKm,
    Seed,
    TimeLimit,
    agent_number,
    app,
    check_time,
)
from sapopt.cli.output import Output
from sapopt.cli.progress import Reporter
from sapopt.data.files import write_arrays
from sapopt.problem.result import Status
from sapopt.solvers.names import methods_help, parse_solver, parse_solvers

_BOUND_SECONDS = 40.0
"""For the bound beside a solver that proves none, where no limit is asked for."""

DEFAULT_SOLVERS = "no-handover,greedy,haa,haal:2,haal:3,haal:6,dual-lookahead:6,dual-decomposition"


@app.command(name="compare")
def compare(
    instance: InstanceArgument,
    solvers: Annotated[
        str, typer.Option(metavar="LIST", help=f"Separated by commas, from: {methods_help()}.")
    ] = DEFAULT_SOLVERS,
    seed: Seed = 0,
    cost: Cost = None,
    time_limit: TimeLimit = 30.0,
    range_km: RangeKm = None,
    agent: Agent = "0",
    as_json: AsJson = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Run several solvers on one problem and show the share of the proven bound that each reaches."""
    chosen = parse_solvers(solvers)
    work.check_instance(instance)
    check_time(time_limit)
    links.check_range(range_km, chosen)
    output = Output(out, ["compare.json", "compare.npz", "prices.npz", "compare.png", "history.png"], force)
    with Reporter() as reporter, Helpers() as helpers:
        name, problem, scenario = work.load_scenario(instance, seed, cost, reporter)
        drawn = agent_number(agent, problem)
        chosen = links.connect(chosen, scenario, range_km, reporter)
        run = work.compare(problem, chosen, seed, time_limit, reporter, helpers)
        records = {key: show.result_record(result, run.bound) for key, result in run.results.items()}
        report = {
            **show.problem_record(name, problem),
            "source": instance,
            "cost": cost,
            "bound": run.bound,
            "seed": seed,
            "time_limit": time_limit,
            "interrupted": run.interrupted,
            "solvers": records,
            "environment": show.environment(),
        }
        if out is not None:
            with reporter.phase(f"writing {out}"):
                traced = {
                    key: records[key] | {"trace": result.trace if result.bound is not None else []}
                    for key, result in run.results.items()
                }
                output.json("compare.json", report | {"solvers": traced})
                plans: dict[str, Any] = {key: result.plan for key, result in run.results.items()}
                output.npz("compare.npz", lambda path: write_arrays(path, plans))
                if run.prices is not None:
                    prices = run.prices
                    output.npz("prices.npz", lambda path: write_arrays(path, {"prices": prices}))
                show.compare_figures(output, problem, run.results, run.bound, drawn)
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
def solve(
    instance: InstanceArgument,
    solver: Annotated[str, typer.Option(help=f"One of: {methods_help()}.")] = DEFAULT_SOLVER,
    lookahead: Lookahead = None,
    seed: Seed = 0,
    cost: Cost = None,
    time_limit: TimeLimit = None,
    range_km: RangeKm = None,
    with_bound: Annotated[
        bool,
        typer.Option(
            "--bound/--no-bound", help="Also prove a bound if the solver does not, in 40 s or --time-limit."
        ),
    ] = True,
    agent: Agent = "0",
    as_json: AsJson = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Solve one problem with one solver."""
    named = parse_solver(solver, lookahead)
    work.check_instance(instance)
    check_time(time_limit)
    links.check_range(range_km, [named])
    output = Output(out, ["solve.json", "solve.npz", "history.png", "timeline.png", "gap.png"], force)
    with Reporter() as reporter, Helpers() as helpers:
        name, problem, scenario = work.load_scenario(instance, seed, cost, reporter)
        drawn = agent_number(agent, problem)
        (named,) = links.connect([named], scenario, range_km, reporter)
        work.warm_up(problem, [named], reporter, helpers)
        result = work.run_solver(problem, named, seed, time_limit, reporter)
        if with_bound and result.bound is None and result.status is not Status.INTERRUPTED:
            proven = work.prove_bound(problem, seed, time_limit or _BOUND_SECONDS, reporter)
            result = result.with_bound(proven.value, proven.prices)
        record = show.result_record(result, None)
        report = {
            **show.problem_record(name, problem),
            "source": instance,
            "cost": cost,
            **record,
            "environment": show.environment(),
        }
        if out is not None:
            with reporter.phase(f"writing {out}"):
                output.json("solve.json", report | {"trace": result.trace})
                output.npz("solve.npz", result.save)
                show.solve_figures(output, problem, named.name, result, drawn)
    if as_json:
        show.print_json(report | {"plan": result.plan})
    else:
        title = f"{name}: {problem.n} agents, {problem.m} tasks, {problem.T} steps, {problem.dynamics!r}"
        lines = [result.status.message, *(f"wrote {path}" for path in output.written)]
        show.print_table(show.results_table({named.name: record}), *lines, title=title)
    if result.status is Status.INTERRUPTED:
        raise typer.Exit(EXIT_INTERRUPTED)
