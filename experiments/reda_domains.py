"""REDA beyond satellites' handovers (Holder 2024, 7.1, 7.2): that it trains there, and what it reaches.

    python -m experiments.reda_domains [--seeds 1] [--episodes 150] [--domains ride-hailing,...] [--quick] [--out DIR]

The thesis proposes REDA for these domains and shows nothing. Small problems, so that a run takes minutes; agents see
beta_hat in their state (`sapopt.learning.StateObservation`). Means over fresh episodes, with what HAA (the guide) and
HAAL earn on the same, and a proven bound. A seed is a training run.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments import common
from sapopt import SAP, bound, solve
from sapopt.domains.instances import instance
from sapopt.learning import REDA, StateObservation, TrainOptions, train
from sapopt.learning.options import FRESH
from sapopt.solvers import HAA, HAAL, AssignmentPolicy, myopic

DOMAINS: dict[str, dict[str, Any]] = {
    "ride-hailing": {"drivers": 12, "requests": 90, "steps": 30, "width": 6},
    "attitude": {"steps": 30, "tasks": 40, "planes": 4, "per_plane": 6, "altitude_km": 1200.0},
    "unit-commitment": {"units": 8, "steps": 24, "shut_down": 0.25},
    "interference": {"steps": 30, "tasks": 60, "planes": 6, "per_plane": 8},
}


def measure(run: common.Run, name: str, episodes: int, fresh: int) -> dict[str, Any]:
    """Mean values on fresh episodes of one domain."""

    def problems(seed: int) -> SAP:
        return instance(name, seed, **DOMAINS[name])

    tests = [problems(FRESH + 1000 + seed) for seed in range(fresh)]
    values: dict[str, list[float]] = {
        solver.name: [solve(problem, solver).value for problem in tests] for solver in (HAA(), HAAL(3))
    }
    spec = StateObservation.of(problems(0), tasks=10, neighbours=4, steps=3)
    for seed in run.seeds:
        options = TrainOptions(
            episodes=episodes, spec=spec, seed=seed, trace=0.5, discount=0.95, evaluate_every=max(1, episodes // 10),
            evaluations=3,
        )  # fmt: skip
        folder = run.out / name / f"seed {seed}"
        training = train(problems, AssignmentPolicy(myopic), options, folder)
        policy = AssignmentPolicy(REDA(training.network))
        values[f"REDA, run {seed}"] = [solve(problem, policy).value for problem in tests]
        run.say(f"{name}: run {seed}, best evaluation {training.value:.1f}")
    values["bound"] = [bound(problem, time_limit=3.0).value for problem in tests]
    for label, found in values.items():
        mean, error = common.mean_and_error(found)
        print(
            f"{name:16s} {label:14s} {mean:10.1f} +- {error:6.1f}   {100 * mean / np.mean(values['bound']):5.1f} %"
        )
    return values


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--episodes", type=int, help="default 150, quick 6")
    parser.add_argument("--domains", help="names separated by commas; all by default")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "reda_domains", argv, add=add_options, resumes=True)
    episodes = run.options.episodes or (6 if run.quick else 150)
    names = run.chosen("domains", run.options.domains or ",".join(DOMAINS), DOMAINS)
    fresh = 2 if run.quick else 10
    run.write_json({"values": {name: measure(run, name, episodes, fresh) for name in names}})


if __name__ == "__main__":
    main()
