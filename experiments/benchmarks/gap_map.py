"""Where the proven gap of `DualDecomposition` is wide, and whether plan or bound is at fault: one table over families.

    python -m experiments.benchmarks.gap_map [--only NAME ... | --wide] [--seeds 1] [--seed 0] [--seconds 60]
        [--exact 60] [--out FILE]

For every family: one run of --seconds, of which the trace tells the gap after 10, 60 and 300 s (as far as it went), the
phase in which the last better plan was found, and why the run ended. Beside it a copy small enough for
`Exact`, which gets --exact seconds: by how much the plan of a short run is below the optimum, and its bound above. If
the copy was not solved to the end, both are told against the best plan and the least bound that either method found,
so that they are what is lost at least. Kernels are compiled before.

The table is printed as markdown with the means over the seeds, the rows are in the JSON.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments import common
from experiments.benchmarks.output import finish
from experiments.benchmarks.ring import ring
from sapopt import SAP, solve
from sapopt.domains.instances import instance
from sapopt.dynamics import SwitchingCost
from sapopt.solvers import DualDecomposition, Exact
from sapopt.warming import warm_up

MARKS = (10, 60, 300)
"""Seconds after which the gap is told."""

COPY_SECONDS = 10.0
"""Time of `DualDecomposition` on a copy."""


PLANE = 18
"""Satellites of a plane of `constellation-mid`."""


@dataclass(frozen=True)
class Family:
    """Problems of one kind: at full size, and small enough to be solved to optimality."""

    full: Callable[[int], SAP]
    copy: Callable[[int], SAP]


def dense(n: int, m: int, steps: int, seed: int, *, forbidden: float = 0.0, cost: float = 0.5) -> SAP:
    """Benefits uniform on [0, 1], anew at every step; a share of the pairs is forbidden."""
    rng = np.random.default_rng(seed)
    benefits = rng.random((steps, n, m))
    if forbidden:
        benefits[rng.random(benefits.shape) < forbidden] = -np.inf
    return SAP(benefits, SwitchingCost(cost))


def slow(n: int, m: int, steps: int, seed: int, cost: float = 0.5) -> SAP:
    """Benefits that wander: random walks on [0, 1] with steps of 0.1."""
    rng = np.random.default_rng(seed)
    walk = rng.random((n, m)) + np.cumsum(rng.normal(0.0, 0.1, (steps, n, m)), axis=0)
    return SAP(1.0 - np.abs(1.0 - np.abs(walk) % 2.0), SwitchingCost(cost))


def metric(n: int, m: int, steps: int, seed: int) -> SAP:
    """Tasks are points of the unit square, a move costs the way between them."""
    rng = np.random.default_rng(seed)
    place = rng.random((m, 2))
    cost = np.linalg.norm(place[:, None] - place[None], axis=2)
    return SAP(rng.random((steps, n, m)), SwitchingCost(cost))


def named(name: str, small: dict[str, Any], **options: Any) -> Family:
    """An instance of the library, and the same with other options."""
    return Family(
        lambda seed: instance(name, seed, **options), lambda seed: instance(name, seed, **(options | small))
    )


def cut(name: str, steps: int, **options: Any) -> Family:
    """An instance of the library, and its first steps."""

    def first(seed: int) -> SAP:
        problem = instance(name, seed, **options)
        return SAP(problem.benefits.slice(0, steps), problem.dynamics, problem.initial_assignment)

    return Family(lambda seed: instance(name, seed, **options), first)


def orbit(**options: Any) -> Family:
    """`constellation-mid`, and over the whole orbit one of its planes with as many tasks for every satellite.

    What binds agents for long shows in a copy of all steps only, however few the agents are.
    """

    def plane(seed: int) -> SAP:
        whole = instance("constellation-mid", seed, **options)
        benefits = whole.benefits.dense()[:, :PLANE]
        seen = np.flatnonzero((benefits > 0.0).any(axis=(0, 1)))
        tasks = np.random.default_rng(seed).choice(seen, PLANE * whole.m // whole.n, replace=False)
        return SAP(benefits[:, :, np.sort(tasks)], whole.dynamics)

    return Family(lambda seed: instance("constellation-mid", seed, **options), plane)


FAMILIES: dict[str, Family] = {
    **{f"mid, cost {cost:g}": orbit(cost=cost) for cost in (0.1, 0.5, 1.0, 2.0, 4.0)},
    **{f"mid, idle free, cost {cost:g}": orbit(cost=cost, idle_is_free=True) for cost in (0.5, 2.0)},
    "large": cut("constellation-large", 6),
    "dense": Family(lambda seed: dense(60, 80, 40, seed), lambda seed: dense(9, 12, 20, seed)),
    "dense, n = m": Family(lambda seed: dense(60, 60, 40, seed), lambda seed: dense(9, 9, 20, seed)),
    "metric": Family(lambda seed: metric(60, 80, 40, seed), lambda seed: metric(6, 8, 20, seed)),
    "forbidden": Family(
        lambda seed: dense(60, 80, 40, seed, forbidden=0.3),
        lambda seed: dense(9, 12, 20, seed, forbidden=0.3),
    ),
    "slow": Family(lambda seed: slow(60, 80, 40, seed), lambda seed: slow(9, 12, 20, seed)),
    "tracking": named("tracking", {"planes": 12, "per_plane": 8, "resolution": 2, "steps": 8}),
    "power": cut("power", 8),
    "attitude": named("attitude", {"planes": 6, "per_plane": 6, "tasks": 60, "steps": 12}),
    "ride-hailing": named("ride-hailing", {"drivers": 8, "requests": 30, "steps": 20, "width": 5}),
    "unit-commitment": named("unit-commitment", {"units": 8, "steps": 20}),
    "multi-beam": cut("multi-beam", 3),
    "shells": cut("constellation-shells", 2),
    "ring, 30 000": Family(lambda seed: ring(30_000, 30_000, 6, seed=seed), lambda seed: ring(60, 60, 6, seed=seed)),
}  # fmt: skip
"""By name. The two of thousands of agents run only where they are asked for."""

ASKED_FOR = ("shells", "ring, 30 000")

WIDE = (
    "dense, n = m", "metric", "dense", "forbidden", "mid, cost 0.5", "mid, cost 1", "mid, cost 2",
    "mid, idle free, cost 2", "large", "tracking", "multi-beam",
)  # fmt: skip
"""Those whose gap was wide once, and the thesis' own experiment."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    common.add_seeds(parser)
    usual = [name for name in FAMILIES if name not in ASKED_FOR]
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--only", nargs="+", choices=list(FAMILIES), default=usual, metavar="NAME")
    which.add_argument(
        "--wide", action="store_const", dest="only", const=list(WIDE), help="only those whose gap was wide"
    )
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of DualDecomposition on the full problem"
    )
    parser.add_argument("--exact", type=float, default=60.0, help="of Exact on the copy; 0 leaves copies out")
    parser.add_argument("--out", help="file for the JSON")
    options = parser.parse_args()
    seeds = common.seeds_of(parser, options)
    rows = []
    for name in options.only:
        for seed in seeds:
            row = {"family": name, "seed": seed} | measured(FAMILIES[name], seed, options)
            rows.append(row)
            print(told(row), file=sys.stderr, flush=True)
    finish(
        {"seconds": options.seconds, "exact": options.exact, "table": table(rows), "rows": rows}, options.out
    )
    print(table(rows), file=sys.stderr)


