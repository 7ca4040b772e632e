"""Figure 6.5 (Holder 2024, section 6.5): the weights of 324 satellites on 1008 and 4225, without training again.

    python -m experiments.fig_6_5 [--seeds 3] [--sizes power,power-1008,power-4425] [--lookahead] [--only NAMES]
                                  [--weights FILE] [--quick] [--out DIR]

Two sets of weights play, both trained on 324 satellites: those of the published code's observation, and those of the
thesis' observation with one function that values every task, which can list more tasks than in training: M = 10 and 60.
For each size also what the thesis explains the failure by: the tasks in view of a satellite against M = 10; how often
the output "any other task", which a policy trained on the small constellation takes for charging, met a task in view
(first episode); and the share of the satellites that have charge at the end. `--lookahead` adds the dual lookahead of
three steps with the learned value of charge, which takes far longer. `--weights` adds weights of your own as
"REDA of a file"; `--only` names the policies that play.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments import common
from experiments.learned import measure
from sapopt import SAP, solve
from sapopt.domains.instances import instance
from sapopt.learning import REDA, Environment
from sapopt.learning.network import listing
from sapopt.solvers import AssignmentPolicy, DualLookahead, energy_price, power_constrained
from sapopt.solvers.charge_value import ChargeValue

FIRST = 2_000_000
"""As in fig_6_4."""

LISTED = 10
"""M, the tasks that an agent of the thesis lists."""

LONG = 60
"""Tasks that an agent of the largest constellation may have in view, nearly always."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--sizes", help="built-in instances, separated by commas")
    parser.add_argument("--lookahead", action="store_true")
    parser.add_argument("--weights", help="a file of weights to play as well")
    parser.add_argument("--only", help="these policies alone, by name, separated by commas")


def in_view(problem: SAP) -> tuple[float, float]:
    """Tasks in view of a satellite, mean over satellites and steps, and the share of these with more than M = 10."""
    counts = np.diff(problem.benefits.flat().indptr)
    return float(counts.mean()), float((counts > LISTED).mean())


def charging_that_drains(problem: SAP, plan: np.ndarray, spec: Any) -> float:
    """Share of the outputs "any other task" that met a task in view: the satellite works where it meant to charge."""
    env = Environment(problem)
    others, worked = 0, 0
    for k, tasks in enumerate(plan):
        _, listed = env.observe(spec)
        other = ~(listed == tasks[:, None]).any(axis=1)
        others += int(other.sum())
        worked += int((other & (problem.benefits.slice(k, k + 1).at(tasks[None])[0] > 0)).sum())
        env.step(tasks)
    return worked / max(others, 1)


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_6_5", argv, seeds=3, quick_seeds=1, add=add_options)
    sizes = (run.options.sizes or ("power,power-1008" if run.quick else "power,power-1008,power-4425")).split(
        ","
    )
    per_task = REDA.load("power-thesis").network
    learned = {
        "REDA": REDA.load("power"),
        "REDA per task with M=10": REDA(per_task),
        f"REDA per task with M={LONG}": REDA(listing(per_task, LONG)),
    }
    if run.options.weights:
        learned["REDA of a file"] = REDA.load(run.options.weights)
    policies: dict[str, Any] = {
        "power-constrained greedy": AssignmentPolicy(power_constrained),
        "energy price": AssignmentPolicy(energy_price),
        **{name: AssignmentPolicy(reda) for name, reda in learned.items()},
    }
    if run.options.lookahead:
        policies["dual lookahead W=3 with the value of charge"] = DualLookahead(
            3, end_value=ChargeValue.load("power")
        )
    if run.options.only:
        policies = {name: policies[name] for name in run.chosen("only", run.options.only, policies)}
    report: dict[str, dict[str, float]] = {}
    for size in sizes:
        problems = [instance(size, FIRST + seed, steps=10 if run.quick else 100) for seed in run.seeds]
        views = [in_view(problem) for problem in problems]
        report[size] = {"tasks in view": float(np.mean([v[0] for v in views]))}
        report[size]["share above M"] = float(np.mean([v[1] for v in views]))
        run.say(f"{size}: " + ", ".join(f"{name} {value:.3f}" for name, value in report[size].items()))
        for name, policy in policies.items():
            plans = [solve(problem, policy).plan for problem in problems]
            played = [measure(problem, plan) for problem, plan in zip(problems, plans, strict=True)]
            report[size][name] = float(np.mean([one.value for one in played]))
            report[size][f"alive, {name}"] = float(np.mean([one.alive for one in played]))
            words = f"{report[size][name]:10.1f}   alive {report[size][f'alive, {name}']:.3f}"
            if name in learned:
                drains = charging_that_drains(problems[0], plans[0], learned[name].network.spec)
                report[size][f"charging that drains, {name}"] = drains
                words += f"   charging that drains {drains:.4f}"
            run.say(f"{size:12s} {name:38s} {words}")
    figure, axes = common.new_figure(7.5, 4.0)
    place = np.arange(len(sizes))
    first = next(iter(policies))
    for index, name in enumerate(policies):
        relative = [report[size][name] / report[size][first] for size in sizes]
        axes.bar(place + 0.15 * index, relative, 0.14, label=name)
    axes.set_xticks(place + 0.3, sizes)
    axes.set_ylabel(f"value over that of {first}")
    axes.set_ylim(top=2.0)
    axes.legend(fontsize=8, ncols=2, loc="upper left")
    run.write_figure(figure)
    run.write_json({"values": report})


if __name__ == "__main__":
    main()
