"""How fast the methods are once everything is compiled, beside another checkout.

    python -m experiments.benchmarks.warm --against DIR [--turns 3] [--only NAME ...] [--out FILE]

Every turn starts a process for this checkout and one for the other, one after the other, and takes the least of a few
runs in each: the two see the same machine. Seconds by the clock and of the processors, with the ratios of this checkout
to the other; values that differ are shown. The last case is the first one with its benefits as a dense array: the two
should take equally long and play the same plan.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

CASES = (
    "HAAL(6), mid", "HAAL(6), large, 30 steps", "HAAL(6), shells, 12 steps", "DualLookahead(6), mid, 15 steps",
    "CBBA(3), mid, 3 steps", "ascent, mid, 150 iterations", "ascent, large, 40 iterations", "window, shells, 6 steps",
    "HAAL(6), mid, dense form",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", type=Path, metavar="DIR", help="another checkout to compare with")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--out", help="file for the JSON")
    parser.add_argument("--case", choices=CASES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case is not None:
        print(json.dumps(_measured(options.case)))
        return
    from experiments.benchmarks.output import (  # the processes for another checkout have no use for it
        checkouts,
        finish,
    )

    folders = checkouts(parser, options.against)
    rows = []
    for case in options.only:
        found: dict[str, list[dict[str, float]]] = {name: [] for name in folders}
        for _ in range(options.turns):
            for name, folder in folders.items():
                found[name].append(_in_process(folder, case))
        rows.append({"case": case, **found})
        told = "   ".join(
            f"{name} {min(x['wall'] for x in runs):.3f} s, {min(x['processor'] for x in runs):.3f} s"
            for name, runs in found.items()
        )
        if len(found) > 1:
            this, other = list(found.values())
            ratios = [min(x[c] for x in this) / min(x[c] for x in other) for c in ("wall", "processor")]
            told += f"   ratio {ratios[0]:.2f}, {ratios[1]:.2f}"
        values = {x["value"] for runs in found.values() for x in runs}
        print(f"{case:34s} {told}   {'equal' if len(values) == 1 else values}", file=sys.stderr)
    finish({"turns": options.turns, "rows": rows}, options.out)


def _in_process(folder: Path, case: str) -> dict[str, float]:
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, str(Path(__file__).resolve()), "--case", case], cwd=folder, env=environment,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    answer: dict[str, float] = json.loads(done.stdout)
    return answer


def _measured(case: str) -> dict[str, float]:
    run, repeats = _prepared(case)
    run()  # compiles
    best = {"wall": float("inf"), "processor": float("inf"), "value": 0.0}
    for _ in range(repeats):
        wall, processor = time.perf_counter(), time.process_time()
        best["value"] = run()
        best["wall"] = min(best["wall"], time.perf_counter() - wall)
        best["processor"] = min(best["processor"], time.process_time() - processor)
    return best


def _prepared(case: str) -> tuple[Callable[[], float], int]:
    """What to run, and how often."""
    from sapopt import SAP, solve
    from sapopt.domains.instances import instance
    from sapopt.formulations.dual import ascend
    from sapopt.solvers import CBBA, HAAL, DualDecomposition, DualLookahead

    # as `experiments.benchmarks.window` plans its window
    planner = DualDecomposition(iterations=80, rounds=0, sweeps=0, repricing=0)

    def cut(name: str, steps: int) -> SAP:
        problem = instance(f"constellation-{name}")
        return SAP(problem.benefits.slice(0, steps), problem.dynamics, problem.initial_assignment)

    def dense(problem: SAP) -> SAP:
        return SAP(problem.benefits.dense(), problem.dynamics, problem.initial_assignment)

    def solving(problem: SAP, solver: Any) -> Callable[[], float]:
        return lambda: float(solve(problem, solver).value)

    def ascending(problem: SAP, iterations: int) -> Callable[[], float]:
        oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
        return lambda: float(ascend(oracle, None, callback=lambda done, *_: done >= iterations).bound)

    cases: dict[str, Callable[[], tuple[Callable[[], float], int]]] = {
        CASES[0]: lambda: (solving(cut("mid", 93), HAAL(6)), 12),
        CASES[1]: lambda: (solving(cut("large", 30), HAAL(6)), 12),
        CASES[2]: lambda: (solving(cut("shells", 12), HAAL(6)), 3),
        CASES[3]: lambda: (solving(cut("mid", 15), DualLookahead(6)), 8),
        CASES[4]: lambda: (solving(cut("mid", 3), CBBA(3)), 4),
        CASES[5]: lambda: (ascending(cut("mid", 93), 150), 2),
        CASES[6]: lambda: (ascending(cut("large", 93), 40), 2),
        CASES[7]: lambda: (solving(cut("shells", 6), planner), 3),
        CASES[8]: lambda: (solving(dense(cut("mid", 93)), HAAL(6)), 12),
    }
    return cases[case]()


if __name__ == "__main__":
    main()
