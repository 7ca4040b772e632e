"""HAAL's time per step against plain Algorithm 2, in one run, on the same steps.

    python -m experiments.benchmarks.haal_speed [--sizes mid 1000 4225] [--lookahead 6] [--out FILE]

Plain Algorithm 2 solves every sequence of intervals from scratch on dense matrices with scipy, as the published code
does; a few steps of it are timed (one step takes minutes at 4225), and its assignments are compared with HAAL's.

Both run in one thread, HAAL by construction and scipy's assignment too, and in turn. Wall time is what a user waits;
on a machine with other work only the ratio of processor times is fair, for a long step is interrupted and a short one
is not. The seconds of compilation are those of a first run only; later ones find the kernels in numba's cache.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time

import numpy as np

from experiments.benchmarks.output import keep
from experiments.benchmarks.plain import plain_step
from sapopt import SAP
from sapopt.data.windows import WindowSums
from sapopt.domains.instances import instance
from sapopt.running.outlook import Outlook
from sapopt.solvers import HAAL

SIZES = {"mid": "constellation-mid", "1000": "constellation-large", "4225": "constellation-shells"}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--lookahead", type=int, default=6)
    parser.add_argument("--steps", type=int, default=20, help="steps HAAL is timed over")
    parser.add_argument("--plain-steps", type=int, default=0, help="plain steps timed; 0: 8 / 2 / 1 by size")
    parser.add_argument(
        "--repeats", type=int, default=3, help="runs of HAAL per plain step; plain ones on mid"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out")
    options = parser.parse_args()
    rows = [compare(size, options) for size in options.sizes]
    report = {"machine": platform.processor() or platform.machine(), "python": platform.python_version(),
              "cpus": os.cpu_count(), "load": os.getloadavg()[0],
              "lookahead": options.lookahead, "seed": options.seed, "rows": rows}  # fmt: skip
    print(json.dumps(report, indent=1))
    if options.out:
        keep(report, options.out)


def compare(size: str, options: argparse.Namespace) -> dict[str, object]:
    """One size: HAAL over the first steps and plain Algorithm 2 on some of them, in turn.

    Times are seconds of wall clock and of processor, for every step the least and the median of several runs.
    """
    whole = instance(SIZES[size], seed=options.seed)
    horizon = min(options.steps + options.lookahead, whole.T)
    problem = SAP(whole.benefits.slice(0, horizon), whole.dynamics)
    solver = HAAL(options.lookahead)
    began = time.perf_counter()
    play(SAP(problem.benefits.slice(0, 3), problem.dynamics), solver)
    compile_seconds = time.perf_counter() - began

    count = options.plain_steps or {"mid": 8, "1000": 2, "4225": 1}[size]
    timed = slice(1, horizon - options.lookahead + 1)  # full windows, and the costly first step left out
    runs: list[np.ndarray] = []
    plain: list[list[tuple[float, float]]] = []
    same = True
    for k in range(1, count + 1):
        for _ in range(options.repeats):
            plan, seconds, problems = play(problem, solver)
            runs.append(seconds[timed])
        benefits = problem.benefits.slice(k, min(k + options.lookahead, problem.T)).dense()
        cost = float(problem.dynamics.cost)
        plain.append([])
        for _ in range(options.repeats if size == "mid" else 1):
            began = clocks()
            tasks = plain_step(benefits, cost, 0, options.lookahead, plan[k - 1], park=True)
            plain[-1].append(clocks() - began)
        same &= bool((tasks == plan[k]).all())
    haal, slow = np.array(runs), np.array(plain).swapaxes(0, 1)  # (runs, steps, 2)
    row: dict[str, object] = {
        "size": size, "n": problem.n, "m": problem.m, "steps": haal.shape[1], "plain_steps": count,
        "assignment_problems_per_step": float(np.mean(problems[timed])),
        "compile_seconds": compile_seconds, "same_assignments": same,
    }  # fmt: skip
    for clock, index in (("wall", 0), ("processor", 1)):
        for name, pick in (("fastest", np.min), ("median", np.median)):
            ours, theirs = (1e3 * float(pick(t[:, :, index], axis=0).mean()) for t in (haal, slow))
            row[f"{clock}, {name}"] = {"haal_ms": ours, "plain_ms": theirs, "ratio": theirs / ours}
    return row


def clocks() -> np.ndarray:
    """Wall clock and processor time."""
    return np.array([time.perf_counter(), time.process_time()])


def play(problem: SAP, solver: HAAL) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Plan, seconds and assignment problems per step; what comes next is known, as in `rollout`."""
    windows = WindowSums(problem.benefits)
    memory = solver.begin(problem, np.random.default_rng(0))
    state = problem.initial_state()
    order = np.arange(problem.m)
    plan, seconds, problems = [], [], []
    for k in range(problem.T):
        windows.forget(before=k)
        solved = memory.assignment_problems
        began = clocks()
        tasks, memory = solver.act(Outlook(k, problem.T, state, problem, windows, order), memory)
        seconds.append(clocks() - began)
        problems.append(memory.assignment_problems - solved)
        plan.append(tasks)
        state = problem.transition(k, state, tasks)
    return np.array(plan), np.array(seconds), np.array(problems)


if __name__ == "__main__":
    main()
