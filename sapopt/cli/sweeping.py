"""The command ``sweep``: many jobs over processes or a Dask cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from sapopt.cli import own, show
from sapopt.cli.app import EXIT_INTERRUPTED, AsJson, app
from sapopt.cli.progress import Reporter

EXIT_FAILED = 1


@app.command(name="sweep")
def sweep(
    config: Annotated[
        Path,
        typer.Argument(metavar="CONFIG", help="A TOML file: instances, solvers, seeds, time_limit, out."),
    ],
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT", help="A Dask scheduler; by default processes on this machine."
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Number of processes if there is no cluster; one for each core by default."),
    ] = None,
    as_json: AsJson = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the results, instead of the file's `out`.")
    ] = None,
) -> None:
    """Run every solver on every instance with every seed. Finished jobs are saved at once and skipped the next time."""
    from sapopt.sweeps import Finished, read_config, run_jobs, solve_job

    plan = read_config(config, own.named())
    folder = out or plan.out
    if folder is None:
        raise ValueError(f"{config}: out: is missing; name the folder of the results there or with --out")
    landed: list[Finished] = []
    interrupted = False
    with Reporter() as reporter:
        try:
            with reporter.phase(f"sweep of {len(plan.jobs)} jobs", total=len(plan.jobs)) as phase:

                def tell(finished: Finished) -> None:
                    landed.append(finished)
                    phase.update(len(landed), len(plan.jobs), f"{len(landed)} of {len(plan.jobs)} done")
                    if finished.error is not None:
                        reporter.line(f"  {finished.job.label} failed: {finished.error}")
                    elif finished.fresh:
                        reporter.line(f"  {finished.job.label}: {finished.seconds:.1f} s")

                run_jobs(solve_job, plan.jobs, folder, cluster=cluster, workers=workers, on_finished=tell)
        except KeyboardInterrupt:
            interrupted = True
            reporter.line("interrupted; the same command goes on from here")
    by_key = {finished.job.key: finished for finished in landed}
    done = [by_key[job.key] for job in plan.jobs if job.key in by_key]
    failed = [finished for finished in done if finished.error is not None]
    if as_json:
        show.print_json(
            {
                "folder": str(folder),
                "jobs": len(plan.jobs),
                "done": len(done) - len(failed),
                "skipped": sum(not finished.fresh for finished in done),
                "interrupted": interrupted,
                "results": [_row(finished) for finished in done],
            }
        )
    else:
        _print_table(done)
        print(f"{len(done) - len(failed)} of {len(plan.jobs)} jobs are in {folder}")
    if interrupted:
        raise typer.Exit(EXIT_INTERRUPTED)
    if failed:
        raise typer.Exit(EXIT_FAILED)


def _row(finished: Any) -> dict[str, Any]:
    return {
        **finished.job.spec,
        "key": finished.job.key,
        "seconds": finished.seconds,
        "error": finished.error,
        **(finished.record or {}),
    }


def _print_table(done: list[Any]) -> None:
    """Means over the seeds, one line for every instance and solver."""
    from rich.table import Table

    from sapopt.sweeps.config import instance_label

    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for finished in done:
        if finished.record is not None:
            key = instance_label(finished.job.spec["instance"]), finished.job.spec["solver"]
            groups.setdefault(key, []).append(finished.record | {"seconds": finished.seconds})
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in ("instance", "solver"):
        table.add_column(column)
    for column in ("seeds", "mean value", "mean bound", "mean s"):
        table.add_column(column, justify="right")
    for (instance, solver), records in groups.items():
        cells = [_mean([record[name] for record in records]) for name in ("value", "bound", "seconds")]
        table.add_row(instance, solver, str(len(records)), *cells)
    show.print_table(table)


def _mean(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):,.1f}" if known else "-"
