"""Stochastic transitions: policies on satellites that fail, or whose sunlight is random (Holder 2024, 5.1 and 7.3).

    python -m experiments.chance [--runs 20] [--instance power-failing] [--steps 100] [--quick] [--out results/chance]

The thesis names stochastic problems and shows none; the instances are ours (`sapopt.domains.chance`). Every policy
meets the same luck in each run, so differences are paired; +- is a standard error. `plan` is the plan that the dual
lookahead makes for the deterministic problem, executed whatever happens. Where satellites fail, the bound is the mean
over runs of what nobody can beat who knows all failures beforehand.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments import common
from sapopt import bound, solve
from sapopt.domains.chance import STOCHASTIC, Failures, stochastic_instance
from sapopt.running.chance import Runs, play
from sapopt.solvers import HAAL, AssignmentPolicy, DualLookahead, energy_price, power_constrained

BASE = "greedy that never kills"


def policies(quick: bool) -> dict[str, Any]:
    """Name -> policy."""
    found: dict[str, Any] = {
        BASE: AssignmentPolicy(power_constrained),
        "price on energy": AssignmentPolicy(energy_price),
        "HAAL(L=3)": HAAL(3),
        "dual lookahead(W=3)": DualLookahead(3),
    }
    if not quick:
        from sapopt.learning import REDA

        found["REDA"] = AssignmentPolicy(REDA.load("power"))
    return found


def measure(run: common.Run, name: str, runs: int, steps: int) -> dict[str, Any]:
    """Means, standard errors and paired differences on one instance."""
    problem, chance = stochastic_instance(name, run.seeds[0], steps=steps)
    compared = policies(run.quick)
    compared["plan"] = solve(problem, DualLookahead(3)).plan
    values: dict[str, list[float]] = {label: [] for label in compared}
    bounds = []
    for r in range(runs):
        for label, decide in compared.items():
            values[label].append(play(problem, decide, chance, (run.seeds[0], r)).value)
        if isinstance(chance, Failures):
            known = chance.in_hindsight(problem, (run.seeds[0], r))
            bounds.append(bound(known, time_limit=run.options.limit).value)
        run.say(f"{name}: run {r + 1} of {runs}")
    table: dict[str, Any] = {}
    base = Runs(BASE, np.array(values[BASE]))
    for label, found in values.items():
        one = Runs(label, np.array(found))
        above, error = one.less(base)
        certain = play(problem, compared[label]).value
        table[label] = {
            "mean": one.mean, "error": one.error, "above_greedy": above, "error_of_that": error, "no_chance": certain,
        }  # fmt: skip
        print(
            f"{name:14s} {label:24s} {one.mean:9.1f} +- {one.error:5.1f}   above greedy {above:8.1f} +- {error:5.1f}"
            f"   without chance {certain:9.1f}"
        )
    if bounds:
        mean, error = common.mean_and_error(bounds)
        table["bound in hindsight"] = {"mean": mean, "error": error}
        print(f"{name:14s} {'bound in hindsight':24s} {mean:9.1f} +- {error:5.1f}")
    return {"table": table, "values": values, "bounds": bounds}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--instance", choices=STOCHASTIC, help="both by default")
    parser.add_argument("--runs", type=int, help="default 20, quick 3")
    parser.add_argument("--steps", type=int, help="default 100, quick 20")
    parser.add_argument("--limit", type=float, default=10.0, help="seconds for each bound")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "chance", argv, add=add_options)
    options = run.options
    runs = options.runs or (3 if run.quick else 20)
    steps = options.steps or (20 if run.quick else 100)
    names = [options.instance] if options.instance else list(STOCHASTIC)
    run.write_json({name: measure(run, name, runs, steps) for name in names})


if __name__ == "__main__":
    main()
