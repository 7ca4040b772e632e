"""Figure 4.4 (Holder 2024): 1000 satellites, 812 even tasks, 188 of zero benefit: value, and one satellite's history.

python experiments/fig_4_4.py [--steps 93] [--lookahead 3] [--satellite 900] [--workers 2] [--out DIR]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from types import SimpleNamespace

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from distributed_runs import LABELS, Job, policy_of, run_all

from sapopt import SAP
from sapopt.domains.instances import scenario
from sapopt.outlook import rollout
from sapopt.plotting import benefit_history, value_against_bound
from sapopt.verbs import stepwise_bound

METHODS = ("dual", "HAAL", "HAALD", "CBBA", "greedy", "no handover")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=93)
    parser.add_argument("--lookahead", type=int, default=3)
    parser.add_argument("--satellite", type=int, default=900)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("results"))
    options = parser.parse_args()
    name = "constellation-large"
    length = {"greedy": 1, "no handover": 1}
    jobs = [
        Job(name, options.seed, options.steps, method, length.get(method, options.lookahead))
        for method in METHODS
    ]
    runs = run_all(jobs, options.out / "fig_4_4.json", options.workers)
    whole = scenario(name, options.seed).problem()
    problem = SAP(whole.benefits.slice(0, min(options.steps, whole.T)), whole.dynamics)
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(12.5, 4.2), layout="constrained", width_ratios=(1, 1.25)
    )
    values = {LABELS[one.job.method]: one.value for one in runs}
    value_against_bound(values, stepwise_bound(problem).value, left)
    histories = {}
    for method in ("HAAL", "no handover"):
        plan = rollout(problem, policy_of(Job(name, options.seed, 0, method, options.lookahead), None)).plan
        histories[LABELS[method]] = SimpleNamespace(plan=plan)
    benefit_history(problem, histories, options.satellite, right)
    figure.savefig(options.out / "fig_4_4.png", dpi=160)
    for one in runs:
        print(
            f"{LABELS[one.job.method]:36s} value {one.value:9.1f}  handovers {one.handovers:6d}  "
            f"rounds {one.rounds:6.1f}  messages {one.messages:9.0f}  MB {one.megabytes:7.1f}  "
            f"{1e3 * one.seconds_per_step:6.0f} ms a step"
        )
    print(f"figure: {options.out / 'fig_4_4.png'}")


if __name__ == "__main__":
    main()
