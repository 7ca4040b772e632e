"""Table 4.2: internet satellites with ten beams each, against alpha(beta) (Holder 2024, section 4.4).

    python -m experiments.table_4_2 [--seeds 3] [--instance multi-beam-us] [--quick] [--out results/table_4_2]

The thesis: HAAL 3334.6, alpha(beta) 1232.2. Its constellation, "over the United States", is not given; ours is that of
the instance ``multi-beam-us``, or with `--instance` of ``multi-beam``, whose tasks lie on the whole Earth. The dual
lookahead plays the problem of identical beams, with ranks priced after alpha(beta); its plan is scored, as all are,
with the true decay and the handovers of the real satellites. The bound comes from the same relaxation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments import common
from sapopt import solve
from sapopt.domains.instances import scenario
from sapopt.solvers import HAA, HAAL, DualLookahead, NoHandover

SOLVERS = {"alpha(beta)": NoHandover(), "HAA": HAA(), "HAAL(L=3)": HAAL(3), "HAAL(L=6)": HAAL(6)}
DUAL = "dual lookahead(W=6)"


def measure(run: common.Run, seed: int, options: dict[str, Any]) -> list[dict[str, Any]]:
    """One record for each solver, and the bound."""
    made = scenario(run.options.instance, seed, **options).synthetic(
        0.5, idle_is_free=run.options.idle_is_free
    )
    run.say(f"seed {seed}: {made.problem}")
    records: list[dict[str, Any]] = []
    plans: dict[str, Any] = {}

    def record(name: str, plan: Any, seconds: float) -> None:
        tidy = made.tidied(plan)
        plans[name] = tidy
        value = made.problem.evaluate(tidy).value
        records.append(
            {
                "solver": name,
                "seed": seed,
                "value": value,
                "handovers": made.handovers(tidy),
                "seconds": seconds,
            }
        )
        run.say(f"  {name:22s} value {value:8.1f}   {records[-1]['handovers']} handovers")

    for name, solver in SOLVERS.items():
        if not (run.quick and name == "HAAL(L=6)"):
            result = solve(made.problem, solver)
            record(name, result.plan, result.runtime)
    alike, _ = made.alike(plans["alpha(beta)"])
    result = solve(alike, DualLookahead(6, iterations=30))
    record(DUAL, result.plan, result.runtime)
    if run.options.bound:
        top = made.bound(plans[DUAL], time_limit=run.options.bound).value
        records.append({"solver": "bound", "seed": seed, "value": top})
        run.say(f"  no plan is worth more than {top:.1f}")
    return records


def main(argv: Sequence[str] | None = None) -> None:
    def add(parser: Any) -> None:
        parser.add_argument("--instance", default="multi-beam-us", help="or multi-beam")
        parser.add_argument("--bound", type=float, metavar="SECONDS", help="prove a bound, for so long")
        parser.add_argument("--idle-is-free", action="store_true", help="charge only tasks in view")

    run = common.begin(__doc__, "table_4_2", argv, seeds=3, quick_seeds=1, add=add)
    options = {"steps": 20} if run.quick else {}
    records = [record for seed in run.seeds for record in measure(run, seed, options)]
    names = list(dict.fromkeys(record["solver"] for record in records))
    table = {
        name: common.mean_and_error([r["value"] for r in records if r["solver"] == name]) for name in names
    }
    for name, (mean, error) in table.items():
        print(f"{name:22s} value {mean:8.1f} +- {error:.1f}")
    run.write_json({"scenario": options, "table": table, "runs": records})
    figure, ax = common.new_figure(6.4, 2.8)
    means, errors = np.array([table[name] for name in names]).T
    ax.barh(names, means, xerr=errors, color=["#D55E00" if name == "bound" else "#0072B2" for name in names])
    ax.invert_yaxis()
    ax.set_xlabel("value")
    ax.spines[["top", "right"]].set_visible(False)
    run.write_figure(figure)


if __name__ == "__main__":
    main()
