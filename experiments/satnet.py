"""A week of the Deep Space Network: problems of the SatNet benchmark (github.com/edwinytgoh/satnet).

    python -m experiments.satnet FILE [--week W10_2018] [--requests 60] [--minutes 30] [--arrays] [--seconds 20]
                                      [--out results/satnet]

FILE is problems.json of the benchmark, or a part of it: weeks, or one request alone. Time is cut into steps of half
an hour, or of `--minutes`, which begin at the full hours (UTC). Set-up and tear-down and the hours wanted are rounded
up to steps; a spacecraft counts as in view at the steps that lie wholly in a view period. A request is served once, by
one antenna, for the hours that it wants, or for fewer, down to the least that it takes. With `--arrays`, it may be
served by the antennas of an array that begin together (`sapopt.Team`); requests that need an array are left out
otherwise. The value is the hours served.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments import common
from sapopt import solve
from sapopt.domains.deep_space import DeepSpace, fitting_starts
from sapopt.solvers import HAA, DualDecomposition

_NEEDED = ("duration", "duration_min", "setup_time", "teardown_time", "resource_vp_dict")


def read_week(path: Path, week: str | None = None) -> list[dict[str, Any]]:
    """The requests of a week.

    Raises
    ------
    ValueError
        If the file or the week is not there, or a request has another form.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: cannot be read ({error})") from None
    if isinstance(told, dict) and "resource_vp_dict" in told:
        told = [told]
    elif isinstance(told, dict):
        name = week if week is not None else next(iter(told), None)
        if name not in told:
            raise ValueError(f"{path}: there is no week {name!r}; there are {', '.join(told) or 'none'}")
        told = told[name]
    if not isinstance(told, list):
        raise ValueError(f"{path}: expected weeks with lists of requests, or one request")
    for number, request in enumerate(told):
        missing = [key for key in _NEEDED if not isinstance(request, dict) or key not in request]
        if missing:
            raise ValueError(f"{path}: request {number} has no {missing[0]}")
        for antennas, periods in request["resource_vp_dict"].items():
            for period in periods:
                on, off = period.get("TRX ON"), period.get("TRX OFF")
                if not all(isinstance(x, (int, float)) and math.isfinite(x) for x in (on, off)) or on > off:
                    raise ValueError(
                        f"{path}: request {number}, {antennas}: a view period needs 'TRX ON' before 'TRX OFF'"
                    )
    return told


def space_of(requests: list[dict[str, Any]], arrays: bool, step_s: int = 1800) -> DeepSpace:
    """Antennas and requests as a `DeepSpace`; one task for each request, length and array.

    Raises
    ------
    ValueError
        If no request is left.
    """
    forms: list[tuple[int, int, tuple[str, ...], str]] = []
    for number, request in enumerate(requests):
        views = [name for name in request["resource_vp_dict"] if arrays or "_" not in name]
        most, least = (_steps(3600 * float(request[key]), step_s) for key in ("duration", "duration_min"))
        together = sorted({tuple(name.split("_")) for name in views if "_" in name})
        for length in range(most, least - 1, -1):
            label = f"{number} {request.get('user', '')} {length * step_s / 3600:g} h".replace("  ", " ")
            singles = tuple(name for name in views if "_" not in name)
            if singles:
                forms.append((number, length, singles, label))
            forms += [(number, length, array, f"{label} {'+'.join(array)}") for array in together]
    if not forms:
        raise ValueError("no request can be served by one antenna; give --arrays")
    periods = [
        (p["TRX ON"], p["TRX OFF"])
        for r in requests
        for views in r["resource_vp_dict"].values()
        for p in views
    ]
    antennas = sorted({a for form in forms for a in form[2]})
    begin = step_s * math.floor(min(on for on, _ in periods) / step_s)
    T = math.ceil((max(off for _, off in periods) - begin) / step_s)
    view = np.zeros((T, len(antennas), len(forms)), dtype=bool)
    needs, length = np.ones(len(forms), dtype=np.int64), np.zeros(len(forms), dtype=np.int64)
    begins = np.zeros_like(view)
    for j, (number, served, who, _) in enumerate(forms):
        request = requests[number]
        named = request["resource_vp_dict"]
        array = "_".join(who) if len(who) > 1 and "_".join(who) in named else None
        needs[j] = len(who) if array else 1
        for antenna in who:
            for period in named[array or antenna]:
                first = math.ceil((period["TRX ON"] - begin) / step_s)
                view[first : math.floor((period["TRX OFF"] - begin) / step_s), antennas.index(antenna), j] = (
                    True
                )
        before, after = (_steps(60.0 * request[key], step_s) for key in ("setup_time", "teardown_time"))
        length[j] = before + served + after
        begins[:, :, [j]] = fitting_starts(view[:, :, [j]], np.array([served]), before)
    return DeepSpace(
        begins, step_s / 3600 * np.array([form[1] for form in forms]), length, needs, tuple(antennas),
        tuple(form[3] for form in forms), np.array([form[0] for form in forms]),
    )  # fmt: skip


def _steps(seconds: float, step_s: int) -> int:
    """Whole steps that have room for so many seconds."""
    return math.ceil(seconds / step_s - 1e-9)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("file", type=Path)
    parser.add_argument("--week")
    parser.add_argument(
        "--requests", type=int, nargs="+", default=[60, 160], help="how many of the first ones"
    )
    parser.add_argument(
        "--minutes", type=int, choices=(10, 15, 20, 30), default=30, help="of a step (default 30)"
    )
    parser.add_argument("--arrays", action="store_true")
    parser.add_argument("--seconds", type=float, default=20.0)


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "satnet", argv, add=add_options)
    step_s = 60 * run.options.minutes
    requests = read_week(run.options.file, run.options.week)
    if not run.options.arrays:
        requests = [r for r in requests if any("_" not in name for name in r["resource_vp_dict"])]
    rows = []
    for count in run.options.requests:
        space = space_of(requests[:count], run.options.arrays, step_s)
        problem = space.problem()
        common.warm(problem, DualDecomposition())
        wanted = sum(step_s / 3600 * _steps(3600 * float(r["duration"]), step_s) for r in requests[:count])
        run.say(
            f"{min(count, len(requests))} requests for {wanted:g} h: {problem}, {(space.needs > 1).sum()} by arrays"
        )
        for solver in (DualDecomposition(), HAA()):
            result = solve(problem, solver, time_limit=run.options.seconds)
            hours = space.hours_served(result.plan)
            run.say(f"  {hours:g} h served; {result}")
            rows.append({"requests": count, "wanted": wanted, "solver": solver.name, "hours": hours,
                         "value": result.value, "bound": result.bound, "gap": result.gap,
                         "status": result.status.value, "seconds": result.runtime})  # fmt: skip
    run.write_json({"rows": rows})


if __name__ == "__main__":
    main()
