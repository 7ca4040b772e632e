"""The benchmark's rows as exponents, tables, a picture and a page."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from experiments import common

Rows = list[dict[str, Any]]


def good(rows: Iterable[dict[str, Any]]) -> Rows:
    """Rows of runs that came to an end."""
    return [row for row in rows if "failed" not in row and row.get("seconds") is not None]


def by_method(rows: Iterable[dict[str, Any]]) -> dict[str, Rows]:
    """Rows of every method."""
    out: dict[str, Rows] = defaultdict(list)
    for row in good(rows):
        out[row["method"]].append(row)
    return dict(out)


def exponents(groups: dict[str, Rows]) -> dict[str, dict[str, float]]:
    """Growth exponents: the slope of log time against log size, over the upper half of the sizes (three at least).

    For n and the peers against the visible pairs of a step, for T against T, for the density against the tasks in view.
    """
    size: dict[str, Callable[[dict[str, Any]], float]] = {
        "n": lambda row: row["pairs"] / row["T"],
        "alpha": lambda row: row["pairs"] / row["T"],
        "T": lambda row: row["T"],
        "visible": lambda row: row["visible"],
    }
    out: dict[str, dict[str, float]] = {}
    for group, of in size.items():
        out[group] = {}
        for method, rows in by_method(groups.get(group, [])).items():
            # the whole horizon's time grows with T by itself; a policy's is per step
            key = "seconds" if group == "T" and method.startswith("dual-bound") else "per_step"
            timed = [(of(row), row[key]) for row in rows]
            # a method that uses up its time has no growth of its own
            if len(timed) < 3 or any(row["status"] == "time limit" for row in rows):
                continue
            upper = timed[-max(3, len(timed) // 2 + 1) :]
            x, y = np.log(np.array(upper)).T
            out[group][method] = round(float(np.polyfit(x, y, 1)[0]), 2)
    return out


def best_bounds(rows: Rows) -> dict[tuple[Any, ...], float]:
    """The best bound that any method has for each problem."""
    out: dict[tuple[Any, ...], float] = {}
    for row in good(rows):
        if row.get("bound") is not None:
            out[problem(row)] = min(row["bound"], out.get(problem(row), np.inf))
    return out


def problem(row: dict[str, Any]) -> tuple[Any, ...]:
    """What makes a problem."""
    return row["n"], row["m"], row["T"], row.get("visible", 5), row.get("seed", 0)


def time_text(seconds: float) -> str:
    """A time to three digits."""
    for unit, scale in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def table(header: list[str], lines: list[list[str]]) -> str:
    """A Markdown table."""
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join("| " + " | ".join(line) + " |" for line in [header, rule, *lines])


def pivot(
    rows: Rows, key: str, cell: Callable[[dict[str, Any]], str], last: dict[str, float] | None = None
) -> str:
    """One line a method, one column for every value of `key`."""
    columns = sorted({row[key] for row in good(rows)})
    lines = []
    for method, own in by_method(rows).items():
        cells = {row[key]: cell(row) for row in own}
        line = [f"`{method}`", *[cells.get(value, "") for value in columns]]
        if last is not None:
            line.append(f"{last[method]:.2f}" if method in last else "")
        lines.append(line)
    header = [f"{key} =", *[f"{value:,}" for value in columns]] + (["exponent"] if last is not None else [])
    return table(header, lines)


def ratios(rows: Rows, ours: str) -> str:
    """Times of the peers as multiples of ours, by n."""
    base = {problem(row): row["per_step"] for row in good(rows) if row["method"] == ours}
    return pivot(
        [row for row in good(rows) if problem(row) in base],
        "n",
        lambda row: (
            time_text(row["per_step"])
            if row["method"] == ours
            else f"{row['per_step'] / base[problem(row)]:.3g} x"
        ),
    )


def page(result: dict[str, Any]) -> str:
    """docs/benchmark_results.md."""
    groups, fitted, environment = result["groups"], result["exponents"], result["environment"]
    bounds = best_bounds([row for rows in groups.values() for row in rows])

    def share(row: dict[str, Any]) -> str:
        top = bounds.get(problem(row))
        return "" if row.get("value") is None or not top else f"{100 * row['value'] / top:.1f} %"

    def seconds(row: dict[str, Any]) -> str:
        return time_text(row["per_step"])

    def memory(row: dict[str, Any]) -> str:
        return f"{row['peak_mib']:,.0f}"

    loads = [row["load"] for rows in groups.values() for row in good(rows)]
    missing = [
        f"`{name}`"
        for name in ("n", "m", "T", "L", "visible", "alpha", "algorithm2", "whole")
        if not groups.get(name)
    ]
    parts = [
        "# Benchmark results",
        f"""Made by `python -m experiments.benchmarks{" --quick" if result["options"]["quick"] else ""} --docs`.
