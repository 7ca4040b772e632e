"""The page itself: the template with its style, its scripts and the data, in one file."""

from __future__ import annotations

import html
import json
import math
import string
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from sapopt.data.files import write_text
from sapopt.problem.result import Result
from sapopt.problem.sap import SAP
from sapopt.report.data import payload

_SCRIPTS = ("core.js", "chart.js", "panels.js", "limits.js", "timeline.js", "stays.js", "map.js", "app.js")
_SLACK = 1e-6


def report(
    problem: SAP,
    results: Result | Mapping[str, Result],
    path: str | Path,
    *,
    scenario: Any = None,
    bound: float | None = None,
    prices: Any = None,
    title: str = "",
    force: bool = False,
) -> Path:
    """Write one HTML page about a problem and its results; it needs no network and nothing but a browser.

    Parameters
    ----------
    problem : SAP
    results : Result or mapping of str to Result
        One result, or several by name; the page compares them.
    path : str or Path
        The file to write.
    scenario : object, optional
        What the problem was made from. A `Constellation`, or anything with its ``positions_km`` and ``tasks``, gets a
        map of the world; other problems get the same page without it.
    bound : float, optional
        A proven upper bound; by default the tightest of the results' own.
    prices : ndarray, shape (T, m), optional
        Task prices for the heat map; by default those of the result with the tightest bound that has some.
    title : str
        Headline; by default the size of the problem.
    force : bool
        Overwrite a file that exists.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ValueError
        If there is no result, one of them or the scenario does not belong to the problem, or the file exists.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> from sapopt import SAP, solve
    >>> from sapopt.solvers import HAAL, Greedy
    >>> problem = SAP(np.random.default_rng(0).random((6, 3, 4)), 0.2)
    >>> results = {"greedy": solve(problem, Greedy()), "haal:3": solve(problem, HAAL(3))}
    >>> report(problem, results, tempfile.mkdtemp() + "/report.html").name
    'report.html'
    """
    path = Path(path)
    if not isinstance(problem, SAP):
        raise ValueError(
            f"problem must be a SAP, got {type(problem).__name__}; pass the problem that was solved"
        )
    if path.is_dir() or not path.parent.is_dir():
        raise ValueError(f"path: {path} is a folder, or lies in none; name a file in a folder that exists")
    named = {results.solver: results} if isinstance(results, Result) else dict(results)
    if not named:
        raise ValueError("results is empty; give at least one result of the problem")
    if path.exists() and not force:
        raise ValueError(f"path: {path} exists already; pass force=True to overwrite it, or another path")
    if bound is not None and not math.isfinite(bound):
        raise ValueError(f"bound must be a finite number, got {bound}; leave it out if nothing is proven")
    for name, result in named.items():
        _check(problem, str(name), result)
    known = [result.bound for result in named.values()] + [bound]
    tightest = min((b for b in known if b is not None), default=None)
    if prices is None:
        priced = [result for result in named.values() if result.prices is not None]
        best = min(priced, key=lambda r: math.inf if r.bound is None else r.bound, default=None)
        prices = None if best is None else best.prices
    if prices is not None:
        prices = np.asarray(prices, dtype=np.float64)
        columns = problem.model.price_columns(problem.n, problem.m)
        if prices.shape == (problem.T, columns):
            prices = prices[:, : problem.m]  # those of the places of copies are no prices of tasks
        if prices.shape != (problem.T, problem.m) or not np.isfinite(prices).all():
            raise ValueError(
                f"prices must be finite, of shape (T, m) = {(problem.T, problem.m)}, got {prices.shape}"
            )
    headline = title or f"{problem.n} agents, {problem.m} tasks, {problem.T} steps"
    data = payload(
        problem, {str(k): r for k, r in named.items()}, tightest, prices, scenario, headline, not title
    )
    write_text(path, _page(data))
    return path


def _check(problem: SAP, name: str, result: Result) -> None:
    """Refuse a result of another problem: its plan must fit, and be worth here what it says."""
    if not isinstance(result, Result):
        raise ValueError(
            f"results: {name!r} is a {type(result).__name__}, not a Result; pass what solve() returned"
        )
    try:
        value = problem.evaluate(result.plan).value
    except ValueError as error:
        raise ValueError(f"results: {name!r} is not a result of this problem ({error})") from None
    if not abs(value - result.value) <= _SLACK * max(1.0, abs(value)):
        raise ValueError(
            f"results: the plan of {name!r} is worth {value:.6g} in this problem and {result.value:.6g} in its own; "
            "pass the problem that was solved (the same seed and cost)"
        )


def _page(data: dict[str, Any]) -> str:
    folder = files("sapopt.report") / "assets"

    def asset(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    # "<" never appears in the JSON, so that no label can close the script element it stands in.
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return string.Template(asset("page.html")).substitute(
        title=html.escape(data["title"]),
        style=asset("style.css"),
        script="\n".join(asset(name) for name in _SCRIPTS),
        data=text,
    )
