"""The command that hands over: ``export`` writes plans and problems as files of other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from sapopt.cli import runs, show, work
from sapopt.cli.app import AsJson, Cost, Force, app
from sapopt.cli.output import check_new
from sapopt.cli.progress import Reporter
from sapopt.problem.result import Result

_PROBLEMS = (".lp", ".mps")
_MAPS = (".czml", ".geojson")
_PACKAGES = {".xlsx": ("openpyxl", "tables"), ".parquet": ("pyarrow", "tables"), ".czml": ("czml3", "space")}


@app.command(name="export")
def export(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A folder that `solve --out` or `compare --out` wrote, or a result's .npz file; for .lp and .mps a "
            "problem, a name or a file.",
        ),
    ],
    to: Annotated[
        Path,
        typer.Option(
            "--to",
            metavar="FILE",
            help="The file to write; its suffix says what: .csv, .xlsx, .parquet, .json, .czml or .geojson for a plan, "
            ".lp or .mps for a problem.",
        ),
    ],
    instance: runs.InstanceOfResult = None,
    form: Annotated[
        str | None,
        typer.Option(
            metavar="FORM",
            help="Of a table: stays (one row for each stay; the default), wide (a column for each agent) or long (a "
            "row for each step and agent).",
        ),
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(help="Which plan of a comparison, by the name of its solver; the best if omitted."),
    ] = None,
    seed: runs.SeedOfResult = None,
    cost: Cost = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Write a plan for spreadsheets and maps, or a problem for other solvers."""
    suffix = to.suffix.lower()
    write = _plan_writer(suffix)
    if write is None and suffix not in _PROBLEMS:
        raise ValueError(
            f"--to {to}: a plan is written as .csv, .xlsx, .parquet, .json, .czml or .geojson, a problem as .lp or .mps"
        )
    _check_options(suffix, form, solver, instance)
    _check_package(suffix)
    check_new(to, force)
    with Reporter() as reporter:
        if write is None:
            work.check_instance(source)
            label, problem = work.load(source, seed or 0, cost, reporter)
            told = show.problem_record(label, problem)
            with reporter.phase(f"writing {to}"):
                problem.write(to)
        else:
            path = Path(source)
            found = runs.find(path)
            if suffix in _MAPS and Path(runs.source(found, path, instance, "export")).is_file():
                raise ValueError(
                    f"--to {to}: a problem from a file has no satellites; a map needs a built-in instance"
                )
            label, problem, scenario = runs.owner(found, path, instance, seed, cost, reporter, "export")
            name, result = _chosen(runs.results(found, problem)[0], solver)
            told = {
                **show.problem_record(label, problem), "solver": name, "value": result.value
            }  # fmt: skip
            with reporter.phase(f"writing {to}"):
                options: dict[str, Any] = (
                    {"scenario": scenario} if suffix in _MAPS else {"form": form or "stays"}
                )
                write(result, to, problem=problem, **options)
    if as_json:
        show.print_json({**told, "file": str(to), "bytes": to.stat().st_size})
    else:
        print(f"wrote {to}")


def _plan_writer(suffix: str) -> Callable[..., None] | None:
    from sapopt.exchange.czml import write_czml
    from sapopt.exchange.files import WRITERS
    from sapopt.exchange.geojson import write_geojson

    return {**WRITERS, ".czml": write_czml, ".geojson": write_geojson}.get(suffix)


def _check_options(suffix: str, form: str | None, solver: str | None, instance: str | None) -> None:
    """Refuse options that say nothing about such a file, and forms that do not exist."""
    from sapopt.exchange.forms import FORMS

    if form is not None and suffix in (*_PROBLEMS, *_MAPS):
        raise ValueError(f"--form is about tables; {suffix} has one form")
    if form is not None and form not in FORMS:
        raise ValueError(f"--form must be one of {', '.join(FORMS)}, got {form!r}")
    if suffix in _PROBLEMS and (solver is not None or instance is not None):
        raise ValueError(f"{suffix} holds a problem: name it as SOURCE, without --solver and INSTANCE")


def _check_package(suffix: str) -> None:
    """Refuse, before any work, what a missing extra makes impossible."""
    from sapopt.data.extras import needed

    if suffix in _PACKAGES:
        package, extra = _PACKAGES[suffix]
        needed(package, extra, f"writing {suffix} files")


def _chosen(results: dict[str, Result], solver: str | None) -> tuple[str, Result]:
    if solver is None:
        return max(results.items(), key=lambda pair: pair[1].value)
    if solver not in results:
        raise ValueError(f"--solver: there is no plan of {solver!r}; there are {', '.join(results)}")
    return solver, results[solver]
