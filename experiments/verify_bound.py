"""Does HAAL keep the promise of theorem 3.5.1, at least c/(1+c) of the optimum? Random and adversarial instances.

    python -m experiments.verify_bound [--quick] [--seeds 200] [--out results/verify_bound]

`--seeds` is the number of random instances per setting. `--quick` takes about two minutes on two idle cores.

Random instances: a sweep over (n, m, T, L, cost); the exact optimum by dynamic programming over all assignments.
Adversarial instances: simulated annealing maximises the loss of HAAL (see `theorem_search`), once from random
starts and once from the known instances, which shows what the search can reach and what it cannot find by itself.
All values are integers. Adding a constant to all benefits moves an instance along c without changing HAAL's loss D;
the theorem is violated at some c where D > T |H|.

Writes a table (JSON) and a figure: ratio against c, with the curve c/(1+c).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments import common, theorem
from experiments import theorem_search as search
from sapopt.plotting import ratio_against_c

RANDOM = [
    # n, m, T
    (2, 2, 4), (2, 3, 3), (2, 3, 6), (2, 4, 8), (3, 3, 5), (3, 4, 5), (3, 5, 8), (4, 5, 5),
]  # fmt: skip
ADVERSARIAL = [
    (2, 3, 3, 1),
    (2, 3, 3, 2),
    (2, 3, 3, 3),
    (2, 4, 6, 2),
    (2, 4, 6, 6),
    (3, 4, 5, 3),
    (3, 4, 5, 4),
    (3, 5, 8, 8),
]
COST = 100
SHIFTS = (0, 5, 20, 50, 100, 200, 500, 1000, 2000, 5000, 20_000, 100_000)
Row = dict[str, Any]


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "verify_bound", argv, seeds=200, quick_seeds=30)
    rounds, starts = (40_000, 3) if run.quick else (400_000, 12)
    rows = [row for shape in RANDOM for row in random_rows(*shape, run.seeds)]
    rows += [row for setting in ADVERSARIAL for row in adversarial_rows(*setting, rounds, starts)]
    rows += known_rows(rounds // 4)
    print_table(rows)
    run.write_json({"rounds": rounds, "starts": starts, "rows": rows})
    run.write_figure(draw(rows), dpi=130)


def measure(benefits: np.ndarray, cost: int, start: int, lookahead: int, source: str) -> list[Row]:
    """Values of HAA, HAAL and HAAL+ on one instance and on its shifts along c."""
    T, n, m = benefits.shape
    rows = search.assignments(n, m)
    eta = search.moves(rows, cost)
    sums = search.static(benefits, rows)
    best = int(search.optimum(sums, eta, start))
    value = {
        "HAA": int(search.haal(sums, eta, start, 1, False)),
        "HAAL": int(search.haal(sums, eta, start, lookahead, False)),
        "HAAL+": int(search.haal(sums, eta, start, lookahead, True)),
    }
    least = int(np.diff(sums, axis=0).min())
    out = []
    for shift in SHIFTS if source != "random" else (0,):
        more = shift * cost // 100
        c = (least + n * more) / (n * cost)
        top = best + T * n * more
        if top <= 0:
            continue
        for name, reached in value.items():
            out.append(
                {
                    "source": source, "n": n, "m": m, "T": T, "L": 1 if name == "HAA" else lookahead, "cost": cost,
                    "solver": name, "c": c, "promised": c / (1 + c), "ratio": (reached + T * n * more) / top,
                    "loss_in_H": (best - reached) / (n * cost),
                    # in integers: (1 + c) V < c V*, times n cost
                    "violated": (n * cost + least + n * more) * (reached + T * n * more) < (least + n * more) * top,
                }
            )  # fmt: skip
    return out


def random_rows(n: int, m: int, T: int, seeds: Sequence[int]) -> list[Row]:
    """Uniform integer benefits of 0..100 over a floor, with costs from small to large."""
    out = []
    for cost in (10, 50, 200):
        for lookahead in sorted({1, 2, 3, T}):
            for seed in seeds:
                rng = np.random.default_rng([n, m, T, cost, lookahead, seed])
                floor = int(rng.choice([0, 20, 100, 300]))
                benefits = rng.integers(0, 101, (T, n, m)) + floor
                out += measure(benefits, cost, 0, lookahead, "random")
    return out


def adversarial_rows(n: int, m: int, T: int, lookahead: int, rounds: int, starts: int) -> list[Row]:
    """The worst instances that annealing finds from random starts, each measured at several c."""
    assignments = search.assignments(n, m)
    eta = search.moves(assignments, COST)
    palette = COST * np.arange(13) // 2 + np.array([0, 1, -1, 5, 0, 1, -1, 5, 0, 1, -1, 5, 0])
    palette = np.maximum(palette, 0)
    worst: tuple[int, np.ndarray] | None = None
    if T >= 8:  # where violations are; they take some looking
        rounds *= 4
    for seed in range(starts):
        begin = np.random.default_rng([n, m, T, lookahead, seed]).choice(palette, (T, n, m))
        found, lost = search.anneal(begin, assignments, eta, 0, lookahead, False, palette, COST, rounds, seed)
        if worst is None or lost > worst[0]:
            worst = int(lost), found
    assert worst is not None
    return measure(worst[1], COST, 0, lookahead, "search")


def known_rows(rounds: int) -> list[Row]:
    """The known counterexamples of the simple model, as they are and after some annealing."""
    out = []
    for entry in theorem.load():
        if "benefits" not in entry or entry["algorithm"] != "HAAL":
            continue
        cost, lookahead = int(entry["cost"]), entry["lookahead"]
        benefits = np.array(entry["benefits"], dtype=np.int64)
        benefits -= benefits.min()  # c as small as possible; the shifts bring it back
        assignments = search.assignments(*benefits.shape[1:])
        start = [tuple(row) for row in assignments.tolist()].index(tuple(entry["initial_assignment"]))
        out += measure(benefits, cost, start, lookahead, "known")
        eta = search.moves(assignments, cost)
        palette = np.unique(benefits)
        found, _ = search.anneal(
            benefits, assignments, eta, start, lookahead, False, palette, cost, rounds, 0
        )
        out += measure(found, cost, start, lookahead, "known, annealed")
    return out


def print_table(rows: list[Row]) -> None:
    """The worst of every setting; HAAL's loss in units of |H| against the T - 1 that L <= 2 guarantees."""
    print(f"{'source':16} {'solver':6} {'n':>2} {'m':>2} {'T':>2} {'L':>2} {'count':>6} {'worst ratio':>12} "
          f"{'at c':>7} {'c/(1+c)':>8} {'loss/|H|':>9} {'T':>2} {'violations':>10}")  # fmt: skip
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        key = tuple(row[name] for name in ("source", "solver", "n", "m", "T", "L"))
        groups.setdefault(key, []).append(row)
    for key, group in groups.items():
        low = min(group, key=lambda row: row["ratio"] - row["promised"])
        lost = max(row["loss_in_H"] for row in group)
        count = sum(row["violated"] for row in group)
        source, solver, n, m, T, L = key
        print(f"{source:16} {solver:6} {n:>2} {m:>2} {T:>2} {L:>2} {len(group):>6} {low['ratio']:>12.4f} "
              f"{low['c']:>7.2f} {low['promised']:>8.4f} {lost:>9.3f} {T:>2} {count:>10}")  # fmt: skip


def draw(rows: list[Row]) -> Figure:
    """Ratio against c, one panel per solver, with the curve of the theorem."""
    panels = ("HAA", "HAAL", "HAAL+")
    figure, axes = common.new_figure(13, 4.4, 1, 3, sharey=True)
    for axis, solver in zip(axes, panels, strict=True):
        those = [row for row in rows if row["solver"] == solver]
        points = {
            source: [(row["c"], row["ratio"]) for row in those if row["source"] == source]
            for source in ("random", "search", "known", "known, annealed")
        }
        broken = [(row["c"], row["ratio"]) for row in those if row["violated"] and row["c"] > 0]
        ratio_against_c(points, broken, ax=axis)
        axis.set_title(f"{solver}: {len(broken)} violations" + (" (ringed)" if broken else ""))
        axis.set_ylabel("")
        axis.set_xlim(7e-3, 2.5e3)  # no tick at the edge, where it would touch that of the next panel
    axes[0].set_ylabel("value / optimum")
    axes[0].legend(loc="lower right", framealpha=1.0)
    return figure


if __name__ == "__main__":
    main()
