"""Records, tables and figures of the commands."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from sapopt.cli.output import Output, as_json, figure
from sapopt.problem.result import Result
from sapopt.problem.sap import SAP

_HISTORY_LINES = 3


def environment() -> dict[str, Any]:
    """What a figure depends on besides the problem."""
    packages = {name: version(name) for name in ("sapopt", "numpy", "scipy", "numba")}
    return {"python": platform.python_version(), "platform": platform.platform(), **packages}


def problem_record(name: str, problem: SAP) -> dict[str, Any]:
    """Name, size and dynamics of a problem."""
    return {
        "instance": name,
        "agents": problem.n,
        "tasks": problem.m,
        "steps": problem.T,
        "dynamics": repr(problem.dynamics),
        "fingerprint": problem.fingerprint,
    }


def result_record(result: Result, bound: float | None) -> dict[str, Any]:
    """What a result says, as plain values; `share` and `gap` are measured against `bound`."""
    proven = result if bound is None else result.with_bound(bound)
    best = proven.bound
    return {
        "value": result.value,
        "bound": best,
        "share": result.value / best if best else None,
        "gap": proven.gap,
        "handovers": result.handovers,
        "paid_handovers": result.evaluation.paid_handovers,
        "switches": result.evaluation.switches,
        "benefit": float(result.evaluation.benefit.sum()),
        "handover": float(result.evaluation.handover.sum()),
        "seconds": result.runtime,
        "seconds_per_step": result.runtime / len(result.plan),
        "status": result.status.value,
        "solver": result.solver,
        "seed": result.seed,
    }


def results_table(records: Mapping[str, dict[str, Any]]) -> Table:
    """The comparison of solvers as a table; the best value is set in bold."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("solver")
    for column in ("value", "share of bound", "handovers", "s/step", "gap"):
        table.add_column(column, justify="right")
    best = max((record["value"] for record in records.values()), default=None)
    for name, record in records.items():
        marks = {"time limit": " (time limit)", "interrupted": " (interrupted)"}
        table.add_row(
            name + marks.get(record["status"], ""),
            f"{record['value']:,.1f}",
            _percent(record["share"]),
            f"{record['handovers']:,}",
            f"{record['seconds_per_step']:.3g}",
            _percent(record["gap"]),
            style="bold" if record["value"] == best else None,
        )
    return table


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.2f} %"


def print_json(value: Any) -> None:
    """Print strict JSON to stdout."""
    print(as_json(value))


def print_table(table: Table, *lines: str, title: str = "") -> None:
    """Print to stdout; wide enough for every column when it is not a terminal."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=max(console.width, 110))
    if title:
        console.print(title, style="bold", markup=False, soft_wrap=True)
    console.print(table)
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)


def compare_figures(
    output: Output, problem: SAP, results: Mapping[str, Result], bound: float | None, agent: int
) -> None:
    """``compare.png``: value against the bound. ``history.png``: what one agent gains, step by step."""
    if output.folder is None or not results:
        return
    from sapopt import plotting

    drawing, ax = figure(7.2, 0.42 * len(results) + 1.3)
    plotting.value_against_bound({name: result.value for name, result in results.items()}, bound, ax)
    output.png("compare.png", drawing)
    drawing, ax = figure(8.0, 3.8)
    plotting.benefit_history(problem, _spread(results), agent, ax)
    output.png("history.png", drawing)


def _spread(results: Mapping[str, Result]) -> dict[str, Result]:
    """At most three results, from the worst to the best, so that their lines can be told apart."""
    ranked = sorted(results, key=lambda name: results[name].value)
    chosen = np.unique(np.linspace(0, len(ranked) - 1, _HISTORY_LINES).round().astype(int))
    return {ranked[k]: results[ranked[k]] for k in chosen}


def solve_figures(output: Output, problem: SAP, name: str, result: Result, agent: int) -> None:
    """``history.png``, ``timeline.png``, and ``gap.png`` where the solver proved bounds on its way."""
    if output.folder is None:
        return
    from sapopt import plotting

    drawing, ax = figure(8.0, 3.4)
    plotting.benefit_history(problem, {name: result}, agent, ax)
    output.png("history.png", drawing)
    drawing, ax = figure(9.0, 0.13 * min(problem.n, 40) + 1.6)
    plotting.timeline(problem, result, ax=ax)
    output.png("timeline.png", drawing)
    if any(record.get("bound") is not None for record in result.trace):
        drawing, ax = figure(7.2, 3.6)
        plotting.gap_trace(result, ax)
        output.png("gap.png", drawing)
