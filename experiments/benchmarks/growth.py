"""How the time of a step grows with the number of visible pairs: HAAL and DualLookahead, with the fitted exponent.

    python -m experiments.benchmarks.growth [--sizes 324 600 ...] [--steps 5] [--seeds 1] [--quick] [--out FILE]

Walker constellations with as many random tasks as satellites; a satellite of a constellation twice as large sees twice
as many tasks, so the visible pairs grow with the square of the size. The time is processor time per step, the first
step left out, in one thread for both; kernels are compiled before. The exponent is the slope of a straight line through
the logarithms.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from typing import Any

import numba
import numpy as np

from experiments import common
from experiments.benchmarks.output import finish
from sapopt import SAP
from sapopt.data.windows import WindowSums
from sapopt.domains import constellation as c
from sapopt.domains.instances import instance
from sapopt.running.outlook import Outlook
from sapopt.solvers import HAAL, DualLookahead

SHELLS = {
    324: c.WalkerShell(18, 18, 58.0, 550.0),
    600: c.WalkerShell(25, 24, 58.0, 550.0),
    1000: c.WalkerShell(40, 25, 58.0, 550.0),
    2000: c.WalkerShell(50, 40, 58.0, 550.0),
    4225: c.STARLINK_SHELLS_4225,
}


def main() -> None:
    """Measure, fit, report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", type=int, nargs="+", choices=list(SHELLS), default=list(SHELLS))
    parser.add_argument("--window", type=int, default=6, help="lookahead of both")
    parser.add_argument("--steps", type=int, default=5, help="steps timed")
    common.add_seeds(parser)
    parser.add_argument("--quick", action="store_true", help="the two smallest sizes")
    parser.add_argument("--out")
    options = parser.parse_args()
    seeds = common.seeds_of(parser, options)
    numba.set_num_threads(1)
    sizes = options.sizes[:2] if options.quick else options.sizes
    policies = {"HAAL": HAAL(options.window), "DualLookahead": DualLookahead(options.window)}
    for policy in policies.values():
        step_seconds(instance("constellation-toy"), policy, 2)
    rows = []
    for seed in seeds:
        for size in sizes:
            steps = options.steps + options.window
            built = c.walker_constellation(SHELLS[size], c.random_tasks(size, seed), steps, earth="still")
            problem = built.problem(cost=0.5)
            row: dict[str, Any] = {
                "seed": seed, "n": problem.n, "m": problem.m,
                "visible_pairs_per_step": len(problem.benefits.flat().data) / steps,
            }  # fmt: skip
            for name, policy in policies.items():
                row[name] = step_seconds(problem, policy, options.steps)
            row["peak_memory_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(json.dumps(row), file=sys.stderr, flush=True)
            rows.append(row)
    pairs = np.log([row["visible_pairs_per_step"] for row in rows])
    report = {
        "window": options.window,
        "exponents": {
            name: float(np.polyfit(pairs, np.log([row[name]["cpu_s_median"] for row in rows]), 1)[0])
            for name in policies
        },
        "rows": rows,
    }  # fmt: skip
    finish(report, options.out)


def step_seconds(problem: SAP, policy: Any, steps: int) -> dict[str, float]:
    """Processor and wall seconds of the steps after the first."""
    windows = WindowSums(problem.benefits)
    memory = policy.begin(problem, np.random.default_rng(0))
    state = problem.initial_state()
    parking = np.arange(problem.m)
    cpu, wall = [], []
    for k in range(steps + 1):
        windows.forget(before=k)
        outlook = Outlook(k, windows.end, state, problem, windows, parking)
        began = time.process_time(), time.perf_counter()
        tasks, memory = policy.act(outlook, memory)
        cpu.append(time.process_time() - began[0])
        wall.append(time.perf_counter() - began[1])
        state = problem.transition(k, state, tasks)
    return {
        "cpu_s_median": float(np.median(cpu[1:])), "cpu_s_max": float(np.max(cpu[1:])),
        "wall_s_median": float(np.median(wall[1:])),
    }  # fmt: skip


if __name__ == "__main__":
    main()
