"""The files of earlier runs: what ``solve --out`` and ``compare --out`` wrote, and results that were saved."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from sapopt.cli import work
from sapopt.cli.progress import Reporter
from sapopt.domains.scenario import Scenario
from sapopt.problem.result import Result, Status
from sapopt.problem.sap import SAP

InstanceOfResult = Annotated[
    str | None,
    typer.Argument(
        metavar="[INSTANCE]",
        help="The problem, a name or a file; by default the one that the result belongs to.",
    ),
]
SeedOfResult = Annotated[
    int | None, typer.Option(min=0, help="Seed of a built-in instance, if it is not that of the result.")
]


@dataclass(frozen=True)
class Found:
    """The files of one run: what `solve` or `compare` wrote down, and the file with the plans."""

    record: Mapping[str, Any]
    plans: Path
    several: bool


def owner(
    found: Found,
    path: Path,
    instance: str | None,
    seed: int | None,
    cost: float | None,
    reporter: Reporter,
    command: str,
) -> tuple[str, SAP, Scenario | None]:
    """Name, problem and scenario that a run was about: what it says, unless the user says something else.

    Raises
    ------
    ValueError
        If nobody says which problem it is, or the files are about another one.
    """
    name = source(found, path, instance, command)
    seed = seed_of(found, seed)
    if cost is None and not Path(name).is_file():
        cost = found.record.get("cost")
    label, problem, scenario = work.load_scenario(name, seed, cost, reporter)
    fingerprint = found.record.get("fingerprint")
    if fingerprint is not None and fingerprint != problem.fingerprint:
        raise ValueError(
            f"{path} is about another problem than {name} with seed {seed}; pass the instance, --seed and --cost "
            "that it was made with"
        )
    return label, problem, scenario


def seed_of(found: Found, seed: int | None) -> int:
    """The seed that the user gives, else that of the run."""
    return int(found.record.get("seed") or 0) if seed is None else seed


def source(found: Found, path: Path, instance: str | None, command: str) -> str:
    """Name or file of the problem that a run was about, checked to exist."""
    name = instance if instance is not None else found.record.get("source")
    if name is None:
        raise ValueError(
            f"{path} does not say which problem it is about; name it: sapopt {command} RESULT INSTANCE"
        )
    work.check_instance(name)
    return str(name)


def find(path: Path) -> Found:
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
    return Found(told, plans, "solvers" in told)


def results(found: Found, problem: SAP) -> tuple[dict[str, Result], Any]:
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
