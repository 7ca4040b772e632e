"""HAAL-D's and CBBA's time per step against one object per agent, in one run, on the mid-size instance.

    python -m experiments.benchmarks.distributed [--steps 20] [--plain-steps 1] [--skip-plain] [--out FILE]

The plain versions send whole tables and handle every agent in a Python loop, see `plain_distributed`. Their assignments
and rounds are compared with the library's.
"""

from __future__ import annotations

import argparse
import json
import time

import networkx as nx
import numba
import numpy as np

from experiments.benchmarks.output import keep
from experiments.benchmarks.plain_distributed import plain_cbba, plain_haald
from sapopt import SAP
from sapopt.domains.instances import scenario
from sapopt.solvers import CBBA, HAALD, DistributedDualLookahead
from sapopt.solvers.distributed import play

EPSILON = 0.01


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=20, help="steps the library is timed over")
    parser.add_argument("--skip-plain", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out")
    options = parser.parse_args()
    if options.steps < 8:
        parser.error("--steps must be at least 8: steps with a whole window are timed, from the second on")
    constellation = scenario("constellation-mid", options.seed)
    whole = constellation.problem()
    graphs = constellation.graphs(steps=range(options.steps))
    # The window is cut at the end of the problem, so the last steps are left out of the means.
    problem = SAP(whole.benefits.slice(0, options.steps), whole.dynamics)
    rows = []
    for policy in (
        HAALD(3, EPSILON, graphs), HAALD(6, EPSILON, graphs), CBBA(3, graphs), CBBA(6, graphs),
        DistributedDualLookahead(6, EPSILON, graphs),
    ):  # fmt: skip
        rows.append(measure(problem, policy, graphs, options.skip_plain))
        print(json.dumps(rows[-1]), flush=True)
    report = {"threads": numba.get_num_threads(), "steps": options.steps, "rows": rows}
    if options.out:
        keep(report, options.out)


def measure(problem: SAP, policy: object, graphs: list[nx.Graph], skip_plain: bool) -> dict[str, object]:
    """Seconds a step of one policy and of its plain version (from step 1 on, which has handovers)."""
    lookahead = getattr(policy, "lookahead", getattr(policy, "window", 1))
    short = SAP(problem.benefits.slice(0, 1), problem.dynamics)
    play(short, type(policy)(lookahead, graph=graphs[0]))  # compile
    played, traffic = play(problem, policy)
    whole_windows = range(1, problem.T - lookahead + 1)
    seconds = [played.trace[k]["seconds"] for k in whole_windows]
    row: dict[str, object] = {
        "policy": policy.name,
        "seconds_per_step": float(np.mean(seconds)), "fastest": float(np.min(seconds)),
        "rounds_mean": float(np.mean([traffic[k].rounds for k in whole_windows])),
        "messages_mean": float(np.mean([traffic[k].messages for k in whole_windows])),
        "megabytes_mean": float(np.mean([traffic[k].bytes for k in whole_windows])) / 1e6,
    }  # fmt: skip
    if skip_plain or lookahead > 3:
        return row
    benefits = problem.benefits.slice(1, 1 + lookahead).dense()
    cost, held = float(problem.dynamics.cost), played.plan[0]
    began = time.perf_counter()
    if isinstance(policy, HAALD):
        tasks, rounds = plain_haald(benefits, cost, held, graphs[1], EPSILON)
        row["same"] = bool((tasks == played.plan[1]).all())
    else:
        agents, rounds = plain_cbba(benefits, cost, held, graphs[1])
        first = [next((j for t, j, _ in agent.bundle if t == 0), None) for agent in agents]
        row["same"] = all(j is None or j == played.plan[1, i] for i, j in enumerate(first))
    row["plain_seconds"] = time.perf_counter() - began
    row["plain_rounds"] = rounds
    row["rounds_there"] = traffic[1].rounds
    row["ratio"] = row["plain_seconds"] / row["seconds_per_step"]
    return row


if __name__ == "__main__":
    main()
