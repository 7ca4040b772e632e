"""NoHandover, HAA, HAAL and the optimum over random 5x5x3 problems (thesis, the published code).

    python -m experiments.fig_optimal_comparison [--seeds 50] [--cost 0.5] [--quick] [--out DIR]

Benefits are uniform on [0, 1]; five agents, five tasks, three steps; the first step is free. Writes a table (JSON)
and a figure.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from experiments import common
from sapopt import SAP, Status, SwitchingCost, solve
from sapopt.solvers import HAA, HAAL, NoHandover
from sapopt.solvers.exact import Exact

N, M, T = 5, 5, 3


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(
        __doc__, "fig_optimal_comparison", argv, seeds=50, quick_seeds=10,
        add=lambda parser: parser.add_argument("--cost", type=float, default=0.5),
    )  # fmt: skip
    cost = run.options.cost
    solvers = {"NoHandover": NoHandover(), "HAA": HAA(), "HAAL, L = 3": HAAL(T), "optimum": Exact()}
    values: dict[str, list[float]] = {name: [] for name in solvers}
    for seed in run.seeds:
        problem = SAP(np.random.default_rng(seed).random((T, N, M)), SwitchingCost(cost))
        for name, solver in solvers.items():
            result = solve(problem, solver)
            if name == "optimum" and result.status is not Status.OPTIMAL:
                raise RuntimeError(f"problem {seed}: the optimum was not proven")
            values[name].append(result.value)
    best = np.array(values["optimum"])
    table = {}
    for name, reached in values.items():
        share = np.array(reached) / best
        table[name] = {
            "mean": float(np.mean(reached)), "share": float(share.mean()), "worst share": float(share.min()),
            "optimal": int((share > 1 - 1e-7).sum()),
        }  # fmt: skip
        print(f"{name:12} mean {table[name]['mean']:.4f}  share of the optimum {100 * share.mean():6.2f} %  "
              f"worst {100 * share.min():6.2f} %  optimal in {table[name]['optimal']} of {len(run.seeds)}")  # fmt: skip
    run.write_json({"cost": cost, "shape": [T, N, M], "table": table, "values": values})
    run.write_figure(draw(values, cost), dpi=130)


def draw(values: dict[str, list[float]], cost: float) -> Figure:
    """Values problem by problem, sorted by the optimum, and their means."""
    colours = {"NoHandover": "#9aa5b1", "HAA": "#1f77b4", "HAAL, L = 3": "#d95f02", "optimum": "black"}
    order = np.argsort(values["optimum"])
    figure, (left, right) = common.new_figure(11, 4, 1, 2, width_ratios=(2, 1))
    for name, reached in values.items():
        line = name == "optimum"
        left.plot(
            np.array(reached)[order], "-" if line else "o", ms=4, lw=1.5, color=colours[name], label=name
        )
    left.set(
        xlabel="problem, sorted by its optimum", ylabel="value", title=f"random 5x5x3 problems, cost {cost:g}"
    )
    left.legend(loc="upper left")
    left.grid(alpha=0.25)
    means = [float(np.mean(reached)) for reached in values.values()]
    bars = right.bar(range(len(means)), means, color=[colours[name] for name in values])
    right.bar_label(bars, fmt="%.2f")
    right.set_xticks(
        range(len(means)), [name.replace(", ", "\n").replace("NoHandover", "no\nhandover") for name in values]
    )
    right.set(title="mean", ylim=(min(0.0, *means), 1.1 * max(means)))
    return figure


if __name__ == "__main__":
    main()
