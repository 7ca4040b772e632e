"""Figure 6.1 (Holder 2024, section 6.1): the dictator; optimum 60, greed earns 30.

    python -m experiments.fig_6_1 [--seeds 5] [--methods reda,iql,ippo,coma] [--quick] [--out DIR]

`--seeds` counts the training runs. REDA and IQL learn with the same options; IQL's agents choose for themselves. Both
explore by random assignments. The thesis' guide, the greedy policy, never leaves the poor states, and the memory of it
ties the other agents' tasks to poverty.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments import common
from experiments.learned import curve
from sapopt import SAP, Outlook, solve
from sapopt.data.types import IntArray
from sapopt.domains.instances import instance
from sapopt.learning import Environment, TrainOptions, train
from sapopt.learning.coma import COMAOptions, train_coma
from sapopt.learning.global_observation import GlobalSpec
from sapopt.learning.ippo import PPOOptions, train_ippo
from sapopt.learning.options import Choose
from sapopt.learning.train import Training
from sapopt.solvers import AssignmentPolicy, Exact, myopic


def problems(seed: int) -> SAP:
    """The same problem in every episode."""
    return instance("dictator")


@dataclass(frozen=True)
class RandomAssignment:
    """A guide without a prejudice: every assignment is equally likely."""

    name: str = "random assignment"

    def begin(self, problem: SAP, rng: np.random.Generator) -> np.random.Generator:
        """What it draws from."""
        return rng

    def act(self, outlook: Outlook, memory: np.random.Generator) -> tuple[IntArray, np.random.Generator]:
        """Draw tasks."""
        return memory.permutation(outlook.problem.m)[: outlook.problem.n], memory


def q_options(seed: int, episodes: int, choose: Choose) -> TrainOptions:
    """Small batches and one-step targets: the problem has 30 states of state and step."""
    return TrainOptions(
        episodes=episodes, gradient_steps=8, stretches=2, stretch=10, memory=100, learning_rate=3e-3, discount=0.99,
        soft_target=0.05, trace=0.0, noise=1.0, explore=0.5, spec=GlobalSpec(), evaluations=1, evaluate_every=2,
        checkpoint_every=episodes, seed=seed, choose=choose,
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
    choose: Choose = "self" if method == "iql" else "alpha"
    return train(problems, RandomAssignment(), q_options(seed, episodes, choose), folder)


def own_best() -> float:
    """Value where every agent takes the task that is best for itself now, conflicts shared."""
    env = Environment(problems(0), conflicts_shared=True)
    total = 0.0
    while not env.done:
        total += float(env.step(np.asarray(env.outlook().beta_hat()).argmax(axis=1)).sum())
    return total


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--methods", default="reda,iql,ippo,coma")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_6_1", argv, seeds=5, quick_seeds=1, add=add_options, resumes=True)
    figure, axes = common.new_figure(7.5, 4.2)
    report = {}
    for index, method in enumerate(run.options.methods.split(",")):
        best, last, settled = [], [], []
        for seed in run.seeds:
            folder = run.out / f"{method}-{seed}"
            training = learn(method, seed, run.quick, folder)
            at, values = curve(folder / "log.csv")
            best.append(training.value)
            last.append(values[-1])
            settled.append(float(np.mean(values[-max(len(values) // 4, 1) :])))
            axes.plot(at, values, color=f"C{index}", alpha=0.6, label=method.upper() if seed == 0 else None)
            run.say(
                f"{method} seed {seed}: best {best[-1]:.1f}, last {last[-1]:.1f}, "
                f"mean of the last quarter {settled[-1]:.1f}"
            )
        report[method] = {"best": best, "last": last, "settled": settled}
    optimum = solve(problems(0), Exact(method="dp")).value
    greedy = solve(problems(0), AssignmentPolicy(myopic)).value
    own = own_best()
    axes.axhline(optimum, color="black", linestyle="--", label="optimum, proven")
    axes.axhline(greedy, color="black", linestyle=":", label="alpha(beta_hat)")
    axes.axhline(own, color="gray", linestyle=":", label="everybody's own best task, conflicts shared")
    axes.set(xlabel="environment steps", ylabel="total reward of an episode")
    axes.legend(fontsize=8)
    run.write_figure(figure)
    run.write_json({"runs": report, "optimum": optimum, "greedy": greedy, "own_best": own})
    for name, one in report.items():
        run.say(name + "".join(f"  {key} {np.mean(found):.1f}" for key, found in one.items()))


if __name__ == "__main__":
    main()
