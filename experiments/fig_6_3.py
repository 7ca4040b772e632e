"""Figure 6.3 (Holder 2024, section 6.4): learning curves on the power environment, with the bound and the planners.

    python -m experiments.fig_6_3 [--seeds 2] [--episodes 400] [--methods reda,iql,ippo] [--quick] [--out DIR]
                                  [--logs reda=LOG.csv,iql=LOG.csv]

`--seeds` counts the fresh episodes on which the reference policies are measured. A training that was interrupted goes
on from its checkpoint; `--logs` draws runs that exist instead of training.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from experiments import common
from experiments.learned import by_generator, by_policy, curve
from sapopt import SAP, bound
from sapopt.domains.instances import instance
from sapopt.learning import TrainOptions, save_network, train
from sapopt.learning.ippo import PPOOptions, train_ippo
from sapopt.learning.options import FRESH
from sapopt.solvers import AssignmentPolicy, DualLookahead, energy_price, power_constrained
from sapopt.solvers.charge_value import ChargeValue

METHODS = ("reda", "iql", "ippo")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--episodes", type=int, help="default 400, quick 2")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--logs", default="", help="name=path of finished logs, separated by commas")
    parser.add_argument("--bound-seconds", type=float, help="for each bound; default 60, quick 5")


def learn(method: str, episodes: int, problems: Callable[[int], SAP], folder: Path) -> Path:
    """Train one method and return its log."""
    if method == "ippo":
        training = train_ippo(problems, PPOOptions(episodes=episodes), folder)
    else:
        options = TrainOptions(episodes=episodes, choose="self" if method == "iql" else "alpha")
        training = train(problems, AssignmentPolicy(power_constrained), options, folder)
    save_network(
        training.network, folder / "weights.safetensors", {"method": method, "value": training.value}
    )
    return folder / "log.csv"


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_6_3", argv, seeds=2, quick_seeds=1, add=add_options, resumes=True)
    steps = 10 if run.quick else 100
    episodes = run.options.episodes or (2 if run.quick else 400)

    def problems(seed: int) -> SAP:
        return instance("power", seed, steps=steps)

    logs = dict(pair.split("=") for pair in run.options.logs.split(",") if pair)
    curves = {}
    for method in run.chosen("methods", run.options.methods, METHODS):
        path = Path(logs[method]) if method in logs else learn(method, episodes, problems, run.out / method)
        curves[method] = curve(path)
        run.say(f"{method}: best evaluation {max(curves[method][1]):.0f}")
    players = {
        "power-constrained greedy": by_generator(power_constrained),
        "energy price": by_generator(energy_price),
        "dual lookahead W=3": by_policy(DualLookahead(3)),
        "the same with the value of charge": by_policy(DualLookahead(3, end_value=ChargeValue.load("power"))),
    }
    fresh = [problems(FRESH + seed) for seed in run.seeds]
    lines = {}
    for name, player in players.items():
        lines[name] = float(np.mean([player(problem).value for problem in fresh]))
        run.say(f"{name}: {lines[name]:.0f}")
    seconds = run.options.bound_seconds or (5.0 if run.quick else 60.0)
    lines["proven bound"] = float(np.mean([bound(problem, time_limit=seconds).value for problem in fresh]))
    figure, axes = common.new_figure(8.0, 4.4)
    for method, (at, values) in curves.items():
        axes.plot(at, values, label=method.upper())
    for index, (name, value) in enumerate(lines.items()):
        axes.axhline(value, color=f"C{index + 4}", linestyle="--", label=name)
    axes.set(xlabel="environment steps", ylabel="total reward of an episode")
    axes.legend(fontsize=8)
    run.write_figure(figure)
    run.write_json(
        {"curves": {name: list(zip(*c, strict=True)) for name, c in curves.items()}, "lines": lines}
    )


if __name__ == "__main__":
    main()
