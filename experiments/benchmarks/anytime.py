"""Does every method return in time? Wall time over the time limit, for every method, size and limit.

    python -m experiments.benchmarks.anytime [--sizes mid large] [--limits 2 10 30] [--solvers ...] [--out FILE]

Kernels are compiled before, on the first steps of each instance: a limit counts from the call of `solve`, and what has
to be compiled in it counts too. Methods that are done before the limit tell nothing and are marked so. The target is
at most 10 % over.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments.benchmarks.output import keep
from sapopt import SAP, bound, solve
from sapopt.domains.instances import scenario
from sapopt.running.outlook import Policy
from sapopt.solvers import (
    CBBA,
    HAA,
    HAAL,
    HAALD,
    DistributedDualLookahead,
    DualDecomposition,
    DualLookahead,
    Exact,
    Greedy,
    NoHandover,
)

SIZES = {"toy": "constellation-toy", "mid": "constellation-mid", "large": "constellation-large"}
ALLOWED = 1.1


def methods(graphs: list[Any]) -> dict[str, Any]:
    """Every method by name; None is `bound`."""
    return {
        "no-handover": NoHandover(), "greedy": Greedy(), "haa": HAA(), "haal:6": HAAL(6), "haal:12": HAAL(12),
        "haal+:6": HAAL(6, keep_plan=True), "dual-lookahead:6": DualLookahead(6),
        "dual-lookahead:30": DualLookahead(30), "haal-d:3": HAALD(3, graph=graphs), "cbba:3": CBBA(3, graphs),
        "distributed-dual:6": DistributedDualLookahead(6, graph=graphs),
        "dual-decomposition": DualDecomposition(), "exact": Exact(), "bound": None,
    }  # fmt: skip


def warm_up(problem: SAP, chosen: dict[str, Any]) -> None:
    """Compile what the methods need."""
    small = SAP(problem.benefits.slice(0, 3), problem.dynamics)
    for solver in chosen.values():
        if solver is None:
            bound(small, time_limit=2.0)
        else:
            solve(small, solver, time_limit=None if isinstance(solver, Policy) else 3.0)


def measure(problem: SAP, solver: Any, limit: float) -> dict[str, Any]:
    """Wall time of one run."""
    began = time.perf_counter()
    if solver is None:
        proven = bound(problem, time_limit=limit)
        seconds = time.perf_counter() - began
        return {"seconds": seconds, "value": None, "bound": proven.value, "status": "time limit"}
    result = solve(problem, solver, time_limit=limit)
    seconds = time.perf_counter() - began
    return {"seconds": seconds, "value": result.value, "bound": result.bound, "status": result.status.value}


def main(show: Callable[[str], None] = print) -> None:
    """Measure, print a table, write JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", choices=list(SIZES), default=["mid", "large"])
    parser.add_argument("--limits", type=float, nargs="+", default=[2.0, 10.0, 30.0])
    parser.add_argument("--solvers", nargs="+", help="names; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for size in options.sizes:
        built = scenario(SIZES[size], options.seed)
        problem = built.problem()
        graphs = built.graphs()
        chosen = methods(graphs)
        if options.solvers:
            chosen = {name: chosen[name] for name in options.solvers}
        warm_up(problem, {name: methods(graphs[:3])[name] for name in chosen})
        for name, solver in chosen.items():
            for limit in options.limits:
                row = {"size": size, "solver": name, "limit": limit, "load": os.getloadavg()[0]}
                row |= measure(problem, solver, limit)
                row["over"] = row["seconds"] / limit
                rows.append(row)
                done = row["seconds"] < 0.98 * limit
                verdict = "done before" if done else "in time" if row["over"] <= ALLOWED else "TOO LATE"
                show(f"{size:6} {name:20} {limit:5.0f} s: {row['seconds']:7.2f} s  {verdict}")
                if done:
                    break  # longer limits tell nothing
    late = [row for row in rows if row["over"] > ALLOWED]
    show(f"{len(late)} of {len(rows)} runs more than 10 % late")
    if options.out:
        keep({"seed": options.seed, "rows": rows}, options.out)


if __name__ == "__main__":
    main()
