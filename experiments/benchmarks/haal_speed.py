"""HAAL's time per step against plain Algorithm 2, in one run, on the same steps.

    python experiments/benchmarks/haal_speed.py [--sizes mid 1000 4225] [--lookahead 6] [--out FILE]

Plain Algorithm 2 solves every sequence of intervals from scratch on dense matrices with scipy, as the published code
does; a few steps of it are timed (one step takes minutes at 4225), and its assignments are compared with HAAL's.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from dataclasses import replace

import numpy as np
from plain import plain_step

from sapopt import SAP
from sapopt.control import Run
from sapopt.domains.instances import instance
from sapopt.outlook import rollout
from sapopt.solvers import HAAL

SIZES = {"mid": "constellation-mid", "1000": "constellation-large", "4225": "constellation-shells"}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--lookahead", type=int, default=6)
    parser.add_argument("--steps", type=int, default=20, help="steps HAAL is timed over")
    parser.add_argument("--plain-steps", type=int, default=0, help="plain steps timed; 0: 5 / 2 / 1 by size")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out")
    options = parser.parse_args()
    rows = [compare(size, options) for size in options.sizes]
    report = {"machine": platform.processor() or platform.machine(), "python": platform.python_version(),
              "lookahead": options.lookahead, "seed": options.seed, "rows": rows}  # fmt: skip
    print(json.dumps(report, indent=1))
    if options.out:
        with open(options.out, "w") as file:
            json.dump(report, file, indent=1)


def compare(size: str, options: argparse.Namespace) -> dict[str, object]:
    whole = instance(SIZES[size], seed=options.seed)
    steps = options.steps + options.lookahead
    problem = SAP(whole.benefits.slice(0, min(steps, whole.T)), whole.dynamics)
    solver = HAAL(options.lookahead)
    rollout(replace_horizon(problem, 2), solver)  # compile
    played = rollout(problem, solver, Run())
    per_step = [record["seconds"] for record in played.trace[1 : options.steps + 1]]

    count = options.plain_steps or {"mid": 5, "1000": 2, "4225": 1}[size]
    times, same = [], True
    for k in range(1, count + 1):
        stop = min(k + options.lookahead, problem.T)
        benefits = problem.benefits.slice(k, stop).dense()
        cost = float(problem.dynamics.cost)
        began = time.perf_counter()
        tasks = plain_step(benefits, cost, 0, options.lookahead, played.plan[k - 1], park=True)
        times.append(time.perf_counter() - began)
        same &= bool((tasks == played.plan[k]).all())
    return {
        "size": size, "n": problem.n, "m": problem.m,
        "haal_ms_per_step": 1e3 * float(np.mean(per_step)), "haal_ms_fastest": 1e3 * float(np.min(per_step)),
        "plain_ms_per_step": 1e3 * float(np.mean(times)), "ratio": float(np.mean(times) / np.mean(per_step)),
        "same_assignments": same,
    }  # fmt: skip


def replace_horizon(problem: SAP, steps: int) -> SAP:
    """The first steps of a problem."""
    return SAP(problem.benefits.slice(0, steps), replace(problem.dynamics))


if __name__ == "__main__":
    main()
