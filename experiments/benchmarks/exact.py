"""The exact solver beside OR-Tools CP-SAT, on dense random problems with cost 0.5, in one run.

    python -m experiments.benchmarks.exact [--sizes 12x15x12 20x24x20] [--seconds 300] [--seed 0] [--out FILE]

Sizes are n x m x T. Both get the same time, one after the other. CP-SAT (optional: pip install ortools)
is given the same network as the exact solver, before any reduction: circuits are not needed, since an agent's path
is a flow.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from experiments.benchmarks.output import keep
from sapopt import SAP, SwitchingCost, solve
from sapopt.formulations import network
from sapopt.formulations.highs import maximise
from sapopt.solvers.exact import Exact

SCALE = 10**6
"""CP-SAT knows integers only: benefits in millionths."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", default=["12x15x12", "20x24x20"])
    parser.add_argument("--seconds", type=float, default=300.0, help="time limit of each solver")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plain", action="store_true", help="also plain HiGHS on the whole network")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    warm_up()
    rows: list[dict[str, Any]] = []
    for size in options.sizes:
        n, m, T = map(int, size.split("x"))
        problem = SAP(np.random.default_rng(options.seed).random((T, n, m)), SwitchingCost(0.5))
        contestants = {"sapopt": ours, "CP-SAT": cp_sat} | ({"plain HiGHS": plain} if options.plain else {})
        for name, contestant in contestants.items():
            row = {"size": size, "solver": name, **contestant(problem, options.seconds)}
            rows.append(row)
            if "value" in row:
                row["gap"] = (row["bound"] - row["value"]) / abs(row["bound"])
                print(
                    f"{size:10} {name:12} value {row['value']:10.4f}  bound {row['bound']:10.4f}  "
                    f"gap {100 * row['gap']:7.4f} %  {row['seconds']:7.1f} s  {row['status']}",
                    flush=True,
                )
            else:
                print(f"{size:10} {name:12} {row['status']}")
    report = {"machine": platform.processor() or platform.machine(), "cores": os.cpu_count(), "rows": rows}
    if options.out:
        keep(report, options.out)


def warm_up() -> None:
    """Compile the kernels, so that the first size does not pay for it."""
    solve(SAP(np.random.default_rng(0).random((10, 10, 12)), SwitchingCost(0.5)), Exact(), time_limit=20.0)


def ours(problem: SAP, seconds: float) -> dict[str, Any]:
    """`Exact()`."""
    result = solve(problem, Exact(), time_limit=seconds)
    return {
        "value": result.value,
        "bound": result.bound,
        "seconds": result.runtime,
        "status": result.status.value,
    }


def plain(problem: SAP, seconds: float) -> dict[str, Any]:
    """HiGHS on the whole network."""
    began = time.perf_counter()
    answer = maximise(network.formulate(problem).programme(), seconds=seconds)
    return {
        "value": answer.value, "bound": answer.bound, "seconds": time.perf_counter() - began,
        "status": answer.ending.value,
    }  # fmt: skip


def cp_sat(problem: SAP, seconds: float) -> dict[str, Any]:
    """CP-SAT in a fresh process: its copy of HiGHS and highspy's do not get along in one."""
    switching = problem.model.switching()
    assert switching is not None
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        answer = pool.submit(run_cp_sat, problem.benefits.dense(), switching.uniform_cost, seconds).result()
    if "plan" in answer:
        answer["value"] = problem.evaluate(np.array(answer.pop("plan"))).value
    return answer


def run_cp_sat(
    benefits: np.ndarray, price: float, seconds: float, hint: np.ndarray | None = None
) -> dict[str, Any]:
    """CP-SAT with its portfolio of eight workers, on who holds what and who kept it; `hint` is a plan (T, n)."""
    try:
        from ortools.sat.python import cp_model
    except ImportError as error:
        return {"status": f"not available ({error}); pip install ortools"}
    began = time.perf_counter()
    T, n, m = benefits.shape
    worth = np.rint(benefits * SCALE).astype(int)
    cost = int(price * SCALE)
    model = cp_model.CpModel()
    x = [[[model.new_bool_var("") for _ in range(m)] for _ in range(n)] for _ in range(T)]
    terms, gains = [], []
    for k in range(T):
        for i in range(n):
            model.add_exactly_one(x[k][i])
            terms += x[k][i]
            gains += worth[k, i].tolist()
        for j in range(m):
            model.add_at_most_one(x[k][i][j] for i in range(n))
    for k in range(1, T):
        for i in range(n):
            for j in range(m):
                kept = model.new_bool_var("")
                model.add_implication(kept, x[k][i][j])
                model.add_implication(kept, x[k - 1][i][j])
                terms.append(kept)
                gains.append(cost)
    model.maximize(cp_model.LinearExpr.weighted_sum(terms, gains) - cost * n * (T - 1))
    if hint is not None:
        for k in range(T):
            for i in range(n):
                for j in range(m):
                    model.add_hint(x[k][i][j], bool(hint[k, i] == j))
    solver = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = seconds
    # its portfolio wants eight workers, whatever the machine
    solver.parameters.num_workers = max(8, os.cpu_count() or 1)
    solver.parameters.linearization_level = 2
    status = solver.solve(model)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return {"status": solver.status_name(status)}
    plan = np.array(
        [[max(range(m), key=lambda j: solver.value(x[k][i][j])) for i in range(n)] for k in range(T)]
    )
    slack = 0.5 * (2 * n * T) / SCALE  # rounding of the benefits
    return {
        "plan": plan.tolist(), "bound": solver.best_objective_bound / SCALE + slack,
        "seconds": time.perf_counter() - began, "status": solver.status_name(status).lower(),
    }  # fmt: skip


if __name__ == "__main__":
    main()
