"""Figure 6.1 (Holder 2024, section 6.1): the dictator, by REDA, IQL, IPPO and COMA, against the proven optimum.

    python -m experiments.fig_6_1 [--seeds 5] [--methods reda,iql,ippo,coma] [--guide myopic] [--memory 100]
                                    [--show-step] [--quick] [--out DIR]

`--seeds` counts the training runs. REDA and IQL learn by Algorithm 4: a gradient step at every time step, the greedy
policy alpha(beta_hat) with probability epsilon, noise on the values otherwise, epsilon down to 0 at 10 000 time steps
and 12 000 in all; IQL's agents choose for themselves. Agents see the state, which is all that the thesis gives them;
with `--show-step` also the step. `--guide random` explores by random assignments in place of the greedy policy, and
`--memory` is the number of episodes that are remembered. Each run reports the joint policy on which it settled: what
the last weights play at every step.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments import common
from experiments.learned import curve
from sapopt import SAP, Outlook, solve
from sapopt.data.types import IntArray
from sapopt.domains.instances import instance
from sapopt.learning import REDA, Environment, Network, TrainOptions, train
from sapopt.learning.coma import COMAOptions, train_coma
from sapopt.learning.global_observation import GlobalSpec
from sapopt.learning.ippo import PPOOptions, train_ippo
from sapopt.learning.learner import own_choice
from sapopt.learning.sampling import sample_episode
from sapopt.learning.train import Training
from sapopt.solvers import AssignmentPolicy, Exact, myopic

METHODS = ("reda", "iql", "ippo", "coma")

STEPS, EXPLORED = 12_000, 10_000
"""Time steps of a run, and those after which epsilon is 0."""


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


GUIDES: dict[str, Any] = {"myopic": AssignmentPolicy(myopic), "random": RandomAssignment()}


def learn(method: str, seed: int, options: argparse.Namespace, episodes: int, folder: Path) -> Training:
    """One training run."""
    spec = GlobalSpec(horizon=10 if options.show_step else 0)
    if method == "ippo":
        ppo = PPOOptions(
            episodes=episodes, batch=30, learning_rate=2e-3, discount=0.99, spec=spec, seed=seed,
            evaluate_every=10, evaluations=1,
        )  # fmt: skip
        return train_ippo(problems, ppo, folder)
    if method == "coma":
        return train_coma(problems, COMAOptions(episodes=episodes, spec=spec, seed=seed), folder)
    given = TrainOptions.thesis(
        episodes=episodes, stretches=8, memory=options.memory, learning_rate=1e-3, explore=EXPLORED / STEPS, spec=spec,
        evaluations=1, evaluate_every=10, checkpoint_every=max(episodes // 4, 1), seed=seed,
        choose="self" if method == "iql" else "alpha",
    )  # fmt: skip
    return train(problems, GUIDES[options.guide], given, folder)


def settled(method: str, network: Network) -> tuple[float, list[list[int]]]:
    """Value and plan of the policy of some weights, without exploration; tasks and agents counted from 1."""
    problem = problems(0)
    env = Environment(problem, conflicts_shared=True)
    if method == "reda":
        plan = solve(problem, AssignmentPolicy(REDA(network))).plan
    elif method == "iql":
        plan = np.empty((problem.T, problem.n), np.int64)
        while not env.done:
            k = env.k
            seen, listed = env.observe(network.spec)
            plan[k] = own_choice(network.values(seen), listed, problem.m)
            env.step(plan[k])
        env.reset()
    else:
        plan = sample_episode(problem, network, None).plan
    value = float(sum(env.step(tasks).sum() for tasks in plan))
    return value, (np.asarray(plan) + 1).tolist()


def in_words(plan: list[list[int]]) -> str:
    """A plan as runs of one joint assignment: ``9 x (1,2,3), 1 x (2,3,1)``."""
    runs: list[tuple[list[int], int]] = []
    for row in plan:
        if runs and runs[-1][0] == row:
            runs[-1] = (row, runs[-1][1] + 1)
        else:
            runs.append((row, 1))
    return ", ".join(f"{count} x ({','.join(map(str, row))})" for row, count in runs)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--guide", default="myopic", choices=sorted(GUIDES))
    parser.add_argument("--memory", type=int, default=100, help="episodes that REDA and IQL remember")
    parser.add_argument("--show-step", action="store_true", help="agents see the number of the step as well")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_6_1", argv, seeds=5, quick_seeds=1, add=add_options, resumes=True)
    figure, axes = common.new_figure(7.5, 4.2)
    problem = problems(0)
    episodes = 20 if run.quick else STEPS // problem.T
    report: dict[str, Any] = {}
    for index, method in enumerate(run.chosen("methods", run.options.methods, METHODS)):
        report[method] = []
        for seed in run.seeds:
            folder = run.out / f"{method}-{run.options.guide}-{seed}"
            training = learn(method, seed, run.options, episodes, folder)
            at, values = curve(folder / "log.csv")
            value, plan = settled(method, training.last)
            report[method].append({"seed": seed, "best": training.value, "last": value, "plan": plan})
            label = method.upper() if seed == run.seeds[0] else None
            axes.plot(at, values, color=f"C{index}", alpha=0.6, label=label)
            run.say(
                f"{method} seed {seed}: best evaluation {training.value:.1f}, settled at {value:.1f}: {in_words(plan)}"
            )
    optimum = solve(problem, Exact(method="dp")).value
    greedy = solve(problem, AssignmentPolicy(myopic)).value
    constant = problem.evaluate(np.tile(np.arange(3), (problem.T, 1))).value
    for value, style, label in (
        (optimum, "--", "optimum, proven"), (constant, "-.", "(1,2,3) for ever"), (greedy, ":", "alpha(beta_hat)"),
    ):  # fmt: skip
        axes.axhline(value, color="black", linestyle=style, label=label)
    axes.set(xlabel="environment steps", ylabel="total reward of an episode")
    axes.legend(fontsize=8)
    run.write_figure(figure)
    run.write_json({"runs": report, "optimum": optimum, "constant": constant, "greedy": greedy})


if __name__ == "__main__":
    main()
