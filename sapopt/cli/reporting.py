"""The command that shows: ``report`` turns the files of ``solve`` and ``compare`` into one HTML page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from sapopt.cli import show, work
from sapopt.cli.app import AsJson, Cost, Force, app, check_time
from sapopt.cli.output import check_new
from sapopt.cli.progress import Reporter
from sapopt.problem.result import Result, Status
from sapopt.problem.sap import SAP

_PROOF_SECONDS = 20.0


@dataclass(frozen=True)
class _Found:
    """The files of one run: what `solve` or `compare` wrote down, and the file with the plans."""

    record: Mapping[str, Any]
    plans: Path
    several: bool


@app.command(name="report")
def report(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT",
            help="A folder that `solve --out` or `compare --out` wrote, or a result's .npz file.",
        ),
    ],
    instance: Annotated[
        str | None,
        typer.Argument(
            metavar="[INSTANCE]",
            help="The problem, a name or a file; by default the one that the result belongs to.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The page to write.")] = Path("report.html"),
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of a built-in instance, if it is not that of the result.")
    ] = None,
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
    found = _find(result)
    check_new(out, force)
    name = instance if instance is not None else found.record.get("source")
    if name is None:
        raise ValueError(
            f"{result} does not say which problem it is about; name it: sapopt report RESULT INSTANCE"
        )
    work.check_instance(name)
    seed = int(found.record.get("seed") or 0) if seed is None else seed
    if cost is None and not Path(name).is_file():
        cost = found.record.get("cost")
    with Reporter() as reporter:
        label, problem, scenario = work.load_scenario(name, seed, cost, reporter)
        fingerprint = found.record.get("fingerprint")
        if fingerprint is not None and fingerprint != problem.fingerprint:
            raise ValueError(
                f"{result} is about another problem than {name} with seed {seed}; pass the instance, --seed and --cost "
                "that it was made with"
            )
        results, prices = _results(found, problem)
        bounds = [r.bound for r in results.values() if r.bound is not None]
        bound = min(bounds, default=None)
        if with_bound and (bound is None or prices is None):
            proven = work.prove_bound(problem, seed, time_limit, reporter)
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


def _find(path: Path) -> _Found:
    """The files that belong to what the user named."""
    if path.is_dir():
        kinds = [kind for kind in ("compare", "solve") if (path / f"{kind}.json").is_file()]
        if not kinds:
            raise ValueError(
                f"{path} holds neither compare.json nor solve.json; make it with `sapopt compare --out`"
            )
        if len(kinds) > 1:
            raise ValueError(f"{path} holds both compare.json and solve.json; name one of the two files")
        path = path / f"{kinds[0]}.json"
    if not path.is_file():
        raise ValueError(f"there is no file or folder {path}")
    plans, record = path.with_suffix(".npz"), path.with_suffix(".json")
    if not plans.is_file():
        raise ValueError(f"{path}: there is no {plans.name} beside it")
    told: dict[str, Any] = {}
    if record.is_file():
        try:
            told = json.loads(record.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{record}: damaged ({error})") from None
        if not isinstance(told, dict):
            raise ValueError(f"{record}: not the report of a run")
    return _Found(told, plans, "solvers" in told)


def _results(found: _Found, problem: SAP) -> tuple[dict[str, Result], Any]:
    """Results by name, and task prices if there are some."""
    if not found.several:
        one = Result.load(found.plans)
        return {one.solver: one}, one.prices
    results = {}
    bound = found.record.get("bound")
    try:
        with np.load(found.plans, allow_pickle=False) as plans:
            for name, record in found.record["solvers"].items():
                plan = plans[name]
                results[name] = Result(
                    plan, problem.evaluate(plan), Status(record["status"]), record["seconds"], record["solver"], bound,
                    record.get("trace", []), record["seed"],
                )  # fmt: skip
        priced = found.plans.with_name("prices.npz")
        if not priced.is_file():
            return results, None
        with np.load(priced, allow_pickle=False) as file:
            return results, file["prices"]
    except (KeyError, TypeError, OSError) as error:
        raise ValueError(f"{found.plans}: damaged, or not written by `sapopt compare` ({error})") from None
