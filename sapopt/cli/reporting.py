"""The command that shows: ``report`` turns the files of ``solve`` and ``compare`` into one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sapopt.cli import runs, show, work
from sapopt.cli.app import AsJson, Cost, Force, app, check_time
from sapopt.cli.output import check_new
from sapopt.cli.progress import Reporter

_PROOF_SECONDS = 20.0


@app.command(name="report")
def report(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT",
            help="A folder that `solve --out` or `compare --out` wrote, or a result's .npz file.",
        ),
    ],
    instance: runs.InstanceOfResult = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The page to write.")] = Path("report.html"),
    seed: runs.SeedOfResult = None,
    cost: Cost = None,
    time_limit: Annotated[
        float, typer.Option(help="Seconds for the proof of a bound, if the result has none.")
    ] = _PROOF_SECONDS,
    with_bound: Annotated[
        bool, typer.Option("--bound/--no-bound", help="Also prove a bound if the result has none.")
    ] = True,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Show results as one HTML page: map, timeline, values against the bound, prices. It needs no network."""
    from sapopt.report import report as write

    check_time(time_limit)
    found = runs.find(result)
    check_new(out, force)
    runs.source(found, result, instance, "report")
    with Reporter() as reporter:
        label, problem, scenario = runs.owner(found, result, instance, seed, cost, reporter, "report")
        results, prices = runs.results(found, problem)
        bounds = [r.bound for r in results.values() if r.bound is not None]
        bound = min(bounds, default=None)
        if with_bound and (bound is None or prices is None):
            proven = work.prove_bound(problem, runs.seed_of(found, seed), time_limit, reporter)
            bound = proven.value if bound is None else min(bound, proven.value)
            prices = proven.prices if prices is None else prices
        with reporter.phase(f"writing {out}") as phase:
            write(
                problem, results, out, scenario=scenario, bound=bound, prices=prices, title=label, force=force
            )
            phase.note = f"{out.stat().st_size / 1e6:.1f} MB"
    if as_json:
        show.print_json(
            {
                **show.problem_record(label, problem),
                "report": str(out),
                "bytes": out.stat().st_size,
                "bound": bound,
                "solvers": {key: show.result_record(one, bound) for key, one in results.items()},
            }
        )
    else:
        print(f"wrote {out}: open it in a browser")
