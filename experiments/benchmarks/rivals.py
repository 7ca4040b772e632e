"""What a user would pick instead, in the same run: one assignment, the relaxation, the whole horizon.

    python -m experiments.benchmarks.rivals [--quick] [--seconds 30] [--seed 0] [--out FILE]

* assign: our `assign` beside lapx' `lapmod` and scipy's dense solver, on a sparse random matrix (5 % of the pairs).
* relaxation: the bound that prices prove (`sapopt.bound`) beside the linear programme of the time-expanded network by
  HiGHS (simplex, interior point, HiPO where the wheel has it) and OR-Tools' PDLP (relative accuracy 1e-4).
* whole: `Exact` and `DualDecomposition` beside HiGHS on the network and OR-Tools' CP-SAT, with and without HAAL's plan
  as a start.

The problems are dense and random, a move costs 0.5. OR-Tools runs in a process of its own. Needs the extra `rivals`
(`pip install "sapopt[rivals]"`); what is not installed is left out, and the table says so.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linear_sum_assignment

from experiments.benchmarks.exact import run_cp_sat
from experiments.benchmarks.output import finish
from sapopt import SAP, SwitchingCost, bound, solve
from sapopt.data.assignment import assign
from sapopt.data.matrices import GainMatrix
from sapopt.formulations import network
from sapopt.formulations.highs import SolverError, maximise
from sapopt.solvers import HAAL, DualDecomposition, Exact
from sapopt.warming import warm_up

Row = dict[str, Any]

SIZES = {False: ((400, 500), (20, 24, 20)), True: ((60, 80), (6, 8, 6))}
"""Of the assignment (n, m), and of the problem (n, m, T); in full and quick."""


EXACT = ("4x4x6", "6x6x8", "8x10x12", "12x12x20")
"""Sizes of `Exact` beside plain HiGHS; the quick run leaves out the last two."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="tiny problems, a few seconds each")
    parser.add_argument("--seconds", type=float, default=30.0, help="time limit of every run")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="file for the JSON")
    options = parser.parse_args()
    seconds = min(options.seconds, 5.0) if options.quick else options.seconds
    (agents, tasks), (n, m, steps) = SIZES[options.quick]
    rng = np.random.default_rng(options.seed)
    problem = dense(n, m, steps, options.seed)
    warm_up(problem, Exact())
    warm_up(problem, DualDecomposition())
    bound(problem, time_limit=1.0)
    rows = [*assignments(rng.random((agents, tasks)) * (rng.random((agents, tasks)) < 0.05))]
    rows += relaxations(problem, seconds)
    rows += wholes(problem, seconds)
    for size in EXACT[: 2 if options.quick else None]:
        rows += small(size, options.seed, seconds)
    finish({"rows": rows, "table": table(rows)}, options.out)
    print(table(rows))


def dense(n: int, m: int, steps: int, seed: int) -> SAP:
    """Benefits uniform on [0, 1], a move costs 0.5."""
    return SAP(np.random.default_rng(seed).random((steps, n, m)), SwitchingCost(0.5))


def assignments(weights: np.ndarray) -> list[Row]:
    """One sparse assignment; the fastest of nine runs. All of them are worth the same, or the row says so."""
    n, m = weights.shape
    ours = GainMatrix.from_matrix(sp.csr_array(weights))
    # `lapmod` wants a square matrix of costs in which everybody finds a task: idle columns and rows without worth
    # would make it dense, so every agent gets one idle column and the tasks' rows are filled by free tasks.
    most = weights.max() + 1.0
    wide = sp.csr_array(
        sp.block_array(
            [[sp.csr_array(np.where(weights > 0, most - weights, 0.0)), sp.diags_array(np.full(n, most))],
             [sp.diags_array(np.full(m, most)), sp.csr_array(np.where(weights.T > 0, most, 0.0))]]
        )
    )  # fmt: skip
    wide.sort_indices()

    def by_lapmod() -> float:
        import lap

        _, x, _ = lap.lapmod(n + m, wide.data, wide.indptr, wide.indices)
        taken = x[:n] < m
        return float(weights[np.flatnonzero(taken), x[:n][taken]].sum())

    def by_scipy() -> float:
        rows, columns = linear_sum_assignment(weights, maximize=True)
        return float(weights[rows, columns].sum())

    ways: dict[str, Callable[[], float]] = {
        "sapopt `assign`": lambda: float(ours.value(assign(ours))),
        "lapx `lapmod`": by_lapmod,
        "scipy, dense": by_scipy,
    }
    return [timed("assign", name, way, times=9) for name, way in ways.items()]


def relaxations(problem: SAP, seconds: float) -> list[Row]:
    """The linear relaxation of the network; ours is the bound that prices prove."""
    programme = network.formulate(problem).programme()
    rows = [timed("relaxation", "sapopt `bound`", lambda: bound(problem, time_limit=seconds).value)]
    for solver in ("simplex", "ipm", "hipo"):

        def by_highs(name: str = solver) -> float:
            answer = maximise(programme, relaxed=True, seconds=seconds, options={"solver": name})
            if answer.x is None:
                raise RuntimeError("no solution in the time")
            return answer.value

        rows.append(timed("relaxation", f"HiGHS, {solver}", by_highs))
    parts = (programme.gain, programme.rows, programme.low, programme.high, programme.upper, programme.offset)
    rows.append({"part": "relaxation", "solver": "OR-Tools PDLP", **apart(run_pdlp, *parts, seconds)})
    return rows


