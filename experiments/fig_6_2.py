"""Figure 6.2 (Holder 2024, section 6.3): learning where idling is free and there are no batteries.

    python -m experiments.fig_6_2 [--seeds 10] [--episodes N] [--instance earth-coverage-thesis] [--lookahead] [--quick]
                                  [--out DIR]

REDA's shipped weights play the environment of 6.3 by the text (every task is worth 1, 93 minutes) beside HAA, HAAL and
a plain rule over fresh episodes, which no training and no choice of weights has seen. Each is printed with the mean
difference to HAAL (L = 3) and its standard error, and drawn beside the proven bound of the first two episodes. The rule
is alpha of beta_hat plus the benefits of the next four steps at a discount of 0.7, which is what an agent knows without
having learned anything. `--lookahead` adds the dual lookahead of three steps. The weights and their log were made by

    sapopt train reda earth-coverage-thesis --preset per-task --out DIR

whose options, and how they depart from Algorithm 4, `TrainOptions.per_task_values` lists. `--episodes N` trains anew
with them; `--episodes 0` leaves REDA out. `--instance earth-coverage` is the published code's environment.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import resources
from typing import Any

import numpy as np

from experiments import common
from experiments.learned import by_generator, by_policy, curve
from sapopt import SAP, Outlook, bound
from sapopt.domains.instances import instance
from sapopt.learning import REDA, TrainOptions, save_network, train
from sapopt.learning.options import FRESH
from sapopt.solvers import HAA, HAAL, AssignmentPolicy, DualLookahead, myopic

SEES, DISCOUNT = 5, 0.7
AGAINST = "HAAL L=3"
SHIPPED = "earth-coverage-thesis"
"""The environment, and the name of the weights for it."""


def discounted_window(outlook: Outlook) -> np.ndarray:
    """beta_hat now, and what the next steps are worth at a discount, as if every agent stayed."""
    now = outlook.beta_hat()
    known = outlook.benefits(SEES).dense()
    later = sum(DISCOUNT**step * known[step] for step in range(1, len(known)))
    return np.asarray(now.toarray() if hasattr(now, "toarray") else now) + later


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument(
        "--episodes", type=int, help="train anew, in place of the shipped weights; 0: without REDA"
    )
    parser.add_argument("--instance", default=SHIPPED)
    parser.add_argument("--lookahead", action="store_true", help="the dual lookahead of three steps as well")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_6_2", argv, seeds=10, quick_seeds=1, add=add_options, resumes=True)
    size = {"steps": 10} if run.quick else {}
    episodes = run.options.episodes

    def problems(seed: int) -> SAP:
        return instance(run.options.instance, seed, **size)

    players: dict[str, Any] = {
        "HAA": by_policy(HAA()),
        AGAINST: by_policy(HAAL(3)),
        "HAAL L=5": by_policy(HAAL(5)),
        "discounted window of 5": by_generator(discounted_window),
    }
    if run.options.lookahead:
        players["dual lookahead W=3"] = by_policy(DualLookahead(3))
    at, values = [], []
    if episodes is None and run.options.instance == SHIPPED:
        players["REDA"] = by_generator(REDA.load(SHIPPED))
        with resources.as_file(resources.files("sapopt.learning") / "weights" / f"{SHIPPED}.csv") as log:
            at, values = curve(log)
    elif episodes:
        options = TrainOptions.per_task_values(episodes=episodes)
        training = train(problems, AssignmentPolicy(myopic), options, run.out / "reda")
        save_network(training.network, run.out / "reda" / "weights.safetensors", {"value": training.value})
        run.say(f"REDA: best evaluation {training.value:.0f}")
        players["REDA"] = by_generator(REDA(training.network))
        at, values = curve(run.out / "reda" / "log.csv")
    fresh = [problems(FRESH + 1000 + seed) for seed in run.seeds]
    each = {}
    for name, play in players.items():
        each[name] = [play(problem).value for problem in fresh]
        run.say(f"{name:24s} {np.mean(each[name]):.0f}")
    for name, found in each.items():
        mean, error = common.mean_and_error(list(np.subtract(found, each[AGAINST])))
        print(f"{name:24s} {np.mean(found):8.1f}   less {AGAINST}: {mean:+8.1f} +- {error:.1f}")
    seconds = 5.0 if run.quick else 60.0
    top = float(np.mean([bound(problem, time_limit=seconds).value for problem in fresh[:2]]))
    figure, axes = common.new_figure(7.5, 4.2)
    axes.plot(at, values, label="REDA, while it learns")
    for index, (name, found) in enumerate(each.items()):
        axes.axhline(np.mean(found), color=f"C{index + 1}", linestyle="--", label=name)
    axes.axhline(top, color="black", linestyle=":", label="proven bound, two episodes")
    axes.set(xlabel="environment steps", ylabel="total reward of an episode")
    axes.legend(fontsize=8)
    run.write_figure(figure)
    run.write_json({"values": each, "bound": top, "curve": list(zip(at, values, strict=True))})


if __name__ == "__main__":
    main()
