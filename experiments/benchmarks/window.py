"""One certified step of a very large constellation: bound and plan of a window, with time and memory.

    python -m experiments.benchmarks.window [--planes 100] [--tasks 30000] [--window 6] [--iterations 80] [--out FILE]

Three Walker shells of ``planes x 100`` satellites and random tasks. The bound is proven for the problem of the window,
the value is that of a plan for it; kernels are compiled before the clock starts.
"""

from __future__ import annotations

import argparse
import resource
import time

from experiments.benchmarks.output import finish
from sapopt import solve
from sapopt.domains import constellation as c
from sapopt.domains.instances import instance
from sapopt.solvers import HAA, DualDecomposition
from sapopt.solvers.dual_decomposition import solver as planner


def main() -> None:
    """Build, solve, report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--planes", type=int, default=100)
    parser.add_argument("--tasks", type=int, default=30_000)
    parser.add_argument("--window", type=int, default=6)
    parser.add_argument("--iterations", type=int, default=80, help="dual iterations")
    parser.add_argument(
        "--repricing", type=int, default=0, help="dual iterations before every step of the plan"
    )
    parser.add_argument("--time-limit", type=float)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out")
    options = parser.parse_args()
    method = DualDecomposition(iterations=options.iterations, rounds=0, sweeps=0, repricing=options.repricing)
    large, planner._LARGE = planner._LARGE, 0  # so that the kernels of large problems are compiled too
    solve(instance("constellation-toy"), method)
    planner._LARGE = large
    began = time.perf_counter()
    shells = [
        c.WalkerShell(options.planes, 100, inclination, altitude)
        for inclination, altitude in ((53.0, 550.0), (53.2, 540.0), (70.0, 570.0))
    ]
    tasks = c.random_tasks(options.tasks, options.seed)
    problem = c.walker_constellation(shells, tasks, options.window, earth="still").problem(cost=0.5)
    built = time.perf_counter()
    cpu = time.process_time()
    result = solve(problem, method, time_limit=options.time_limit)
    cpu = time.process_time() - cpu
    report = {
        "seed": options.seed,
        "T": problem.T, "n": problem.n, "m": problem.m, "visible_pairs": len(problem.benefits.flat().data),
        "build_s": built - began, "wall_s": result.runtime, "cpu_s": cpu, "iterations": options.iterations,
        "value": result.value, "bound": result.bound, "gap": result.gap,
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "HAA": solve(problem, HAA()).value,
    }  # fmt: skip
    finish(report, options.out)


if __name__ == "__main__":
    main()
