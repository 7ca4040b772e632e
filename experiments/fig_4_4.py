"""Figure 4.4 (Holder 2024): 1000 satellites, 812 even tasks, 188 of zero benefit: value, and one satellite's history.

    python -m experiments.fig_4_4 [--seeds 1] [--steps 93] [--lookahead 6] [--cbba] [--quick] [--out DIR]

The thesis leaves CBBA out, as "computationally infeasible" at this size. `--cbba` adds it: at L = 6 it takes over 20
minutes of one core. Runs are kept in DIR/fig_4_4_runs.json; a second call does only what is missing. The figure is that
of seed 0.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from types import SimpleNamespace

from experiments import common
from experiments.distributed_runs import LABELS, Job, policy_of, run_all
from sapopt import SAP, bound
from sapopt.domains.instances import scenario
from sapopt.plotting import benefit_history, value_against_bound
from sapopt.running.rollout import rollout

NAME = "constellation-large-thesis"
METHODS = ("dual", "HAAL", "HAALD", "greedy", "no handover")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--steps", type=int, help="default 93, quick 10")
    parser.add_argument("--lookahead", type=int, help="default 6, quick 3")
    parser.add_argument("--satellite", type=int, default=900, help="whose history is drawn")
    parser.add_argument("--cbba", action="store_true", help="run CBBA as well")
    parser.add_argument("--workers", type=int, default=2, help="processes")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_4_4", argv, add=add_options, resumes=True)
    options = run.options
    steps = options.steps or (10 if run.quick else 93)
    lookahead = options.lookahead or (3 if run.quick else 6)
    alone = {"greedy": 1, "no handover": 1}
    jobs = [
        Job(NAME, seed, steps, method, alone.get(method, lookahead))
        for seed in run.seeds
        for method in (*METHODS, *(("CBBA",) if options.cbba else ()))
    ]
    runs = run_all(jobs, run.out / "fig_4_4_runs.json", options.workers)
    whole = scenario(NAME).problem()
    problem = SAP(whole.benefits.slice(0, min(steps, whole.T)), whole.dynamics)
    proven = bound(problem, time_limit=60).value
    figure, (left, right) = common.new_figure(12.5, 4.2, 1, 2, width_ratios=(1, 1.25))
    values = {LABELS[one.job.method]: one.value for one in runs if one.job.seed == 0}
    value_against_bound(values, proven, left)
    histories = {}
    for method in ("HAAL", "greedy", "no handover"):
        plan = rollout(problem, policy_of(Job(NAME, 0, 0, method, lookahead), None)).plan
        histories[LABELS[method]] = SimpleNamespace(plan=plan)
    benefit_history(problem, histories, options.satellite, right)
    run.write_figure(figure, dpi=160)
    for one in runs:
        print(
            f"seed {one.job.seed} {LABELS[one.job.method]:36s} value {one.value:9.1f}  handovers {one.handovers:6d}  "
            f"rounds {one.rounds:6.1f}  messages {one.messages:9.0f}  MB {one.megabytes:7.1f}  "
            f"{1e3 * one.seconds_per_step:6.0f} ms a step"
        )
    run.write_json({"bound_seed_0": proven, "runs": [asdict(one) for one in runs]})


if __name__ == "__main__":
    main()
