"""Table 4.1: objects tracked over the United States, and the value, against alpha(beta) (Holder 2024, section 4.3).

    python -m experiments.table_4_1 [--seeds 3] [--instance tracking-thesis] [--bound SECONDS] [--quick] [--out DIR]

Policies know the objects that have appeared and expect them to go straight on. The thesis: HAAL tracks 85.4 % of the
objects, value 4367.2; alpha(beta) 42.7 %, 2141.6. `tracking-thesis` has its numbers where it gives them (beta_e = 1,
beta_t = 10, eq. 4.3 as it stands, targets along the grid); constellation and number of targets are ours. "Tracked" has
two readings: observed now and a step before by the same satellite, or by any. With `--bound` also the bound of all
plans that know every object in advance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments import common
from sapopt import bound, solve
from sapopt.domains.instances import scenario
from sapopt.solvers import HAAL, DualLookahead, NoHandover

SOLVERS = {
    "alpha(beta)": NoHandover(),
    "HAAL(L=2)": HAAL(2),
    "HAAL(L=3)": HAAL(3),
    "dual lookahead(W=3)": DualLookahead(3, iterations=30),
    "dual lookahead(W=5)": DualLookahead(5, iterations=30),
}


def measure(run: common.Run, seed: int, options: dict[str, Any]) -> list[dict[str, Any]]:
    """One record for each solver."""
    scene = scenario(run.options.instance, seed, **options)
    made = scene.synthetic()
    run.say(f"seed {seed}: {made.problem}, {100 * scene.coverable():.1f} % of the objects can be tracked")
    records = []
    for name, solver in SOLVERS.items():
        result = solve(made.problem, solver, forecast=scene.forecast())
        tidy = made.tidied(result.plan)
        record = {
            "solver": name,
            "seed": seed,
            "value": made.problem.evaluate(tidy).value,
            "tracked": scene.tracked(tidy),
            "by_any": scene.tracked(tidy, by="any"),
            "seconds": result.runtime,
        }
        records.append(record)
        shares = f"tracked {100 * record['tracked']:5.1f} %, by any {100 * record['by_any']:5.1f} %"
        run.say(f"  {name:22s} value {record['value']:8.1f}   {shares}")
    if run.options.bound:
        top = bound(made.problem, time_limit=run.options.bound).value
        records.append({"solver": "bound, all known in advance", "seed": seed, "value": top})
        run.say(f"  no plan is worth more than {top:.1f}")
    return records


def main(argv: Sequence[str] | None = None) -> None:
    def add(parser: Any) -> None:
        parser.add_argument("--instance", default="tracking-thesis", help="or tracking, which asks for sight")
        parser.add_argument("--bound", type=float, metavar="SECONDS", help="prove a bound, for so long")

    run = common.begin(__doc__, "table_4_1", argv, seeds=3, quick_seeds=1, add=add)
    options = {"steps": 20, "planes": 20} if run.quick else {}
    records = [record for seed in run.seeds for record in measure(run, seed, options)]
    table = {}
    for name in dict.fromkeys(record["solver"] for record in records):
        mine = [record for record in records if record["solver"] == name]
        table[name] = {
            key: common.mean_and_error([record[key] for record in mine])
            for key in ("value", "tracked", "by_any")
            if key in mine[0]
        }
    blind = table["alpha(beta)"]
    for name, row in table.items():
        shares = ""
        if "tracked" in row:
            shares = f"{100 * row['tracked'][0]:5.1f} % tracked, {100 * row['by_any'][0]:5.1f} % by any, "
        ratio = row["value"][0] / blind["value"][0]
        print(
            f"{name:28s} value {row['value'][0]:8.1f} +- {row['value'][1]:.1f}, {shares}{ratio:.2f} x alpha(beta)"
        )
    run.write_json({"scenario": options, "table": table, "runs": records})
    figure, axes = common.new_figure(7.2, 3.2, 1, 2)
    for ax, key, label in zip(axes, ("value", "tracked"), ("value", "share of objects tracked"), strict=True):
        names = [name for name in SOLVERS if key in table[name]]
        means, errors = np.array([table[name][key] for name in names]).T
        ax.barh(names, means, xerr=errors, color="#0072B2")
        ax.invert_yaxis()
        ax.set_xlabel(label)
        ax.spines[["top", "right"]].set_visible(False)
    axes[1].set_yticklabels([])
    run.write_figure(figure)


if __name__ == "__main__":
    main()