def measured(family: Family, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """The figures of one problem and its copy, or why there are none."""
    problem = family.full(seed)
    row: dict[str, Any] = {"n": problem.n, "m": problem.m, "T": problem.T}
    try:
        row |= planned(problem, seed, options.seconds)
    except ValueError as error:
        return row | {"refused": str(error)}
    return row | (split(family.copy(seed), seed, options.exact) if options.exact else {})


def planned(problem: SAP, seed: int, seconds: float) -> dict[str, Any]:
    """Gap by the clock and how the run ended."""
    solver = DualDecomposition()
    warm_up(problem, solver)
    result = solve(problem, solver, seed=seed, time_limit=seconds)
    gaps = {}
    for mark in MARKS:
        known = [line["gap"] for line in result.trace if line["seconds"] <= mark and line["gap"] is not None]
        gaps[f"gap after {mark} s"] = min(known) if known and mark <= 1.05 * seconds else None
    better = [
        after for before, after in zip(result.trace, result.trace[1:], strict=False) if after["value"] > before["value"]
    ]  # fmt: skip
    last = better[-1] if better else result.trace[0]
    return gaps | {
        "value": result.value, "bound": result.bound, "gap": result.gap, "status": result.status.value,
        "seconds": result.runtime, "phase": result.trace[-1]["phase"], "last better plan": last["phase"],
        "last better plan after s": last["seconds"],
    }  # fmt: skip


def split(problem: SAP, seed: int, seconds: float) -> dict[str, Any]:
    """What plan and bound of a short run lose on a small problem, as shares of its optimum."""
    short = solve(problem, DualDecomposition(), seed=seed, time_limit=COPY_SECONDS)
    try:
        exact = solve(problem, Exact(), seed=seed, time_limit=seconds)
    except ValueError as error:
        return {"copy": f"{problem.n} x {problem.m} x {problem.T}", "not exact": str(error)}
    best = max(short.value, exact.value)
    least = min(math.inf if r.bound is None else r.bound for r in (short, exact))
    unit = max(abs(best), 1e-12)
    return {
        "copy": f"{problem.n} x {problem.m} x {problem.T}",
        "copy solved": least - best <= 1e-6 * unit,
        "plan below": (best - short.value) / unit,
        "bound above": None if short.bound is None else max(short.bound - least, 0.0) / unit,
        "unknown": (least - best) / unit if math.isfinite(least) else None,
    }


def told(row: dict[str, Any]) -> str:
    """A line for who waits."""
    if "refused" in row:
        return f"{row['family']}, seed {row['seed']}: refused: {row['refused']}"
    return (
        f"{row['family']}, seed {row['seed']}: {percent(row['gap'])} after {row['seconds']:.1f} s ({row['status']}), "
        f"last better plan by {row['last better plan']} after {row['last better plan after s']:.1f} s; copy: plan "
        f"{percent(row.get('plan below'))} below, bound {percent(row.get('bound above'))} above"
    )


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one line for every family."""
    head = [
        "family",
        "n x m x T",
        *(f"{mark} s" for mark in MARKS),
        "ended after",
        "copy",
        "plan",
        "bound",
        "unknown",
    ]
    lines = [" | ".join(head), " | ".join("---" for _ in head)]
    for family in dict.fromkeys(row["family"] for row in rows):
        own = [row for row in rows if row["family"] == family]
        cells = [family, "{n} x {m} x {T}".format(**own[0])]
        if "refused" in own[0]:
            cells += ["refused", *[""] * 7]
        else:
            cells += [percent(mean(own, f"gap after {mark} s")) for mark in MARKS]
            cells += [f"{mean(own, 'seconds'):.0f} s, {own[0]['status']}", own[0].get("copy", "")]
            cells += [percent(mean(own, key)) for key in ("plan below", "bound above", "unknown")]
        lines.append(" | ".join(cells))
    return "\n".join(f"| {line} |" for line in lines)


def mean(rows: list[dict[str, Any]], key: str) -> float | None:
    """Mean over the seeds, None where one of them has no figure."""
    known = [row[key] for row in rows if row.get(key) is not None]
    return float(np.mean(known)) if len(known) == len(rows) else None


def percent(share: float | None) -> str:
    """In three digits or so."""
    return "" if share is None else f"{100 * share:.2g} %"


if __name__ == "__main__":
    main()
