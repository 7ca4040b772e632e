"""Figure 6.4 (Holder 2024, section 6.4): reward, conflicts, charge and task duration of every policy on batteries.

    python -m experiments.fig_6_4 [--seeds 5] [--iql WEIGHTS] [--ippo WEIGHTS] [--rollouts] [--only NAMES] [--quick]
                                  [--out DIR]

REDA's weights are the two sets that ship: of the published code's observation, and of the thesis' with one function
that values every task. The others are drawn if their weights are given (`fig_6_3.py` leaves them, or `sapopt train`).
`--rollouts` adds rollouts of REDA, which take far longer: what HAAL or the energy price would do now, played on by
REDA to the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from experiments import common
from experiments.learned import by_generator, by_ippo, by_iql, by_policy, network_of
from sapopt.domains.instances import instance
from sapopt.learning import REDA
from sapopt.solvers import (
    HAAL,
    AssignmentPolicy,
    DualLookahead,
    RolloutPolicy,
    energy_price,
    myopic,
    power_constrained,
)
from sapopt.solvers.charge_value import ChargeValue

FIRST = 2_000_000
"""Seeds from here on were seen in no training and in no choice of weights."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--iql", help="weights of IQL")
    parser.add_argument("--ippo", help="weights of IPPO")
    parser.add_argument("--rollouts", action="store_true")
    parser.add_argument("--only", help="these policies alone, by name, separated by commas")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_6_4", argv, seeds=5, quick_seeds=1, add=add_options)
    players = {
        "alpha(beta_hat)": by_generator(myopic),
        "power-constrained greedy": by_generator(power_constrained),
        "energy price": by_generator(energy_price),
        "REDA": by_generator(REDA.load("power")),
        "REDA per task": by_generator(REDA.load("power-thesis")),
    }
    if run.options.iql:
        players["IQL"] = by_iql(network_of(run.options.iql))
        players["IQL's network with alpha"] = by_generator(REDA(network_of(run.options.iql)))
    if run.options.ippo:
        players["IPPO"] = by_ippo(network_of(run.options.ippo))
    if run.options.rollouts:
        reda = AssignmentPolicy(REDA.load("power"))
        players["HAAL L=3 then REDA"] = by_policy(RolloutPolicy(reda, [HAAL(3)]))
        players["energy price then REDA"] = by_policy(RolloutPolicy(reda, [AssignmentPolicy(energy_price)]))
    players["dual lookahead W=3"] = by_policy(DualLookahead(3, end_value=ChargeValue.load("power")))
    if run.options.only:
        players = {name: players[name] for name in run.chosen("only", run.options.only, players)}
    problems = [instance("power", FIRST + seed, steps=20 if run.quick else 100) for seed in run.seeds]
    report = {}
    for name, player in players.items():
        played = [asdict(player(problem)) for problem in problems]
        report[name] = {key: float(np.mean([one[key] for one in played])) for key in played[0]}
        report[name]["error"] = common.mean_and_error([one["value"] for one in played])[1]
        run.say(f"{name:38s}" + "  ".join(f"{key} {value:.3g}" for key, value in report[name].items()))
    figure, axes = common.new_figure(12.0, 3.8, 1, 4, sharey=True)
    for panel, (key, label) in zip(
        axes,
        [
            ("value", "total reward"),
            ("conflicts", "share of work in conflict"),
            ("charge", "mean charge"),
            ("duration", "steps on a task"),
        ],
        strict=True,
    ):
        panel.barh(list(report), [row[key] for row in report.values()])
        panel.set_xlabel(label)
    axes[0].invert_yaxis()
    run.write_figure(figure)
    run.write_json({"policies": report})


if __name__ == "__main__":
    main()
