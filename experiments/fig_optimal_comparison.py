"""NoHandover, HAA, HAAL and the optimum over random 5x5x3 problems (thesis, section 4.1).

    python experiments/fig_optimal_comparison.py [--seeds 50] [--cost 0.5] [--out results/optimal_comparison]

Benefits are uniform on [0, 1]; five agents, five tasks, three steps; the first step is free. Writes a table (JSON)
and a figure.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from sapopt import SAP, Status, SwitchingCost, solve
from sapopt.solvers import HAA, HAAL, NoHandover
from sapopt.solvers.exact import Exact

N, M, T = 5, 5, 3


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=50, help="problems")
    parser.add_argument("--cost", type=float, default=0.5)
    parser.add_argument("--quick", action="store_true", help="ten problems")
    parser.add_argument("--out", type=Path, default=Path("results/optimal_comparison"))
    options = parser.parse_args()
    seeds = 10 if options.quick else options.seeds
    solvers = {"NoHandover": NoHandover(), "HAA": HAA(), "HAAL, L = 3": HAAL(T), "optimum": Exact()}
    values: dict[str, list[float]] = {name: [] for name in solvers}
    for seed in range(seeds):
        problem = SAP(np.random.default_rng(seed).random((T, N, M)), SwitchingCost(options.cost))
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
              f"worst {100 * share.min():6.2f} %  optimal in {table[name]['optimal']} of {seeds}")  # fmt: skip
    options.out.mkdir(parents=True, exist_ok=True)
    report = {"seeds": seeds, "cost": options.cost, "shape": [T, N, M], "table": table, "values": values}
    (options.out / "optimal_comparison.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(values, options.cost, options.out / "optimal_comparison.png")


def draw(values: dict[str, list[float]], cost: float, path: Path) -> None:
    """Values problem by problem, sorted by the optimum, and their means."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    colours = {"NoHandover": "#9aa5b1", "HAA": "#1f77b4", "HAAL, L = 3": "#d95f02", "optimum": "black"}
    order = np.argsort(values["optimum"])
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), width_ratios=(2, 1), layout="constrained")
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
    right.set_xticks(range(len(means)), [name.replace(", ", "\n") for name in values])
    right.set(title="mean", ylim=(min(0.0, *means), 1.1 * max(means)))
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    main()
