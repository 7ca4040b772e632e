"""HAAL, the dual lookahead and the whole-horizon bound on real Starlink element sets, with time and memory.

    python -m experiments.benchmarks.starlink [--instance starlink] [--tasks 4500 10000] [--steps 93] [--window 6]
        [--time-limit 300] [--seed 0] [--out FILE]

Satellites by SGP4 over a rotating Earth. Shares are those of the bound that `DualDecomposition` proves for the whole
horizon within the time limit. Kernels are compiled before the clock starts; the first step of a policy, which may meet
a cold cache, is not in its median.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from typing import Any

import numpy as np

from experiments.benchmarks.output import finish
from sapopt import solve
from sapopt.domains.instances import instance
from sapopt.solvers import HAAL, DualDecomposition, DualLookahead


def main() -> None:
    """Run every number of tasks, report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--instance", default="starlink", choices=["starlink", "constellation-shells"])
    parser.add_argument("--tasks", type=int, nargs="+", default=[4500, 10_000])
    parser.add_argument("--steps", type=int, default=93)
    parser.add_argument("--window", type=int, default=6, help="lookahead of both policies")
    parser.add_argument("--time-limit", type=float, default=300.0, help="seconds of DualDecomposition")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out")
    options = parser.parse_args()
    toy = instance("constellation-toy")
    for method in (HAAL(options.window), DualLookahead(options.window), DualDecomposition(rounds=2)):
        solve(toy, method, time_limit=20.0)
    rows = [run(options, tasks) for tasks in options.tasks]
    finish({"rows": rows}, options.out)


def run(options: argparse.Namespace, tasks: int) -> dict[str, Any]:
    """One number of tasks."""
    began = time.perf_counter()
    problem = instance(options.instance, seed=options.seed, steps=options.steps, tasks=tasks)
    row: dict[str, Any] = {
        "T": problem.T, "n": problem.n, "m": problem.m, "visible_pairs": len(problem.benefits.flat().data),
        "build_s": time.perf_counter() - began,
    }  # fmt: skip
    plan = solve(problem, DualDecomposition(), time_limit=options.time_limit)
    assert plan.bound is not None
    row["DualDecomposition"] = {
        "value": plan.value,
        "bound": plan.bound,
        "gap": plan.gap,
        "seconds": plan.runtime,
    }
    for name, policy in (("HAAL", HAAL(options.window)), ("DualLookahead", DualLookahead(options.window))):
        result = solve(problem, policy)
        steps = [record["seconds"] for record in result.trace][1:]
        row[name] = {
            "value": result.value, "share": result.value / plan.bound,
            "s_per_step_median": float(np.median(steps)), "s_per_step_max": float(np.max(steps)),
        }  # fmt: skip
    row["peak_memory_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(row), file=sys.stderr, flush=True)
    return row


if __name__ == "__main__":
    main()
