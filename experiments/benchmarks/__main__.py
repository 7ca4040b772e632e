"""The benchmark suite: time, memory and value of every method as problems grow, and the peers on the same problems.

    python -m experiments.benchmarks [--quick] [--groups n m T L visible alpha algorithm2 whole] [--docs] [--out DIR]

Every method runs in a process of its own (`case.py`), so that its peak memory is its own, on problems of `ring.py`.
Writes one JSON and one picture, and with `--docs` the page docs/benchmark_results.md. Groups that are left out keep the
rows of an earlier run in the same folder, so that a long run can be made in parts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments import common
from experiments.benchmarks import report
from sapopt.data.files import write_figure, write_text

ROOT = Path(__file__).resolve().parents[2]

Case = tuple[str, list[dict[str, Any]]]


def sizes(counts: Sequence[int], **options: Any) -> list[dict[str, Any]]:
    """Problems of growing size, five tasks for four agents."""
    return [{"n": n, "m": 5 * n // 4, "T": 12} | options for n in counts]


def cases(group: str, quick: bool) -> list[Case]:
    """Methods of a group with their problems, small ones first."""
    n = [100, 300, 1000] if quick else [100, 300, 1000, 3000, 10_000, 30_000]
    base = {"n": 100 if quick else 300, "m": 125 if quick else 375, "T": 12}
    few = n[:2] if quick else n[:3]
    if group == "n":
        reach = {
            "greedy": n, "haa": n, "haal:3": n, "haal:6": n, "dual-lookahead:6": n, "dual-bound": n,
            "dual-decomposition": few if quick else n, "haal-d:3": few if quick else n[:4], "cbba:3": few,
        }  # fmt: skip
        return [(name, sizes(counts)) for name, counts in reach.items()]
    varied = {
        "m": [base | {"m": int(base["n"] * ratio)} for ratio in (1, 1.25, 2, 4)],
        "T": [base | {"T": steps} for steps in ((6, 12, 24) if quick else (6, 12, 24, 48, 96))],
        "visible": [base | {"visible": d} for d in ((3, 5, 10) if quick else (3, 5, 10, 20, 40))],
    }
    if group in varied:
        names = ["haal:6", "dual-lookahead:6"]
        if group != "m":
            names.append("dual-bound")
        if group != "visible" and not quick:
            names.append("dual-decomposition")
        return [(name, varied[group]) for name in names]
    if group == "L":
        longest = {
            "haal": 6 if quick else 10,
            "dual-lookahead": 6 if quick else 12,
            "haal-d": 3 if quick else 5,
        }
        return [
            (f"{kind}:1", [base | {"method": f"{kind}:{L}"} for L in range(1, most + 1)])
            for kind, most in longest.items()
        ]
    if group == "alpha":
        dense = [k for k in n if k <= 10_000]
        peers = [
            "assign-sapopt",
            "assign-scipy-sparse",
            "assign-ortools-flow",
            "assign-scipy-dense",
            "assign-highs",
        ]
        return [(name, sizes(dense if name.endswith("dense") else n)) for name in peers]
    if group == "algorithm2":
        return [(f"{kind}:{L}", sizes(few)) for L in (3, 6) for kind in ("haal", "plain")]
    if group == "whole":
        tiny = [{"n": k, "m": 5 * k // 4, "T": 8} for k in ((4, 8) if quick else (4, 8, 16, 32))]
        return [(name, tiny) for name in ("exact", "whole-highs", "whole-cp-sat")]
    raise ValueError(f"unknown group {group!r}")


GROUPS = ("n", "m", "T", "L", "visible", "alpha", "algorithm2", "whole")


def run_case(name: str, problems: list[dict[str, Any]], cap: float) -> list[dict[str, Any]]:
    """Rows of one case; those made before it fails or runs far over its time are kept."""
    text = json.dumps({"method": name, "cap": cap, "problems": problems})
    command = [sys.executable, "-m", "experiments.benchmarks.case", text]
    alone = os.environ | dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    with subprocess.Popen(
        command, cwd=ROOT, env=alone, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            out, err = process.communicate(timeout=120 + 12 * cap)
        except subprocess.TimeoutExpired:
            process.kill()
            out, err = process.communicate()
            err = f"over its time\n{err}"
    rows = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
    if process.returncode:
        rows.append({"method": name, "failed": (err.strip().splitlines() or ["?"])[-1][:200]})
    return rows


def options(parser: argparse.ArgumentParser) -> None:
    """What this script takes besides the common options."""
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--cap", type=float, help="seconds for one problem (default 30, quick 2)")
    parser.add_argument("--docs", action="store_true", help="write docs/benchmark_results.md and its picture")


def main() -> None:
    """Run the groups, write JSON, picture and page."""
    run = common.begin(__doc__, "benchmarks", quick_seeds=1, add=options, resumes=True)
    cap = run.options.cap or (2.0 if run.quick else 30.0)
    path = run.out / "benchmarks.json"
    earlier = json.loads(path.read_text(encoding="utf-8")) if path.exists() and not run.options.force else {}
    groups: dict[str, list[dict[str, Any]]] = dict(earlier.get("groups", {}))
    for group in run.options.groups:
        groups[group] = []
        for name, problems in cases(group, run.quick):
            seeded = [problem | {"seed": seed} for problem in problems for seed in run.seeds]
            rows = run_case(name, seeded, cap)
            groups[group] += rows
            bad = [row["failed"] for row in rows if "failed" in row]
            run.say(f"{group:10} {name:20} {len(rows) - len(bad)} of {len(seeded)} problems {' '.join(bad)}")
            run.write_json({"groups": groups, "exponents": report.exponents(groups), "cap": cap})
    result = json.loads(path.read_text(encoding="utf-8"))
    figure = report.picture(result)
    run.write_figure(figure)
    page = report.page(result)
    write_text(run.out / "benchmarks.md", page)
    if run.options.docs:
        write_text(ROOT / "docs" / "benchmark_results.md", page)
        write_figure(ROOT / "docs" / "images" / "benchmarks.png", figure, 110)


if __name__ == "__main__":
    main()
