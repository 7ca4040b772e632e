"""The TOML file of a sweep: instances x seeds x solvers, checked before any work.

instances = ["constellation-mid", "mine.npz", { name = "constellation-mid", cost = 1.0, tasks = 600 }]
solvers = ["haa", "haal:6", "bound"]
seeds = [0, 1, 2]
time_limit = 60.0
"""

from __future__ import annotations

import difflib
import hashlib
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sapopt.domains.instances import find_instance
from sapopt.solvers.names import parse_solver
from sapopt.sweeps.engine import Job

BOUND = "bound"
"""In the list of solvers: compute an upper bound instead."""

_KEYS = ("instances", "solvers", "seeds", "time_limit", "out")


@dataclass(frozen=True)
class Sweep:
    """A checked configuration.

    Attributes
    ----------
    jobs : list of Job
        For `sapopt.sweeps.solve_job`; the jobs of one instance and seed are next to each other.
    out : Path or None
        Folder of the results, relative to the configuration's.
    """

    jobs: list[Job]
    out: Path | None


def read_config(path: str | Path, dynamics: str | None = None) -> Sweep:
    """Read and check the configuration of a sweep.

    Parameters
    ----------
    path : str or Path
    dynamics : str, optional
        ``MODULE:CLASS``, the class of the user's own dynamics in the problem files; the workers import it.

    Raises
    ------
    ValueError
        In one line: the file, the key and what is wrong with it.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    try:
        with path.open("rb") as file:
            config = tomllib.load(file)
        return _sweep(config, path.parent, dynamics)
    except ValueError as error:  # a TOMLDecodeError is one
        raise ValueError(f"{path}: {error}") from None


def _sweep(config: dict[str, Any], folder: Path, dynamics: str | None) -> Sweep:
    for key in config:
        if key not in _KEYS:
            raise ValueError(f"{key}: {_suggestion('unknown key', key, _KEYS)}")
    entries = enumerate(_list(config, "instances"))
    instances = [_instance(entry, f"instances[{at}]", folder) for at, entry in entries]
    if dynamics is not None:
        instances = [{**one, "dynamics": dynamics} if "file" in one else one for one in instances]
    solvers = [_solver(entry, f"solvers[{at}]") for at, entry in enumerate(_list(config, "solvers"))]
    seeds = _list(config, "seeds") if "seeds" in config else [0]
    for at, seed in enumerate(seeds):
        if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
            raise ValueError(f"seeds[{at}]: must be a whole number of at least 0, got {seed!r}")
    limit = config.get("time_limit")
    if limit is not None and (
        isinstance(limit, bool) or not isinstance(limit, int | float) or not 0 < limit < float("inf")
    ):
        raise ValueError(f"time_limit: must be a positive number of seconds, got {limit!r}")
    out = config.get("out")
    if out is not None and not isinstance(out, str):
        raise ValueError(f"out: must be the name of a folder, got {out!r}")
    for name, values in (("instances", instances), ("solvers", solvers), ("seeds", seeds)):
        for at, value in enumerate(values):
            if value in values[:at]:
                raise ValueError(f"{name}[{at}]: {value!r} is listed twice")
    jobs = []
    for instance in instances:
        for seed in seeds:
            for solver in solvers:
                spec = {
                    "instance": instance,
                    "seed": seed,
                    "solver": solver,
                    "time_limit": None if limit is None else float(limit),
                }
                jobs.append(Job(f"{instance_label(instance)} seed {seed} {solver}", spec))
    return Sweep(jobs, None if out is None else folder / out)


def instance_label(instance: dict[str, Any]) -> str:
    """Name of an instance with the options that differ from its own."""
    options = [
        f"{key}={value}"
        for key, value in instance.items()
        if key not in ("name", "file", "sha256", "dynamics")
    ]
    name = Path(instance["file"]).name if "file" in instance else instance["name"]
    return " ".join([name, *options])


def _list(config: dict[str, Any], key: str) -> list[Any]:
    if key not in config:
        raise ValueError(f"{key}: is missing; give a list")
    value = config[key]
    if not isinstance(value, list) or not value:
        raise ValueError(f"{key}: must be a list with at least one entry, got {value!r}")
    return value


def _instance(entry: Any, key: str, folder: Path) -> dict[str, Any]:
    """A built-in instance with its options, or a file."""
    table = {"name": entry} if isinstance(entry, str) else entry
    if not isinstance(table, dict) or not isinstance(table.get("name"), str):
        raise ValueError(f"{key}: must be a name, a file, or a table with a name, got {entry!r}")
    name = table["name"]
    if name.endswith(".npz") or len(Path(name).parts) > 1:
        if len(table) > 1:
            raise ValueError(f"{key}: a file has its own cost and takes no options, got {entry!r}")
        if not (folder / name).is_file():
            raise ValueError(f"{key}: there is no file {folder / name}")
        path = (folder / name).resolve()
        # A changed file is another problem, so its results are others'.
        return {"file": str(path), "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    try:
        options = find_instance(name).options
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from None
    for option, value in table.items():
        if option not in ("name", "cost", "idle_is_free", *options):
            raise ValueError(
                f"{key}.{option}: {_suggestion('unknown option', option, ('cost', 'idle_is_free', *options))}"
            )
        if not isinstance(value, str | int | float | bool):
            raise ValueError(f"{key}.{option}: must be a plain value, got {value!r}")
    cost = table.get("cost", 0.0)
    if isinstance(cost, bool | str) or not 0 <= cost < float("inf"):
        raise ValueError(f"{key}.cost: must be a number of at least 0, got {cost!r}")
    return dict(table)


def _solver(entry: Any, key: str) -> str:
    """The full name of a solver, or `BOUND`."""
    if not isinstance(entry, str):
        raise ValueError(f"{key}: must be a name such as 'haal:6', got {entry!r}")
    if entry == BOUND:
        return BOUND
    try:
        return parse_solver(entry).name
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from None


def _suggestion(what: str, word: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"{what}; did you mean {close[0]!r}?" if close else f"{what}; known: {', '.join(known)}"
