"""What the plans of several seeds hold together: the best plan of their cells alone, over all steps at once.

    python -m experiments.benchmarks.merged_plans [--only NAME ...] [--seed 0] [--starts 6] [--seconds 8] [--merge 20]
        [--out FILE]

`DualDecomposition` runs --starts times from different seeds. Then the network of all cells that any of these plans uses
is solved, with --merge seconds. Where that finds nothing better than the best of them, further starts, and all that
recombines plans, have little to gain: what is left of the gap is rather the bound's.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import numpy as np

from experiments.benchmarks.gap_map import FAMILIES
from experiments.benchmarks.output import finish
from sapopt import SAP, solve
from sapopt.data.types import IntArray
from sapopt.solvers import DualDecomposition
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.flow_programme import solve_flow
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import RestrictedFlow
from sapopt.warming import warm_up


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    usual = ["dense", "forbidden", "dense, n = m"]
    families = [*usual, "metric", "slow"]
    parser.add_argument("--only", nargs="+", choices=families, default=usual, metavar="NAME")
    parser.add_argument("--seed", type=int, default=0, help="of the problem")
    parser.add_argument("--starts", type=int, default=6, help="runs, with seeds 0, 1, ...")
    parser.add_argument("--seconds", type=float, default=8.0, help="of each of them")
    parser.add_argument("--merge", type=float, default=20.0, help="seconds for the best plan of their cells")
    parser.add_argument("--out", help="file for the JSON")
    options = parser.parse_args()
    rows = []
    for name in options.only:
        row = {"family": name, "seed": options.seed}
        rows.append(row | merged(FAMILIES[name].full(options.seed), options))
        print(rows[-1], file=sys.stderr, flush=True)
    finish({"starts": options.starts, "seconds": options.seconds, "rows": rows}, options.out)


def merged(problem: SAP, options: argparse.Namespace) -> dict[str, Any]:
    """Gaps of the plans by themselves and of the best plan of their cells, against the least bound of all."""
    solver = DualDecomposition()
    warm_up(problem, solver)
    results = [
        solve(problem, solver, seed=seed, time_limit=options.seconds) for seed in range(options.starts)
    ]
    bound = min(result.bound for result in results if result.bound is not None)
    best = max(results, key=lambda result: result.value)
    flow = union(problem, [result.plan for result in results])
    began = time.monotonic()
    plan = solve_flow(flow, best.plan, problem.m, seconds=options.merge)
    took = time.monotonic() - began
    value = best.value if plan is None else max(best.value, problem.evaluate(plan).value)
    return {
        "gaps": [(bound - result.value) / bound for result in results], "merged": (bound - value) / bound,
        "arcs": len(flow.tail), "solved": took < 0.95 * options.merge, "merge seconds": took,
    }  # fmt: skip


def union(problem: SAP, plans: list[IntArray]) -> RestrictedFlow:
    """The network of every agent over the cells that any of the plans gives it."""
    arrays = Arrays.of(problem)
    benefits = problem.benefits.dense()
    moves = arrays.matrix if arrays.matrix.size else arrays.cost * (1.0 - np.eye(problem.m))
    cells: list[tuple[int, int, int]] = []
    arcs: list[tuple[int, int, float]] = []
    for i in range(problem.n):
        before: list[tuple[int, int]] = []
        for k in range(problem.T):
            here = []
            for j in sorted({int(plan[k, i]) for plan in plans}):
                number = len(cells)
                cells.append((i, k, j))
                here.append((number, j))
                if k == 0:
                    held = arrays.initial[i]
                    arcs.append((-1, number, benefits[k, i, j] - (moves[held, j] if held >= 0 else 0.0)))
                arcs.extend((tail, number, benefits[k, i, j] - moves[a, j]) for tail, a in before)
            before = here
    agent, step, task = np.array(cells, dtype=np.int64).T
    tail, head = np.array([arc[:2] for arc in arcs], dtype=np.int64).T
    return RestrictedFlow(agent, step, task, tail, head, np.array([arc[2] for arc in arcs]))


if __name__ == "__main__":
    main()
