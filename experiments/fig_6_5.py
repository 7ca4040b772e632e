"""Figure 6.5 (Holder 2024, section 6.5): the weights of 324 satellites on 1008 and 4225, without training again.

    python -m experiments.fig_6_5 [--seeds 3] [--sizes power,power-1008,power-4425] [--lookahead] [--quick] [--out DIR]

For each size also what the thesis explains the failure by: the tasks in view of a satellite against M = 10, and how
often the output "any other task", which a policy trained on the small constellation takes for charging, met a task in
view. `--lookahead` adds the dual lookahead of three steps with the learned value of charge, which takes far longer.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments import common
from experiments.learned import by_generator, by_policy
from sapopt import SAP, solve
from sapopt.domains.instances import instance
from sapopt.learning import REDA, Environment
from sapopt.solvers import AssignmentPolicy, DualLookahead, energy_price, power_constrained
from sapopt.solvers.charge_value import ChargeValue

FIRST = 2_000_000
"""As in fig_6_4."""

LISTED = 10
"""M, the tasks that an agent of the thesis lists."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--sizes", help="built-in instances, separated by commas")
    parser.add_argument("--lookahead", action="store_true")


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
    reda = REDA.load("power")
    players = {
        "power-constrained greedy": by_generator(power_constrained),
        "energy price": by_generator(energy_price),
        "REDA": by_generator(reda),
    }
    if run.options.lookahead:
        players["dual lookahead W=3, value of charge"] = by_policy(
            DualLookahead(3, end_value=ChargeValue.load("power"))
        )
    report: dict[str, dict[str, float]] = {}
    for size in sizes:
        problems = [instance(size, FIRST + seed, steps=10 if run.quick else 100) for seed in run.seeds]
        views = [in_view(problem) for problem in problems]
        report[size] = {"tasks in view": float(np.mean([v[0] for v in views]))}
        report[size]["share above M"] = float(np.mean([v[1] for v in views]))
        plan = solve(problems[0], AssignmentPolicy(reda)).plan
        report[size]["charging that drains"] = charging_that_drains(problems[0], plan, reda.network.spec)
        run.say(f"{size}: " + ", ".join(f"{name} {value:.3f}" for name, value in report[size].items()))
        for name, player in players.items():
            report[size][name] = float(np.mean([player(problem).value for problem in problems]))
            run.say(f"{size:12s} {name:38s} {report[size][name]:10.1f}")
    figure, axes = common.new_figure(7.5, 4.0)
    place = np.arange(len(sizes))
    for index, name in enumerate(players):
        relative = [report[size][name] / report[size]["power-constrained greedy"] for size in sizes]
        axes.bar(place + 0.2 * index, relative, 0.18, label=name)
    axes.set_xticks(place + 0.2, sizes)
    axes.set_ylabel("value over the power-constrained greedy")
    axes.legend(fontsize=8)
    run.write_figure(figure)
    run.write_json({"values": report})


if __name__ == "__main__":
    main()
