"""Figure 6.2 (Holder 2024, section 6.3): learning where idling is free and there are no batteries.

    python -m experiments.fig_6_2 [--seeds 2] [--episodes 200] [--quick] [--out DIR]

REDA is trained on `earth-coverage` and compared with HAA, HAAL and the dual lookahead, beside the proven bound.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from experiments import common
from experiments.learned import by_generator, by_policy, curve
from sapopt import SAP, bound
from sapopt.domains.instances import instance
from sapopt.learning import REDA, ObservationSpec, TrainOptions, save_network, train
from sapopt.learning.options import FRESH
from sapopt.solvers import HAA, HAAL, AssignmentPolicy, DualLookahead, myopic


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--episodes", type=int, help="default 200, quick 2")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_6_2", argv, seeds=2, quick_seeds=1, add=add_options, resumes=True)
    steps = 10 if run.quick else 100
    options = TrainOptions(
        episodes=run.options.episodes or (2 if run.quick else 200), spec=ObservationSpec(charge=False)
    )

    def problems(seed: int) -> SAP:
        return instance("earth-coverage", seed, steps=steps)

    training = train(problems, AssignmentPolicy(myopic), options, run.out / "reda")
    save_network(training.network, run.out / "reda" / "weights.safetensors", {"value": training.value})
    run.say(f"REDA: best evaluation {training.value:.0f}")
    players = {
        "HAA": by_policy(HAA()),
        "HAAL L=3": by_policy(HAAL(3)),
        "dual lookahead W=3": by_policy(DualLookahead(3)),
        "REDA": by_generator(REDA(training.network)),
    }
    fresh = [problems(FRESH + 1000 + seed) for seed in run.seeds]
    lines = {
        name: float(np.mean([play(problem).value for problem in fresh])) for name, play in players.items()
    }
    seconds = 5.0 if run.quick else 60.0
    lines["proven bound"] = float(np.mean([bound(problem, time_limit=seconds).value for problem in fresh]))
    for name, value in lines.items():
        run.say(f"{name:24s} {value:.0f}")
    at, values = curve(run.out / "reda" / "log.csv")
    figure, axes = common.new_figure(7.5, 4.2)
    axes.plot(at, values, label="REDA, while it learns")
    for index, (name, value) in enumerate(lines.items()):
        axes.axhline(value, color=f"C{index + 1}", linestyle="--", label=name)
    axes.set(xlabel="environment steps", ylabel="total reward of an episode")
    axes.legend(fontsize=8)
    run.write_figure(figure)
    run.write_json({"values": lines, "curve": list(zip(at, values, strict=True))})


if __name__ == "__main__":
    main()
