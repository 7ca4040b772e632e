"""How close bound and plan of `DualDecomposition` come, against the clock.

    python -m experiments.benchmarks.gap constellation-mid --time-limit 60 [--seeds 3] [--seed 0] [--costs 0.1 2]

Kernels are compiled before the clock starts. Prints one JSON with value, bound and gap of every run, the times at which
the gap fell below some marks, and peak memory.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys

from experiments import common
from experiments.benchmarks.output import finish
from sapopt import SAP, solve
from sapopt.domains.instances import instance
from sapopt.solvers import HAAL, DualDecomposition

MARKS = (0.05, 0.02, 0.01, 0.005, 0.0025, 0.001)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("instance")
    parser.add_argument("--time-limit", type=float, default=60.0, help="seconds for each run")
    common.add_seeds(parser)
    parser.add_argument("--costs", type=float, nargs="+", default=[0.5])
    parser.add_argument("--haal", type=int, default=6, help="lookahead of the HAAL run beside it; 0 for none")
    parser.add_argument("--out")
    options = parser.parse_args()
    seeds = common.seeds_of(parser, options)
    warm = instance("constellation-toy")
    solve(warm, DualDecomposition(rounds=2), time_limit=20)
    rows = [run(options, seed, cost) for seed in seeds for cost in options.costs]
    finish({"rows": rows}, options.out)


def run(options: argparse.Namespace, seed: int, cost: float) -> dict[str, object]:
    problem: SAP = instance(options.instance, seed=seed, cost=cost)
    result = solve(problem, DualDecomposition(), time_limit=options.time_limit)
    reached = {}
    for mark in MARKS:
        times = [r["seconds"] for r in result.trace if r["gap"] is not None and r["gap"] <= mark]
        reached[f"{100 * mark:g} %"] = round(min(times), 1) if times else None
    row: dict[str, object] = {
        "instance": options.instance, "seed": seed, "cost": cost, "n": problem.n, "m": problem.m, "T": problem.T,
        "value": result.value, "bound": result.bound, "gap": result.gap, "seconds": result.runtime,
        "status": result.status.value, "gap_reached_after_s": reached,
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }  # fmt: skip
    if options.haal:
        row[f"HAAL L={options.haal}"] = solve(problem, HAAL(options.haal)).value
    print(json.dumps(row), file=sys.stderr, flush=True)
    return row


if __name__ == "__main__":
    main()