def wholes(problem: SAP, seconds: float) -> list[Row]:
    """The whole horizon, with and without a plan to start from."""
    start = solve(problem, HAAL(3)).plan
    form = network.formulate(problem)
    rows = []
    for name, solver in (("sapopt `Exact`", Exact()), ("sapopt `DualDecomposition`", DualDecomposition())):
        for begun in (False, True):
            result = solve(problem, solver, time_limit=seconds, start=start if begun else None)
            rows.append(
                {"part": "whole", "solver": name + begun * ", started", "value": result.value, "bound": result.bound,
                 "seconds": result.runtime}
            )  # fmt: skip
    for begun in (False, True):
        began = time.perf_counter()
        answer = maximise(form.programme(), seconds=seconds, start=form.follow(start) if begun else None)
        rows.append(
            {"part": "whole", "solver": "HiGHS" + begun * ", started", "value": answer.value, "bound": answer.bound,
             "seconds": time.perf_counter() - began}
        )  # fmt: skip
    for begun in (False, True):
        hint = start if begun else None
        found = apart(run_cp_sat, problem.benefits.dense(), 0.5, seconds, hint)
        if "plan" in found:
            found["value"] = problem.evaluate(np.array(found.pop("plan"))).value
        rows.append({"part": "whole", "solver": "OR-Tools CP-SAT" + begun * ", hinted", **found})
    return rows


def small(size: str, seed: int, seconds: float) -> list[Row]:
    """`Exact` beside HiGHS on the plain network; the middle of three problems."""
    n, m, steps = map(int, size.split("x"))
    problems = [dense(n, m, steps, seed + more) for more in range(3)]

    def ours(problem: SAP) -> float:
        return solve(problem, Exact(), time_limit=seconds).value

    def plain(problem: SAP) -> float:
        return maximise(network.formulate(problem).programme(), seconds=seconds).value

    rows = []
    for name, way in (("sapopt `Exact`", ours), ("HiGHS", plain)):
        each = [timed(f"exact, {size}", name, partial(way, problem)) for problem in problems]
        middle = sorted(each, key=lambda row: float(row["seconds"]))[1]
        rows.append(middle | {"value": None})  # of another problem than the other solver's
    return rows


def timed(part: str, name: str, way: Callable[[], float], times: int = 1) -> Row:
    """A row: what a way finds, and the least wall-clock seconds of some runs; or why there is nothing."""
    seconds = []
    try:
        for _ in range(times):
            began = time.perf_counter()
            value = way()
            seconds.append(time.perf_counter() - began)
    except (ImportError, RuntimeError, SolverError) as error:
        return {"part": part, "solver": name, "status": f"not available: {error}"}
    return {"part": part, "solver": name, "value": value, "seconds": min(seconds)}


def apart(run: Callable[..., Row], *arguments: Any) -> Row:
    """What a function of this module finds in a fresh process: OR-Tools has a HiGHS of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(run, *arguments).result()


def run_pdlp(gain: Any, rows: Any, low: Any, high: Any, upper: Any, offset: float, seconds: float) -> Row:
    """OR-Tools' first-order method for linear programmes."""
    try:
        from ortools.pdlp import solvers_pb2
        from ortools.pdlp.python import pdlp
    except ImportError as error:
        return {"status": f"not available: {error}"}
    began = time.perf_counter()
    programme = pdlp.QuadraticProgram()
    programme.objective_vector = -gain
    programme.constraint_matrix = sp.csc_matrix(rows)
    programme.constraint_lower_bounds = np.asarray(low, dtype=float)
    programme.constraint_upper_bounds = np.asarray(high, dtype=float)
    programme.variable_lower_bounds = np.zeros(len(gain))
    programme.variable_upper_bounds = np.asarray(upper, dtype=float)
    wanted = solvers_pb2.PrimalDualHybridGradientParams()
    wanted.termination_criteria.time_sec_limit = seconds
    wanted.termination_criteria.simple_optimality_criteria.eps_optimal_relative = 1e-4
    wanted.termination_criteria.simple_optimality_criteria.eps_optimal_absolute = 1e-6
    found = pdlp.primal_dual_hybrid_gradient(programme, wanted)
    return {"value": offset + float(gain @ found.primal_solution), "seconds": time.perf_counter() - began}


def table(rows: list[Row]) -> str:
    """Markdown; times also as multiples of ours, the first row of a part."""
    lines = ["| part | solver | value | bound | seconds | times ours |", "|---|---|---|---|---|---|"]
    first: dict[str, float] = {}
    for row in rows:
        if "seconds" not in row:
            lines.append(f"| {row['part']} | {row['solver']} | {row.get('status', '')} | | | |")
            continue
        ours = first.setdefault(row["part"], row["seconds"])
        value, least = (f"{row[key]:.3f}" if row.get(key) is not None else "" for key in ("value", "bound"))
        lines.append(
            f"| {row['part']} | {row['solver']} | {value} | {least} | {row['seconds']:.4g} "
            f"| {row['seconds'] / ours:.2g} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
