"""DualLookahead against HAAL with the same lookahead: value, share of the proven bound, time per step.

    python -m experiments.benchmarks.lookahead [--instance constellation-mid] [--windows 1 2 3 6 10 20]
        [--seeds 10] [--seed 0] [--bound-time 60] [--out FILE]

The bound is that of `bound(problem)`; ``--bound-time 0`` leaves it out. Kernels are compiled before the clock starts.
"""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np

from experiments import common
from experiments.benchmarks.output import finish
from sapopt import bound, solve
from sapopt.domains.instances import instance
from sapopt.solvers import HAAL, DualLookahead


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--instance", default="constellation-mid")
    parser.add_argument("--windows", type=int, nargs="+", default=[1, 2, 3, 6, 10, 20])
    common.add_seeds(parser)
    parser.add_argument("--bound-time", type=float, default=60.0)
    parser.add_argument(
        "--haal-up-to", type=int, default=6, help="largest lookahead at which HAAL is run too"
    )
    parser.add_argument("--out")
    options = parser.parse_args()
    seeds = common.seeds_of(parser, options)
    toy = instance("constellation-toy")
    solve(toy, DualLookahead(3))
    solve(toy, HAAL(3))
    rows = []
    for seed in seeds:
        problem = instance(options.instance, seed=seed)
        proven = bound(problem, time_limit=options.bound_time).value if options.bound_time else None
        for window in options.windows:
            ours = solve(problem, DualLookahead(window))
            steps = [record["seconds"] for record in ours.trace]
            row = {
                "seed": seed, "window": window, "value": ours.value, "handovers": ours.handovers, "bound": proven,
                "share": ours.value / proven if proven else None,
                "s_per_step_mean": float(np.mean(steps)), "s_per_step_max": float(np.max(steps[1:])),
            }  # fmt: skip
            if window <= options.haal_up_to:
                haal = solve(problem, HAAL(window))
                row |= {"haal": haal.value, "over_haal": ours.value / haal.value - 1}
            print(json.dumps(row), file=sys.stderr, flush=True)
            rows.append(row)
    finish({"instance": options.instance, "rows": rows}, options.out)


if __name__ == "__main__":
    main()
