"""Figure 6.1 (Holder 2024, section 6.1): the dictator; optimum 60, greed earns 30.

    python experiments/fig_6_1.py [--seeds 5] [--methods reda,iql,ippo,coma] [--quick] [--out DIR]

`--seeds` counts the training runs. REDA and IQL learn with the same options; IQL's agents choose for themselves.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import common
import numpy as np
from learned import curve

from sapopt import SAP, solve
from sapopt.domains.instances import instance
from sapopt.learning import TrainOptions, train
from sapopt.learning.coma import COMAOptions, train_coma
from sapopt.learning.global_observation import GlobalSpec
from sapopt.learning.ippo import PPOOptions, train_ippo
from sapopt.learning.train import Training
from sapopt.solvers import AssignmentPolicy, Exact, myopic


def problems(seed: int) -> SAP:
    """The same problem in every episode."""
    return instance("dictator")


def q_options(seed: int, episodes: int, choose: str) -> TrainOptions:
    """Small batches and one-step targets: the problem has 30 states of state and step."""
    return TrainOptions(
        episodes=episodes, gradient_steps=8, stretches=2, stretch=10, memory=100, learning_rate=3e-3, discount=0.99,
        soft_target=0.05, trace=0.0, noise=1.0, explore=0.8, spec=GlobalSpec(), evaluations=1, evaluate_every=2,
        checkpoint_every=episodes, seed=seed, choose=choose,  # type: ignore[arg-type]
    )  # fmt: skip


def learn(method: str, seed: int, quick: bool, folder: Path) -> Training:
    """One training run."""
    episodes = 20 if quick else 800
    if method == "ippo":
        options = PPOOptions(
            episodes=episodes, batch=30, learning_rate=2e-3, discount=0.99, spec=GlobalSpec(), seed=seed,
            evaluate_every=10, evaluations=1,
        )  # fmt: skip
        return train_ippo(problems, options, folder)
    if method == "coma":
        return train_coma(problems, COMAOptions(episodes=3 * episodes, seed=seed), folder)
    choose = {"reda": "alpha", "iql": "self"}[method]
    return train(problems, AssignmentPolicy(myopic), q_options(seed, episodes, choose), folder)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--methods", default="reda,iql,ippo,coma")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_6_1", argv, seeds=5, quick_seeds=1, add=add_options, resumes=True)
    figure, axes = common.new_figure(7.5, 4.2)
    report = {}
    for index, method in enumerate(run.options.methods.split(",")):
        best, last = [], []
        for seed in run.seeds:
            folder = run.out / f"{method}-{seed}"
            training = learn(method, seed, run.quick, folder)
            at, values = curve(folder / "log.csv")
            best.append(training.value)
            last.append(values[-1])
            axes.plot(at, values, color=f"C{index}", alpha=0.6, label=method.upper() if seed == 0 else None)
            run.say(f"{method} seed {seed}: best {best[-1]:.1f}, last {last[-1]:.1f}")
        report[method] = {"best": best, "last": last}
    optimum = solve(problems(0), Exact(method="dp")).value
    greedy = solve(problems(0), AssignmentPolicy(myopic)).value
    axes.axhline(optimum, color="black", linestyle="--", label="optimum, proven")
    axes.axhline(greedy, color="black", linestyle=":", label="alpha(beta_hat)")
    axes.set(xlabel="environment steps", ylabel="total reward of an episode")
    axes.legend(fontsize=8)
    run.write_figure(figure)
    run.write_json({"runs": report, "optimum": optimum, "greedy": greedy})
    print({name: float(np.mean(one["best"])) for name, one in report.items()}, optimum, greedy)


if __name__ == "__main__":
    main()
