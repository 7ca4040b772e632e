"""Earth observation with revisits: instances of the EOSSP-MRT benchmark (github.com/Gavin-HFUT/EOSSP-MRT-Instances).

    python -m experiments.eos FOLDER [--by-minute] [--seconds 10] [--out results/eos]

FOLDER holds an instance: Satellites.txt, Tasks.txt and TaskTimeWins.txt. Storage and downloads are left out. A task is
wanted several times, each time near a moment of its own; a picture is worth its fixed profit, and of its variable
profit the less, the farther the beginning of the time window is from that moment. A satellite takes one picture at a
time, and needs its transition time between two. Each picture that is wanted is taken once.

A step is the beginning of a window, so steps have no fixed length; `sapopt.dynamics.Jobs` says until which of them a
picture keeps its satellite busy. The optimum of instance S1 is then 22.4189. A value of 22.5896 is known for it,
without the reading that it belongs to. One that gives it is `--by-minute`: steps are minutes, a satellite takes one
picture in each, at the one nearest to the middle of the window, for the profit at the window's end. Such a plan can
break a transition time by up to a minute.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from experiments import common
from sapopt import SAP, Limit, solve
from sapopt.dynamics import Jobs
from sapopt.solvers import HAA, DualDecomposition, DualLookahead

_MOMENT = "%Y/%m/%d %H:%M:%S"


@dataclass(frozen=True)
class Wish:
    """A picture that is wanted; times in seconds from the beginning of the instance's first day."""

    task: int
    ideal_s: float
    tolerance_s: float
    fixed: float
    variable: float

    def worth(self, at_s: float) -> float:
        """Profit of a picture at a time; 0 beyond the tolerance."""
        away = abs(at_s - self.ideal_s)
        return (
            self.fixed + self.variable * (1.0 - away / self.tolerance_s) if away <= self.tolerance_s else 0.0
        )


@dataclass(frozen=True)
class Instance:
    """Satellites (id: transition time in seconds), wishes, and windows (satellite, task, begin, end)."""

    transition_s: dict[int, float]
    wishes: list[Wish]
    windows: list[tuple[int, int, float, float]]


def read_instance(folder: Path) -> Instance:
    """Read an instance.

    Raises
    ------
    ValueError
        If a file is missing or has another form; the message names file and line.
    """
    transition = {}
    for place, line in _lines(folder / "Satellites.txt"):
        with _at(place):
            satellite, _, pause = line.split(",")
            transition[int(satellite)] = float(pause) / 1000.0
    wishes = []
    for place, line in _lines(folder / "Tasks.txt"):
        with _at(place):
            task, _, _, count, visits = line.split(",")
            parts = [tuple(float(x) for x in visit.split("%")) for visit in visits.split("|")]
            if len(parts) != int(count):
                raise ValueError(f"{count} visits announced, {len(parts)} found")
            for ideal, tolerance, fixed, variable in parts:
                wishes.append(Wish(int(task), ideal / 1000.0, tolerance / 1000.0, fixed, variable))
    raw = []
    known = {wish.task for wish in wishes}
    for place, line in _lines(folder / "TaskTimeWins.txt"):
        with _at(place):
            satellite, task, begin, end = line.split(",")
            if int(satellite) not in transition or int(task) not in known:
                raise ValueError(f"satellite {satellite} or task {task} is in no other file")
            times = datetime.strptime(begin, _MOMENT), datetime.strptime(end, _MOMENT)
            raw.append((int(satellite), int(task), *times))
    if not raw:
        raise ValueError(f"{folder / 'TaskTimeWins.txt'}: there is no window")
    day = min(begin for _, _, begin, _ in raw).replace(hour=0, minute=0, second=0)
    windows = [(s, t, (a - day).total_seconds(), (b - day).total_seconds()) for s, t, a, b in raw]
    return Instance(transition, wishes, windows)


def problem_of(instance: Instance, by_minute: bool = False) -> SAP:
    """The sequential assignment problem: agents are satellites, tasks the pictures wanted; steps as told above."""
    satellites = list(instance.transition_s)
    at = [60.0 * round((a + b) / 120.0) if by_minute else a for _, _, a, b in instance.windows]
    moments = np.unique(at)
    T, n, m = len(moments), len(satellites), len(instance.wishes)
    length = np.ones((T, n, m), dtype=np.int64)
    benefits = [sp.lil_array((n, m)) for _ in range(T)]
    for moment, (satellite, task, begin, end) in zip(at, instance.windows, strict=True):
        k, i = int(np.searchsorted(moments, moment)), satellites.index(satellite)
        ready = moment + 60.0 if by_minute else end + instance.transition_s[satellite]
        free = int(np.searchsorted(moments, ready))
        for j, wish in enumerate(instance.wishes):
            if wish.task == task and (worth := wish.worth(end if by_minute else begin)) > benefits[k][i, j]:
                benefits[k][i, j] = worth
                length[k, i, j] = max(free - k, 1)
    tasks = [f"task {wish.task} near {wish.ideal_s / 3600:g} h" for wish in instance.wishes]
    return SAP(
        [sp.csr_array(step) for step in benefits], Jobs(length), idle=True, limits=[Limit.once()],
        agents=[f"satellite {s}" for s in satellites], tasks=tasks,
    )  # fmt: skip


def _lines(path: Path) -> list[tuple[str, str]]:
    """The lines after the first one, each with its place for messages."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read ({error}); give the folder of an instance") from None
    return [(f"{path}, line {number}", line) for number, line in enumerate(text.splitlines(), 1)
            if number > 1 and line.strip()]  # fmt: skip


class _at:
    """Says where a line was that has another form."""

    def __init__(self, place: str) -> None:
        self.place = place

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: Any, error: Any, _: Any) -> None:
        if isinstance(error, ValueError):
            raise ValueError(f"{self.place}: {error}") from None


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("folder", type=Path)
    parser.add_argument("--by-minute", action="store_true", help="steps of a minute")
    parser.add_argument("--seconds", type=float, default=10.0)


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "eos", argv, add=add_options)
    problem = problem_of(read_instance(run.options.folder), run.options.by_minute)
    run.say(f"{problem}, {problem.benefits.flat().indptr[-1]} pictures possible")
    common.warm(problem, DualDecomposition())
    rows = []
    for solver in (DualDecomposition(), HAA(), DualLookahead(20)):
        result = solve(problem, solver, time_limit=run.options.seconds)
        run.say(f"{result}")
        rows.append({"solver": solver.name, "value": result.value, "bound": result.bound, "gap": result.gap,
                     "status": result.status.value, "seconds": result.runtime})  # fmt: skip
    run.write_json({"T": problem.T, "n": problem.n, "m": problem.m, "rows": rows})


if __name__ == "__main__":
    main()