Agents drift past tasks on a ring (`experiments/benchmarks/ring.py`) and see a few of them at a
time, so n, m, T and the number of visible pairs can grow one by one. Each method runs in a process of its own and
goes no further once a problem takes {result["cap"]:g} s; that is also the time limit of `dual-decomposition`.
Times are processor time with one thread, without compilation; for policies it is the time of all steps over their
number. Only the solvers of the whole horizon run in parallel and are timed by the wall clock. {environment["cores"]}
cores, {environment["platform"]}, Python {environment["python"]}. The load was {min(loads):.1f} to {max(loads):.1f}. A
load above the number of cores means that the machine was busy with other work. Wall-clock times, and what
`dual-decomposition` finds within its limit, are then worse than they need be; the ratios are more reliable.""",
        f"Not in this run: the groups {', '.join(missing)}." if missing else "",
        "![Time, memory and value against size](images/benchmarks.png)",
    ]
    if groups.get("n"):
        rows = groups["n"]
        parts += [
            "## The number of agents (m = 1.25 n, T = 12, 5 tasks in view)",
            "Time per step; the exponent is that of the visible pairs.",
            pivot(rows, "n", seconds, fitted["n"]),
            "Value, as a share of the best bound that any method proved for the problem:",
            pivot([row for row in good(rows) if row.get("value") is not None], "n", share),
            "Peak memory of the process, MiB (Python, libraries and the compiled kernels take about 200):",
            pivot(rows, "n", memory),
        ]
    titles = {
        "T": "The number of steps (exponent of T; `dual-bound`: of the whole, else per step)",
        "visible": "Tasks in view (time per step, exponent of their number)",
    }
    for key, title in titles.items():
        if groups.get(key):
            parts += [f"## {title}", pivot(groups[key], key, seconds, fitted[key])]
    if groups.get("m"):
        parts += [
            "## The number of tasks",
            pivot(groups["m"], "m", seconds),
            pivot([row for row in good(groups["m"]) if row.get("value") is not None], "m", share),
        ]
    if groups.get("L"):
        rows = [
            row | {"method": row["method"].split(":")[0], "L": int(row["method"].split(":")[1])}
            for row in good(groups["L"])
        ]
        parts += [
            "## The lookahead (time per step, value)",
            pivot(rows, "L", seconds),
            pivot(rows, "L", share),
        ]
    if groups.get("alpha"):
        parts += [
            "## One assignment problem, and the peers",
            "Ours also assigns the idle agents. Each of the others gets its data in its own best form, "
            "prepared before the clock starts.",
            ratios(groups["alpha"], "assign-sapopt"),
        ]
    if groups.get("algorithm2"):
        parts.append("## HAAL and plain Algorithm 2 (every sequence from scratch, dense, scipy)")
        for lookahead in (3, 6):
            rows = [row for row in good(groups["algorithm2"]) if row["method"].endswith(f":{lookahead}")]
            parts.append(ratios(rows, f"haal:{lookahead}"))
    if groups.get("whole"):
        parts += [
            "## The whole horizon, exactly (T = 8)",
            pivot(
                groups["whole"],
                "n",
                lambda row: (
                    f"{time_text(row['seconds'])}, {row['status']}"
                    + (
                        f", gap {100 * (row['bound'] / row['value'] - 1):.2g} %"
                        if row["status"] != "optimal"
                        else ""
                    )
                ),
            ),
        ]
    failed = [
        f"- `{row['method']}`: {row['failed']}" for rows in groups.values() for row in rows if "failed" in row
    ]
    if failed:
        parts += ["## What failed", "\n".join(failed)]
    return "\n\n".join(part for part in parts if part) + "\n"


def picture(result: dict[str, Any]) -> Figure:
    """Six panels: time, memory and value against n; time against lookahead and steps; the peers."""
    groups = result["groups"]
    bounds = best_bounds([row for rows in groups.values() for row in rows])
    figure, axes = common.new_figure(14.0, 7.4, 2, 3)
    ordered = [groups.get("n", []), *groups.values()]
    names = dict.fromkeys(row["method"].split(":")[0] for rows in ordered for row in good(rows))
    style = {name: {"color": f"C{at % 10}", "ls": "-" if at < 10 else "--"} for at, name in enumerate(names)}

    def draw(
        ax: Any, rows: Rows, key: str, of: Callable[[dict[str, Any]], float | None], title: str, log: bool
    ) -> None:
        for method, own in by_method(rows).items():
            points = [(row[key], of(row)) for row in own if of(row) is not None]
            if points:
                own_style = style[method.split(":")[0]]
                if method == "haal:3":
                    own_style = own_style | {"ls": ":"}
                ax.plot(
                    *zip(*points, strict=True),
                    marker="o",
                    markersize=3,
                    linewidth=1.2,
                    label=method,
                    **own_style,
                )
        ax.set_title(title, fontsize=10)
        ax.set_xlabel(key)
        if key == "L":
            ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        else:
            ax.set_xscale("log")
        if log:
            ax.set_yscale("log")
        ax.set_visible(ax.has_data())
        if ax.has_data():
            ax.legend(
                fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, borderaxespad=0.2
            )
        ax.grid(alpha=0.3)

    def share(row: dict[str, Any]) -> float | None:
        top = bounds.get(problem(row))
        return None if row.get("value") is None or not top else 100 * row["value"] / top

    lookahead = [
        row | {"method": row["method"].split(":")[0], "L": int(row["method"].split(":")[1])}
        for row in good(groups.get("L", []))
    ]
    rows = groups.get("n", [])
    draw(axes[0, 0], rows, "n", lambda row: row["per_step"], "seconds per step", True)
    draw(axes[0, 1], rows, "n", lambda row: row["peak_mib"], "peak memory, MiB", False)
    draw(axes[0, 2], rows, "n", share, "value, % of the best bound", False)
    draw(
        axes[1, 0],
        lookahead,
        "L",
        lambda row: row["per_step"],
        "seconds per step against the lookahead",
        True,
    )
    draw(
        axes[1, 1],
        groups.get("T", []),
        "T",
        lambda row: row["seconds"],
        "seconds in all against the steps",
        True,
    )
    draw(
        axes[1, 2],
        groups.get("alpha", []),
        "n",
        lambda row: row["seconds"],
        "one assignment problem, seconds",
        True,
    )
    return figure
