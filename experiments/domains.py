"""The agent-local domains at full size: plans of every method against a proven bound (thesis, 7.1.1 to 7.1.3).

    python -m experiments.domains [--seeds 1] [--seconds 60] [--only NAME] [--quick] [--out results/domains]

For each of the instances `attitude`, `ride-hailing` and `unit-commitment`: the bound, and what HAA, HAAL, the dual
lookahead and the dual decomposition reach of it, with their times. The decomposition gets --seconds. The table is
printed and written as JSON. --quick takes smaller instances.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from experiments import common
from sapopt import SAP, Result, solve
from sapopt.domains.instances import instance
from sapopt.solvers import HAA, HAAL, DualDecomposition, DualLookahead, Greedy

INSTANCES: dict[str, dict[str, Any]] = {
    "attitude": {"steps": 20, "tasks": 150, "planes": 8, "per_plane": 10, "altitude_km": 900.0},
    "ride-hailing": {"drivers": 30, "requests": 150, "steps": 30, "width": 8},
    "unit-commitment": {"units": 16, "steps": 24},
}
"""Names, and the sizes of the quick run."""

POLICIES = (Greedy(), HAA(), HAAL(3), DualLookahead(3), DualLookahead(12))


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "domains", argv, seeds=1, quick_seeds=1, add=_options)
    seconds = run.options.seconds if run.options.seconds is not None else (10.0 if run.quick else 60.0)
    rows: list[dict[str, Any]] = []
    for name in run.options.only or INSTANCES:
        for seed in run.seeds:
            problem = instance(name, seed, **(INSTANCES[name] if run.quick else {}))
            run.say(f"{name}, seed {seed}: {problem}")
            rows += measure(name, seed, problem, seconds, run)
            # after every problem, so that an interrupted run leaves what it has
            run.write_json({"seconds_for_the_decomposition": seconds, "rows": rows})


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=float, help="time of the decomposition (default 60, quick 10)")
    parser.add_argument("--only", nargs="+", choices=list(INSTANCES), help="some of the instances")


def measure(name: str, seed: int, problem: SAP, seconds: float, run: common.Run) -> list[dict[str, Any]]:
    """Rows of one problem: the decomposition, whose bound counts for all, and the policies."""
    warm_up(problem)
    planned = solve(problem, DualDecomposition(), seed=seed, time_limit=seconds)
    if planned.bound is None:
        raise RuntimeError(f"{name}: no bound was proven within {seconds} s")
    rows = [_row(name, seed, problem, planned, planned.bound, run)]
    for policy in POLICIES:
        rows.append(_row(name, seed, problem, solve(problem, policy, seed=seed), planned.bound, run))
    return rows


def _row(name: str, seed: int, problem: SAP, result: Result, bound: float, run: common.Run) -> dict[str, Any]:
    if result.value > bound:
        raise RuntimeError(f"{name}: {result.solver} is worth {result.value}, above the bound {bound}")
    gap = (bound - result.value) / abs(bound)
    run.say(
        f"  {result.solver:26} value {result.value:14,.1f}  bound {bound:14,.1f}  gap {100 * gap:7.3f} %  "
        f"{result.runtime:6.1f} s"
    )
    return {
        "instance": name, "seed": seed, "T": problem.T, "n": problem.n, "m": problem.m, "solver": result.solver,
        "value": result.value, "bound": bound, "gap": gap, "handovers": result.handovers, "seconds": result.runtime,
    }  # fmt: skip


def warm_up(problem: SAP) -> None:
    """Compile on the first steps, so that no time contains it."""
    small = SAP(problem.benefits.slice(0, 3), problem.dynamics, problem.initial_assignment)
    for solver in (*POLICIES, DualDecomposition()):
        solve(small, solver, time_limit=3.0)


if __name__ == "__main__":
    main()
