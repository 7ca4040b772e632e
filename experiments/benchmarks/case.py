"""One method over a list of problems of growing size, in a process of its own: times, peak memory, values, work.

    python -m experiments.benchmarks.case '{"method": "haal:6", "cap": 20, "problems": [{"n": 100, "m": 125, "T": 12}]}'

Times are those of the processor with one thread, so that a busy machine does not change them much; kernels are compiled
on a small problem before. A method stops at the first problem that takes more than `cap` seconds, and before one that
would take four times that by its own growth; `dual-decomposition` has `cap` as its time limit and goes through all of
them. A problem may name a method of its own.
Prints one JSON line for every problem. Peak memory is that of the process so far, so it belongs to the largest problem
until then.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

from experiments.benchmarks import peers
from experiments.benchmarks.ring import neighbours, ring
from sapopt import SAP, solve
from sapopt.formulations.dual import ascend
from sapopt.solvers import CBBA, HAA, HAAL, HAALD, DualDecomposition, DualLookahead, Greedy

DUAL_ITERATIONS = 40

Method = Callable[[SAP, float], dict[str, Any]]


def measured(solver: Any, problem: SAP, time_limit: float | None = None) -> dict[str, Any]:
    """`solve`, in processor time."""
    began = time.process_time()
    result = solve(problem, solver, time_limit=time_limit)
    seconds = time.process_time() - began
    last = result.trace[-1] if result.trace else {}
    return {
        "value": result.value, "bound": result.bound, "status": result.status.value, "seconds": seconds,
        "per_step": seconds / problem.T,
    } | {key: last[key] for key in ("assignment_problems", "rounds") if key in last}  # fmt: skip


def dual_bound(problem: SAP, cap: float) -> dict[str, Any]:
    """A fixed number of iterations of the Lagrangian dual."""
    began = time.process_time()
    oracle = problem.model.path_oracle(problem.benefits, None)
    found = ascend(oracle, max_iterations=DUAL_ITERATIONS)
    seconds = time.process_time() - began
    return {
        "value": None, "bound": found.bound, "status": "feasible", "seconds": seconds,
        "per_step": seconds / problem.T,
    }  # fmt: skip


def method(name: str, n: int) -> Method:
    """A method by name; ``name:number`` as on the command line."""
    kind, _, text = name.partition(":")
    number = int(text or 1)
    if kind in peers.ASSIGNERS:
        return lambda problem, cap: peers.assignments(kind, problem, cap)
    if kind in peers.WHOLE:
        return lambda problem, cap: peers.WHOLE[kind](problem, cap)
    if kind == "plain":
        return lambda problem, cap: peers.plain(problem, number)
    if kind == "dual-bound":
        return dual_bound
    if kind == "dual-decomposition":
        return lambda problem, cap: measured(DualDecomposition(threads=1), problem, cap)
    if kind in ("haal-d", "cbba"):
        graph = neighbours(n)
        chosen: Any = HAALD(number, graph=graph) if kind == "haal-d" else CBBA(number, graph)
    else:
        chosen = {
            "greedy": Greedy, "haa": HAA, "haal": lambda: HAAL(number),
            "dual-lookahead": lambda: DualLookahead(number),
        }[kind]()  # fmt: skip
    return lambda problem, cap: measured(chosen, problem)


def build(spec: dict[str, Any]) -> SAP:
    """The problem of a specification."""
    return ring(spec["n"], spec["m"], spec["T"], spec.get("visible", 5), spec.get("seed", 0))


def peak_mib() -> float:
    """Highest resident memory of this process so far, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


def main() -> None:
    """Run the case given as JSON."""
    case = json.loads(sys.argv[1])
    name, cap = case["method"], float(case["cap"])
    small = ring(12, 15, 8)
    method(name, 12)(small, 2.0)
    limited = name == "dual-decomposition"
    before: tuple[float, float] | None = None
    for spec in case["problems"]:
        pairs = float(spec["n"] * spec["T"] * spec.get("visible", 5))
        if before is not None and before[1] * (pairs / before[0]) > 4 * cap:
            break
        base = peak_mib()
        problem = build(spec)
        built = peak_mib()
        row = {"method": name, "pairs": pairs, **spec}
        row |= method(row["method"], spec["n"])(problem, cap)
        row |= {
            "peak_mib": peak_mib(),
            "peak_mib_before": base,
            "peak_mib_built": built,
            "load": os.getloadavg()[0],
        }
        print(json.dumps(row), flush=True)
        if limited:
            continue
        if row["seconds"] > cap:
            break
        before = pairs, row["seconds"]


if __name__ == "__main__":
    main()
