"""Figure 4.3 (Holder 2024): value and communication rounds against the lookahead, 324 satellites and 450 tasks.

    python -m experiments.fig_4_3 [--seeds 1] [--compare-seeds 10] [--steps 93] [--workers 2] [--quick] [--out DIR]

The curves are means over the first `--seeds` draws of the tasks. HAAL-D and CBBA at L = 3 are compared over
`--compare-seeds` draws. Runs are kept in DIR/fig_4_3_runs.json; a second call does only what is missing.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments import common
from experiments.distributed_runs import LABELS, Job, Run, curve, run_all
from sapopt.plotting import PALETTE, value_against_lookahead

CURVES = ("dual", "HAAL", "HAALD", "CBBA")
FLAT = ("greedy", "no handover")
LOOKAHEADS = range(1, 7)
COLORS = dict(zip(("HAALD", "CBBA", "dual", "HAAL", "greedy", "no handover"), PALETTE, strict=True))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument(
        "--compare-seeds", type=int, help="draws for HAAL-D against CBBA (default 10, quick 2)"
    )
    parser.add_argument("--steps", type=int, help="default 93, quick 10")
    parser.add_argument("--workers", type=int, default=2, help="processes")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "fig_4_3", argv, add=add_options, resumes=True)
    options = run.options
    steps = options.steps or (10 if run.quick else 93)
    compared_seeds = range(options.compare_seeds or (2 if run.quick else 10))

    def job(seed: int, method: str, lookahead: int) -> Job:
        return Job("constellation-mid", seed, steps, method, lookahead)

    drawn = [job(seed, method, length) for seed in run.seeds for method in CURVES for length in LOOKAHEADS]
    drawn += [job(seed, method, 1) for seed in run.seeds for method in FLAT]
    compared = [job(seed, method, 3) for seed in compared_seeds for method in ("HAALD", "CBBA")]
    jobs = list(dict.fromkeys([*drawn, *compared]))
    runs = {one.job: one for one in run_all(jobs, run.out / "fig_4_3_runs.json", options.workers)}
    run.write_figure(draw([runs[one] for one in drawn]), dpi=160)
    table([runs[one] for one in drawn])
    gain = compare([runs[one] for one in compared])
    run.write_json({"comparison": gain, "runs": [asdict(runs[one]) for one in jobs]})


def draw(runs: list[Run]) -> Figure:
    """Two panels: value, rounds."""
    figure, (left, right) = common.new_figure(10.5, 4.2, 1, 2)
    values = {}
    for method in CURVES:
        lookaheads, found = curve(runs, method, "value")
        values[LABELS[method]] = dict(zip(lookaheads, found, strict=True))
        if method != "HAAL":
            rounds = curve(runs, method, "rounds")[1].mean(axis=1)
            right.plot(lookaheads, rounds, color=COLORS[method], marker="o", ms=4.5)
    levels = {LABELS[method]: curve(runs, method, "value")[1].mean() for method in FLAT}
    value_against_lookahead(values, None, levels, {LABELS[key]: color for key, color in COLORS.items()}, left)
    left.set_xlabel("lookahead L (window W)")
    right.set(xlabel="lookahead L (window W)", ylabel="communication rounds a step")
    right.set_xticks(list(LOOKAHEADS))
    right.set_ylim(bottom=0)
    right.grid(axis="y", color="#EEEEEE")
    right.spines[["top", "right"]].set_visible(False)
    handles, labels = left.get_legend_handles_labels()
    own = left.get_legend()
    if own is not None:  # one legend for both panels
        own.remove()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure


def table(runs: list[Run]) -> None:
    """Print every mean."""
    print(
        f"{'method':36s}{'L':>2}{'value':>9}{'handovers':>10}{'rounds':>8}{'messages':>10}{'MB':>8}{'ms/step':>9}"
    )
    for method in (*CURVES, *FLAT):
        for length in sorted({one.job.lookahead for one in runs if one.job.method == method}):
            those = [one for one in runs if one.job.method == method and one.job.lookahead == length]
            cells = [
                float(np.mean([getattr(one, what) for one in those]))
                for what in ("value", "handovers", "rounds", "messages", "megabytes", "seconds_per_step")
            ]
            print(
                f"{LABELS[method]:36s}{length:2d}{cells[0]:9.1f}{cells[1]:10.0f}{cells[2]:8.1f}{cells[3]:10.0f}"
                f"{cells[4]:8.1f}{1e3 * cells[5]:9.0f}"
            )


def compare(runs: list[Run]) -> dict[str, Any]:
    """HAAL-D against CBBA at L = 3, seed by seed."""
    haald = np.array([one.value for one in runs if one.job.method == "HAALD"])
    cbba = np.array([one.value for one in runs if one.job.method == "CBBA"])
    gain, error = common.mean_and_error(100 * (haald / cbba - 1))
    print(
        f"L = 3, {len(haald)} seeds: HAAL-D {haald.mean():.1f}, CBBA {cbba.mean():.1f}; "
        f"HAAL-D is {gain:.1f} +- {error:.1f} % above CBBA (the thesis: about 50 %)"
    )
    return {
        "lookahead": 3,
        "seeds": len(haald),
        "haal_d": haald.mean(),
        "cbba": cbba.mean(),
        "gain_percent": gain,
        "standard_error": error,
    }


if __name__ == "__main__":
    main()
