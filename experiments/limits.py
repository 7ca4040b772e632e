"""Plans within limits against their proven bounds: constellation-mid, a small problem, the imaging day, the roster.

    python -m experiments.limits [--only NAME ...] [--seconds S] [--quick] [--out results/limits]

- `mid-handovers`: constellation-mid, satellites may idle, each takes up at most 20 tasks.
- `mid-covers`: constellation-mid, satellites may idle, every task of priority above 1.8 is served at every step at
  which some satellite sees it, or one is paid.
- `busy-handovers`, `busy-covers`: the same where every satellite holds a task at every step, as in the thesis; also
  how long it takes to verify the certificate.
- `three-handovers`: 10 x 5 x 7 at random with `Exact`, at most three handovers each against no limit; medians of seven.
- `imaging`: the instance, a day by the minute; also what HAA and the dual lookahead of 30 steps get.
- `roster`: the instance; also ward-days short of a nurse.
- `rides`: 8 drivers and 50 requests of `waiting-rides`; also what HAA gets.
- `interference`: 20 x 30 x 20 at random, where neighbours in a row of tasks lose 0.5, and 80 satellites over 250 tasks
  of the instance of that name; also the bound without the losses, and what reacting to each other gets.

`--seconds` is the time of each planner (120 on constellation-mid, 60 else); --quick takes small sizes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from experiments import common
from sapopt import SAP, Limit, Result, SwitchingCost, bound, certify, solve, verify
from sapopt.domains.instances import instance, scenario
from sapopt.dynamics import Interference
from sapopt.solvers import HAA, HAAL, DualDecomposition, DualLookahead, Exact, IteratedAssignment
from sapopt.solvers.base import Solver

_DEAR = 1.8
"""Priority from which on a task is to be covered."""


def mid_handovers(
    run: common.Run, seed: int, case: str = "mid-handovers", idle: bool = True
) -> list[dict[str, Any]]:
    base = _mid(run, seed)
    most = 5 if run.quick else 20
    problem = SAP(base.benefits, SwitchingCost(0.5), idle=idle, limits=[Limit.handovers(most, each=True)])
    result = planned(run, problem, 120.0, seed)
    taken = np.array([use.use for use in result.evaluation.limits])
    return [
        row(
            case,
            result,
            at_most=most,
            most_taken=taken.max(),
            at_the_limit=int((taken == most).sum()),
            **({} if idle else verified(run, problem, result)),
        )
    ]


def busy_handovers(run: common.Run, seed: int) -> list[dict[str, Any]]:
    return mid_handovers(run, seed, "busy-handovers", idle=False)


def mid_covers(
    run: common.Run, seed: int, case: str = "mid-covers", idle: bool = True
) -> list[dict[str, Any]]:
    base = _mid(run, seed)
    priority = scenario("constellation-mid", seed).tasks.priority
    seen = np.stack(
        [np.asarray((sp.csr_array(base.benefits.step(k)) > 0).sum(axis=0)) > 0 for k in range(base.T)]
    )
    limits = [
        Limit.cover(int(j), 1, np.flatnonzero(seen[:, j]), served=True, penalty=1.0)
        for j in np.flatnonzero(priority > _DEAR)
        if seen[:, j].any()
    ]
    problem = SAP(base.benefits, SwitchingCost(0.5), idle=idle, limits=limits)
    result = planned(run, problem, 120.0, seed)
    unmet = sum(use.cost > 0 for use in result.evaluation.limits)
    return [
        row(
            case,
            result,
            covers=len(result.evaluation.limits),
            unmet=unmet,
            **({} if idle else verified(run, problem, result)),
        )
    ]


def busy_covers(run: common.Run, seed: int) -> list[dict[str, Any]]:
    return mid_covers(run, seed, "busy-covers", idle=False)


def three_handovers(run: common.Run, seed: int) -> list[dict[str, Any]]:
    rng = np.random.default_rng(seed)
    problems = [
        SAP(rng.random((7, 5, 10)), 0.3, limits=limits) for limits in ([], [Limit.handovers(3, each=True)])
    ]
    rows = []
    for problem, name in zip(problems, ("without", "three-handovers"), strict=True):
        times = []
        for _ in range(8):
            begin = time.process_time()
            result = solve(problem, Exact(), seed=seed)
            times.append(time.process_time() - begin)
        rows.append(row(name, result, processor_seconds=float(np.median(times[1:]))))
        run.say(
            f"  {name}: {result.value:.4f}, {1000 * rows[-1]['processor_seconds']:.0f} ms of processor time"
        )
    return rows


def imaging(run: common.Run, seed: int) -> list[dict[str, Any]]:
    problem = instance("imaging", seed, **({"steps": 240} if run.quick else {}))
    best = planned(run, problem, 60.0, seed)
    rows = [row("imaging", best)]
    for solver in (HAA(), DualLookahead(30, iterations=20)):
        result = solve(problem, solver, seed=seed)
        looks = [use for use in result.evaluation.limits if use.name.startswith("one look")]
        twice = sum(use.use > 1 for use in looks)
        assert best.bound is not None
        run.say(
            f"  {solver.name}: {result.value:.3f}, {result.value / best.bound:.1%} of the bound, {twice} looked twice"
        )
        rows.append(row("imaging", result, bound=best.bound, share=result.value / best.bound, twice=twice))
    return rows


def roster(run: common.Run, seed: int) -> list[dict[str, Any]]:
    small = {"nurses": 8, "wards": 5, "days": 14}
    built = scenario("nurse-roster", seed, **(small if run.quick else {}))
    result = planned(run, built.problem(), 60.0, seed)
    short = built.short_of(result.plan)
    run.say(f"  {short} ward-days short of a nurse")
    return [row("roster", result, short=short)]


def rides(run: common.Run, seed: int) -> list[dict[str, Any]]:
    sizes = (3, 14, 12, 5) if run.quick else (8, 50, 24, 6)
    options = dict(zip(("drivers", "requests", "steps", "width"), sizes, strict=True))
    problem = instance("waiting-rides", seed, **options)
    rows = [row("rides", planned(run, problem, 30.0, seed)), row("rides", solve(problem, HAA(), seed=seed))]
    run.say(f"  HAA: {rows[-1]['value']:.2f}")
    return rows


def interference(run: common.Run, seed: int) -> list[dict[str, Any]]:
    rng = np.random.default_rng(seed)
    T, n, m = (6, 6, 9) if run.quick else (20, 20, 30)
    benefits = rng.random((T, n, m)) * (rng.random((T, n, m)) < 0.3)
    chain = Interference([(j, j + 1) for j in range(m - 1)], 0.5, 0.3)
    small = {"planes": 3, "per_plane": 4, "tasks": 30, "steps": 6}
    sizes = small if run.quick else {"planes": 8, "per_plane": 10, "tasks": 250, "steps": 30}
    rows = []
    for name, problem in (
        ("chain", SAP(benefits, chain)),
        ("beams", instance("interference", seed, **sizes)),
    ):
        limit = 10.0 if run.quick else run.options.seconds or 60.0
        proven = bound(problem, time_limit=limit)
        rule = problem.dynamics
        assert isinstance(rule, Interference)
        free = bound(SAP(problem.benefits, SwitchingCost(rule.cost)), time_limit=limit).value
        result = planned(run, problem, limit, seed)
        reacting = solve(problem, IteratedAssignment(), seed=seed).value
        run.say(
            f"  {name}: bound {proven.value:.3f}, without losses {free:.3f}; plan {result.value:.3f}, "
            f"iterated {reacting:.3f}, HAAL(3) {solve(problem, HAAL(3)).value:.3f}"
        )
        rows.append(row(name, result, dual=proven.value, without_losses=free, iterated=reacting))
    return rows


CASES: dict[str, Callable[[common.Run, int], list[dict[str, Any]]]] = {
    "three-handovers": three_handovers, "imaging": imaging, "roster": roster, "mid-handovers": mid_handovers,
    "mid-covers": mid_covers, "busy-handovers": busy_handovers, "busy-covers": busy_covers,
    "rides": rides, "interference": interference,
}  # fmt: skip


def _mid(run: common.Run, seed: int) -> SAP:
    return instance("constellation-mid", seed, **({"steps": 12} if run.quick else {}))


def planned(run: common.Run, problem: SAP, seconds: float, seed: int, solver: Solver | None = None) -> Result:
    """A plan with its bound, after the compiling."""
    solver = solver or DualDecomposition()
    common.warm(problem, solver)
    given = run.options.seconds
    limit = given if given is not None else (10.0 if run.quick else seconds)
    result = solve(problem, solver, seed=seed, time_limit=limit)
    run.say(f"  {result}, {len(problem.limits)} limits")
    return result


def verified(run: common.Run, problem: SAP, result: Result) -> dict[str, float]:
    """The bound of the certificate, and the seconds that it takes to make and to verify it."""
    began = time.perf_counter()
    made = certify(problem, result)
    between = time.perf_counter()
    proven = verify(made, problem)
    after = time.perf_counter()
    run.say(
        f"  certificate: {proven.value:.2f} of at most {proven.bound:.2f}, verified in {after - between:.1f} s"
    )
    return {"certified": proven.bound, "certifying": between - began, "verifying": after - between}


def row(case: str, result: Result, **more: Any) -> dict[str, Any]:
    """A line of the report."""
    return {
        "case": case, "solver": result.solver, "value": result.value, "bound": result.bound, "gap": result.gap,
        "status": result.status.value, "seconds": result.runtime, **more,
    }  # fmt: skip


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--only", nargs="+", choices=list(CASES), help="some of the cases")
    parser.add_argument("--seconds", type=float, help="time of each planner")


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "limits", argv, add=add_options)
    rows: list[dict[str, Any]] = []
    for name in run.options.only or CASES:
        for seed in run.seeds:
            run.say(f"{name}, seed {seed}")
            rows += [{"seed": seed, **line} for line in CASES[name](run, seed)]
            run.write_json({"rows": rows})  # after every case, so that an interrupted run leaves what it has


if __name__ == "__main__":
    main()
