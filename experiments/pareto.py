"""What handovers are worth: the best value of plans with at most so many of them, between proven bounds.

    python -m experiments.pareto [--instance constellation-toy] [--points 10] [--seconds 10] [--quick] [--out DIR]

Handovers cost nothing here; agents may idle; `Limit.handovers` bounds how many there are in all. For each number h one
plan is sought, and proven as far as time allows: its bound holds for h and for fewer. The dual's prices bound the value
for every other number of handovers too: by the bound at h, plus the price of a handover for each one more. So the curve
lies in a band, between the staircase of the plans and the lowest of the bounds.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from experiments import common
from sapopt import SAP, Limit, SwitchingCost, bound, solve
from sapopt.data.types import FloatArray
from sapopt.domains.instances import instance
from sapopt.solvers import DualDecomposition


class Point(NamedTuple):
    """What is proven about one number of handovers."""

    most: int
    value: float
    bound: float
    dual: float
    price: float


def limited(base: SAP, most: int | None) -> SAP:
    """The problem with at most so many handovers, all agents together."""
    limits = [] if most is None else [Limit.handovers(most)]
    return SAP(base.benefits, SwitchingCost(0.0), base.initial_assignment, idle=True, limits=limits)


def measured(base: SAP, most: int, seconds: float, seed: int) -> Point:
    """A plan for a number of handovers, its bound, and the dual's bound with the price of a handover."""
    problem = limited(base, most)
    result = solve(problem, DualDecomposition(), seed=seed, time_limit=seconds)
    proven = bound(problem, time_limit=seconds)
    assert proven.limit_prices is not None
    best = proven.value if result.bound is None else min(proven.value, result.bound)
    return Point(most, result.value, best, proven.value, max(float(proven.limit_prices[0]), 0.0))


def lower(points: list[Point], counts: FloatArray) -> FloatArray:
    """What plans reach with at most so many handovers; 0 is what idling is worth."""
    return np.array([max([0.0] + [p.value for p in points if p.most <= h]) for h in counts])


def upper(points: list[Point], counts: FloatArray) -> FloatArray:
    """What no plan exceeds."""
    out = np.full(len(counts), np.inf)
    for point in points:
        out = np.minimum(out, point.dual + point.price * (counts - point.most))
        out = np.where(counts <= point.most, np.minimum(out, point.bound), out)
    return out


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--instance", default="constellation-toy")
    parser.add_argument("--points", type=int, help="numbers of handovers tried (default 10, quick 4)")
    parser.add_argument(
        "--seconds", type=float, help="time of each plan and of each bound (default 10, quick 2)"
    )


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "pareto", argv, add=add_options)
    seconds = run.options.seconds or (2.0 if run.quick else 10.0)
    wanted = run.options.points or (4 if run.quick else 10)
    report: dict[str, Any] = {}
    figure, axes = common.new_figure(7.2, 4.2)
    for seed in run.seeds:
        base = instance(run.options.instance, seed)
        common.warm(limited(base, 1), DualDecomposition())
        free = solve(limited(base, None), DualDecomposition(), seed=seed, time_limit=seconds)
        run.say(f"without a limit: {free}")
        points = []
        for most in np.unique(np.linspace(0, free.handovers, wanted + 1).astype(int)):
            point = measured(base, int(most), seconds, seed)
            gap = (point.bound - point.value) / max(abs(point.value), 1e-12)
            run.say(
                f"  at most {most:5} handovers: {point.value:10.3f}, at most {point.bound:10.3f}, {gap:.3%}"
            )
            points.append(point)
        counts = np.arange(free.handovers + 1, dtype=np.float64)
        low, high = lower(points, counts), upper(points, counts)
        axes.fill_between(counts, low, high, step="post", alpha=0.35, lw=0, label=f"seed {seed}: not settled")
        axes.plot(
            [p.most for p in points],
            [p.value for p in points],
            "o-",
            ms=4,
            lw=1.2,
            label=f"seed {seed}: plans",
        )
        report[str(seed)] = {"points": [p._asdict() for p in points], "lower": low, "upper": high,
                             "free_value": free.value, "free_handovers": free.handovers}  # fmt: skip
        run.write_json(report)
    axes.set(xlabel="handovers, at most", ylabel="value", xlim=(0, None), ylim=(0, None))
    axes.set_title(f"{run.options.instance}: what handovers are worth", fontsize=10, loc="left")
    axes.legend(frameon=False, loc="lower right")
    run.write_figure(figure)


if __name__ == "__main__":
    main()
