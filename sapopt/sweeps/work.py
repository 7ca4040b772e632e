"""What a worker does with one job of a sweep."""

from __future__ import annotations

import json
import platform
import socket
from functools import lru_cache
from importlib.metadata import version
from typing import Any

from sapopt.problem.sap import SAP


def solve_job(spec: dict[str, Any]) -> dict[str, Any]:
    """Solve or bound one instance.

    Parameters
    ----------
    spec : dict
        ``instance`` (``name`` with options, or ``file``), ``seed``, ``solver`` (a name of the command line, or
        ``bound``) and ``time_limit`` (seconds or None).

    Returns
    -------
    dict
        Value, bound, handovers, seconds and where it ran; plain JSON values, None where there is nothing.
    """
    from sapopt.api import bound, solve
    from sapopt.solvers.names import parse_solver

    problem = _problem(json.dumps(spec["instance"], sort_keys=True), spec["seed"])
    _warm_up(problem, spec["solver"])
    record: dict[str, Any] = {
        "agents": problem.n, "tasks": problem.m, "steps": problem.T, "fingerprint": problem.fingerprint,
        "host": socket.gethostname(), "python": platform.python_version(), "sapopt": version("sapopt"),
    }  # fmt: skip
    if spec["solver"] == "bound":
        proven = bound(problem, time_limit=spec["time_limit"], seed=spec["seed"])
        return record | {"value": None, "bound": proven.value, "method": proven.method}
    result = solve(
        problem, parse_solver(spec["solver"]).solver, seed=spec["seed"], time_limit=spec["time_limit"]
    )
    return record | {
        "value": result.value,
        "bound": result.bound,
        "handovers": result.handovers,
        "status": result.status.value,
        "runtime": result.runtime,
    }


@lru_cache(maxsize=1)
def _problem(instance: str, seed: int) -> SAP:
    """The problem; the last one is kept, since the jobs of one problem come one after the other."""
    from sapopt.domains.instances import instance as build

    options = json.loads(instance)
    if "file" in options:
        named = options.get("dynamics")
        return SAP.load(options["file"], _own(options["file"], named) if named else None)
    return build(options.pop("name"), seed, **options)


def _own(path: str, named: str) -> Any:
    """The class of the user's own dynamics; None for a file that holds one of sapopt's."""
    from sapopt.problem.files import brings_own
    from sapopt.sweeps.handed import handed_over

    return handed_over(named) if brings_own(path) else None


_warm: set[str] = set()


def _warm_up(problem: SAP, solver: str) -> None:
    """Compile what the job needs, once a process and solver, so that no time limit pays for it."""
    from sapopt.solvers.names import parse_solver
    from sapopt.warming import parts, warm_up

    if solver not in _warm:
        for part in parts(None if solver == "bound" else parse_solver(solver).solver, problem):
            warm_up(problem, part)
        _warm.add(solver)
