"""The power environment of Holder 2024, section 6.4: what policies and planners earn, and what nobody can.

    python -m experiments.power [--seeds 10] [--methods haa,dual-lookahead:3,...] [--quick] [--out DIR]

324 satellites on batteries, 450 tasks, 100 steps; every seed draws other tasks and another initial assignment. Methods
are those of the command line, and `power-constrained`, `energy-price`, `plan` and `plan-entries`: DualDecomposition
with a time limit of its own, under the rule that lets an idle satellite wait on its next task for free, and under the
one that charges every start of work. Runs are kept in DIR/power_runs.json; a second call does only what is missing.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments import common
from sapopt import solve
from sapopt.data.files import write_text
from sapopt.domains.instances import instance
from sapopt.solvers import AssignmentPolicy, DualDecomposition, energy_price, power_constrained
from sapopt.solvers.names import parse_solver

METHODS = (
    "haa", "haal:3", "haal-exact:3", "power-constrained", "energy-price", "dual-lookahead:3", "dual-lookahead:10",
    "dual-lookahead:30", "plan", "plan-entries",
)  # fmt: skip
QUICK = ("haa", "power-constrained", "energy-price", "dual-lookahead:3", "plan")


def solver_of(method: str) -> Any:
    """The solver that a name stands for."""
    if method.startswith("plan"):
        return DualDecomposition()
    generators = {"power-constrained": power_constrained, "energy-price": energy_price}
    return AssignmentPolicy(generators[method]) if method in generators else parse_solver(method).solver


def measure(method: str, seed: int, steps: int, limit: float) -> dict[str, Any]:
    """One run; planners are scored under both rules."""
    rule = "entries" if method == "plan-entries" else "moves"
    problem = instance("power", seed, steps=steps, pay_for=rule)
    other = instance("power", seed, steps=steps, pay_for="moves" if rule == "entries" else "entries")
    planner = method.startswith("plan")
    began = time.perf_counter(), time.process_time()
    result = solve(problem, solver_of(method), time_limit=limit if planner else None)
    return {
        "method": method, "seed": seed, "steps": steps, "value": result.value, "bound": result.bound,
        "gap": result.gap, "handovers": result.handovers, "value_under_other_rule": other.evaluate(result.plan).value,
        "seconds": time.perf_counter() - began[0], "cpu_seconds": time.process_time() - began[1],
        "load": os.getloadavg()[0],
    }  # fmt: skip


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--methods", help="names separated by commas; all by default")
    parser.add_argument("--steps", type=int, help="default 100, quick 30")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds for each run of the planner")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "power", argv, seeds=10, quick_seeds=1, add=add_options, resumes=True)
    options = run.options
    methods = options.methods.split(",") if options.methods else (QUICK if run.quick else METHODS)
    steps = options.steps or (30 if run.quick else 100)
    path = run.out / "power_runs.json"
    runs = json.loads(path.read_text()) if path.exists() else []
    if any(method not in METHODS for method in methods):
        for method in methods:
            solver_of(method)  # raises, and says which names there are
    # The first run of a method compiles what it needs.
    for seed in run.seeds:
        for method in methods:
            if any((r["method"], r["seed"], r["steps"]) == (method, seed, steps) for r in runs):
                continue
            runs.append(measure(method, seed, steps, options.limit))
            write_text(path, json.dumps(runs, indent=1))
            one = runs[-1]
            gap = "" if one["gap"] is None else f"  gap {100 * one['gap']:.3f} %"
            run.say(
                f"seed {seed} {method:18s} {one['value']:9.1f}{gap}  {one['cpu_seconds']:6.1f} s of one core"
            )
    table = {}
    for method in methods:
        mine = [r for r in runs if r["method"] == method and r["steps"] == steps]
        bounds = [r["bound"] for r in mine if r["bound"] is not None]
        table[method] = {
            "episodes": len(mine), "mean": float(np.mean([r["value"] for r in mine])),
            "std": float(np.std([r["value"] for r in mine])),
            "mean_bound": float(np.mean(bounds)) if bounds else None,
            "handovers": float(np.mean([r["handovers"] for r in mine])),
            "mean_under_other_rule": float(np.mean([r["value_under_other_rule"] for r in mine])),
        }  # fmt: skip
        bound = table[method]["mean_bound"]
        print(
            f"{method:18s} {table[method]['mean']:9.1f} +- {table[method]['std']:6.1f} over {len(mine):2d} episodes"
            + ("" if bound is None else f", bound {bound:9.1f}")
        )
    run.write_json({"table": table, "runs": runs})


if __name__ == "__main__":
    main()
