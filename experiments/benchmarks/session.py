"""A session of `DualLookahead` on a constellation that changes all the time: times, value, and a killed process.

    python -m experiments.benchmarks.session [--steps 500] [--budget-ms 100] [--seed 0] [--idle] [--out FOLDER]

1000 satellites (40 x 25 at 70 degrees), 1250 tasks at random places within 70 degrees of the equator. Every ten steps a
tenth of the tasks is replaced, and three satellites fail for good. Four parts, each a process of its own (`--part`):

budget     every decision within the budget; what its plan is worth step by step
free       the same without a budget
killed     the same without a budget, saved at half time and killed by SIGKILL
resumed    another process goes on from the file

The report compares: times of the decisions, value with and without a budget, and whether the resumed session decides as
the one that was never interrupted. Building the windows is not counted: that is the caller's work.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from experiments.benchmarks.output import finish
from sapopt import Session, SwitchingCost
from sapopt.data.benefits import Benefits
from sapopt.data.files import write_text
from sapopt.domains import constellation as c
from sapopt.domains.constellation.view import visible_benefits
from sapopt.solvers import DualLookahead

WINDOW, COST = 6, 0.5
BLOCK = 10
"""Steps between two replacements."""
TASKS = 1250
PARTS = ("budget", "free", "killed", "resumed")


class World:
    """Satellites that fail and tasks that are replaced; the same for the same seed.

    Parameters
    ----------
    steps : int
    seed : int
    """

    def __init__(self, steps: int, seed: int) -> None:
        self.steps, self.seed = steps, seed
        blocks = -(-steps // BLOCK)
        everything = c.random_tasks(
            TASKS + blocks * (TASKS // BLOCK), seed, max_latitude_deg=70.0, uniform_in="area"
        )
        self.pool = everything
        shell = c.WalkerShell(40, 25, 70.0, 550.0)
        self.positions = c.walker_positions_km(
            [shell], steps + BLOCK + WINDOW, 60.0, start_s=60.0, earth="still"
        )
        rng = np.random.default_rng(seed)
        self.failing = dict(zip(rng.choice(1000, 3, replace=False).tolist(), (steps // 5 * x for x in (1, 2, 3)),
                                strict=True))  # fmt: skip

    def calls(self, first: int = 0) -> Iterator[tuple[Benefits, list[str], list[str]]]:
        """Window, agents and tasks of every step from `first` on."""
        rng = np.random.default_rng([self.seed, 1])
        alive, fresh = np.arange(TASKS), TASKS
        for block in range(-(-self.steps // BLOCK)):
            if block:
                gone = rng.choice(TASKS, TASKS // BLOCK, replace=False)
                alive[gone] = np.arange(fresh, fresh + len(gone))
                fresh += len(gone)
            start = block * BLOCK
            if start + BLOCK <= first:
                continue
            tasks = c.GroundTasks(
                self.pool.latitude_deg[alive], self.pool.longitude_deg[alive], self.pool.priority[alive]
            )
            seen = visible_benefits(
                self.positions[start : start + BLOCK + WINDOW - 1], tasks, c.FieldOfView()
            ).settled()
            names = [f"task {j}" for j in alive.tolist()]
            for k in range(max(start, first), min(start + BLOCK, self.steps)):
                works = np.array([i for i in range(1000) if self.failing.get(i, k + 1) > k])
                window = [seen.step(k - start + s)[works] for s in range(WINDOW)]
                yield Benefits(window), [f"satellite {i}" for i in works.tolist()], names


def played(
    session: Session, world: World, first: int, last: int, budget_s: float | None
) -> list[dict[str, Any]]:
    """What the decisions of some steps are worth, how long they took, and a digest of each."""
    rows = []
    for k, (window, agents, tasks) in enumerate(world.calls(first), start=first):
        if k >= last:
            break
        decision = session.step(window, agents=agents, tasks=tasks, budget_s=budget_s)
        text = json.dumps([decision.assignment, decision.value, decision.bound], sort_keys=True)
        rows.append(
            {"step": k, "ms": 1000 * decision.seconds, "gained": decision.gained, "value": decision.value,
             "bound": decision.bound, "status": decision.status.value,
             "digest": hashlib.sha256(text.encode()).hexdigest()}
        )  # fmt: skip
    return rows


def run(part: str, options: argparse.Namespace) -> None:
    """One part, in this process."""
    world = World(options.steps, options.seed)
    half, path = options.steps // 2, options.out / "session.npz"
    budget = options.budget_ms / 1000 if part == "budget" else None
    new = Session(DualLookahead(WINDOW), SwitchingCost(COST), idle=options.idle)
    session = Session.load(path) if part == "resumed" else new
    window, agents, tasks = next(world.calls())
    warm = session.warm(window, agents=agents, tasks=tasks, budget_s=budget)
    first, last = {"resumed": (half, options.steps), "killed": (0, half)}.get(part, (0, options.steps))
    rows = played(session, world, first, last, budget)
    write_text(options.out / f"{part}.json", json.dumps({"part": part, "warm_s": warm, "rows": rows}))
    if part == "killed":
        session.save(path)
        os.kill(os.getpid(), signal.SIGKILL)


def summary(options: argparse.Namespace) -> dict[str, Any]:
    """What the parts that are there say together."""
    rows = {part: json.loads((options.out / f"{part}.json").read_text())["rows"] for part in PARTS
            if (options.out / f"{part}.json").exists()}  # fmt: skip
    report: dict[str, Any] = {"seed": options.seed, "steps": options.steps, "budget_ms": options.budget_ms,
                              "idle": options.idle}  # fmt: skip
    for part in ("budget", "free"):
        if part in rows:
            ms = np.array([row["ms"] for row in rows[part]])
            gaps = [1 - row["value"] / row["bound"] for row in rows[part] if row["bound"] is not None]
            report[part] = {
                "value": sum(row["gained"] for row in rows[part]),
                "ms": {f"p{q}": float(np.percentile(ms, q)) for q in (50, 90, 99, 100)},
                "share_within_budget": float((ms <= options.budget_ms).mean()),
                "with_bound": len(gaps) / len(ms),
                "mean_window_gap": float(np.mean(gaps)) if gaps else None,
                "status": {name: sum(row["status"] == name for row in rows[part]) / len(ms)
                           for name in ("complete", "short", "fallback")},
            }  # fmt: skip
    if {"budget", "free"} <= rows.keys():
        report["share_of_value"] = report["budget"]["value"] / report["free"]["value"]
    if {"free", "killed", "resumed"} <= rows.keys():
        whole, parts = rows["free"], rows["killed"] + rows["resumed"]
        same = [a["digest"] == b["digest"] for a, b in zip(whole, parts, strict=True)]
        report["resumed_decides_the_same"] = all(same)
    return report


def main() -> None:
    """Run the parts one after another, each in a process of its own, and report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--budget-ms", type=float, default=100.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--idle", action="store_true", help="satellites may hold nothing")
    parser.add_argument("--part", choices=(*PARTS, "report"), help="one part alone, here")
    parser.add_argument("--out", type=Path, default=Path("results/session"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.part in PARTS:
        run(options.part, options)
        return
    if options.part is None:
        for part in PARTS:
            own = [
                "--steps",
                str(options.steps),
                "--budget-ms",
                str(options.budget_ms),
                "--seed",
                str(options.seed),
            ]
            own += ["--idle"] * options.idle
            command = [sys.executable, "-m", "experiments.benchmarks.session", "--part", part, *own]
            done = subprocess.run([*command, "--out", str(options.out)], check=False)
            if done.returncode != (-signal.SIGKILL if part == "killed" else 0):
                raise SystemExit(f"{part} ended with {done.returncode}")
    finish(summary(options), str(options.out / "report.json"))


if __name__ == "__main__":
    main()
