"""Figure 6.5 (Holder 2024, section 6.5): the weights of 324 satellites on 1008 and 4225, without training again.

    python -m experiments.fig_6_5 [--seeds 3] [--sizes power,power-1008,power-4225] [--lookahead] [--quick] [--out DIR]

`--lookahead` adds the dual lookahead of three steps with the learned value of charge, which takes far longer.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from experiments import common
from experiments.learned import by_generator, by_policy
from sapopt.domains.instances import instance
from sapopt.learning import REDA
from sapopt.solvers import DualLookahead, energy_price, power_constrained
from sapopt.solvers.charge_value import ChargeValue

FIRST = 2_000_000
"""As in fig_6_4."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--sizes", help="built-in instances, separated by commas")
    parser.add_argument("--lookahead", action="store_true")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_6_5", argv, seeds=3, quick_seeds=1, add=add_options)
    sizes = (run.options.sizes or ("power,power-1008" if run.quick else "power,power-1008,power-4225")).split(
        ","
    )
    players = {
        "power-constrained greedy": by_generator(power_constrained),
        "energy price": by_generator(energy_price),
        "REDA": by_generator(REDA.load("power")),
    }
    if run.options.lookahead:
        players["dual lookahead W=3, value of charge"] = by_policy(
            DualLookahead(3, end_value=ChargeValue.load("power"))
        )
    report: dict[str, dict[str, float]] = {}
    for size in sizes:
        problems = [instance(size, FIRST + seed, steps=10 if run.quick else 100) for seed in run.seeds]
        report[size] = {}
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
