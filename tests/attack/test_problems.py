"""Every method on random problems, against the optimum of the definitions in rational arithmetic.

The quick part runs by default; ``pytest -m slow tests/attack -s`` runs 20 000 problems and prints the counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from attack import cases
from attack.reference import Reference

from sapopt import SAP, bound, certify, solve, verify
from sapopt.problem.result import Status
from sapopt.solvers import (
    HAA,
    HAAL,
    CentralHAALD,
    DualDecomposition,
    DualLookahead,
    Exact,
    Greedy,
    MyopicGreedy,
    NoHandover,
)

METHODS: tuple[Any, ...] = (
    HAA(), HAAL(2), HAAL(3, keep_plan=True), NoHandover(), Greedy(), MyopicGreedy(), CentralHAALD(2), DualLookahead(2),
    Exact(), Exact("dp"),
)  # fmt: skip


TOLERANCE = Fraction(1, 10**9)
"""Of optimal values, in parts of the largest sum; values and bounds are held to a thousandth of it."""


FOUND = (14612,)
"""Seeds of `cases.problem`."""


def attack(seed: int, counts: Counter[str], planners: bool) -> list[str]:
    """One problem of `cases`, see `check`."""
    name, problem, definition = cases.problem(seed)
    size = Fraction(0) if problem is None else _size(problem)
    methods = (*METHODS, DualDecomposition()) if planners else METHODS
    return check(name, problem, definition, size, counts, methods, planners)


def check(
    name: str, problem: SAP | None, definition: Reference, size: Fraction, counts: Counter[str],
    methods: Sequence[Any], proofs: bool,
) -> list[str]:  # fmt: skip
    """Every plan, value and bound is held against the definition, with `proofs` also `bound` and certificates.

    `size` is the largest sum that any plan can come to, for tolerances. Returns what is false.
    """
    best = definition.optimum()
    if problem is None or best is None:
        counts["problems without a plan"] += 1
        return [] if best is None else [f"{name}: refused, and has a plan"]
    counts["problems"] += 1
    faults: list[str] = []
    for method in methods:
        label = f"{name}: {method.name}"
        try:
            result = solve(problem, method, time_limit=10.0)
        except ValueError:  # a method that is not for this dynamics, or numbers that it cannot hold
            counts["refusals"] += 1
            continue
        worth = definition.value(result.plan)
        counts["plans"] += 1
        if worth is None:
            faults.append(f"{label}: no plan")
            continue
        if abs(Fraction(result.value) - worth) > size * TOLERANCE / 1000:
            faults.append(f"{label}: value {result.value!r}, the plan is worth {float(worth)!r}")
        if result.status is Status.OPTIMAL:
            counts["optima"] += 1
            # DualDecomposition takes a gap of 1e-5 of the value for none, and says so.
            declared = Fraction(method.tolerance) if isinstance(method, DualDecomposition) else Fraction(0)
            if best - worth > size * TOLERANCE + declared * abs(worth):
                faults.append(f"{label}: {float(worth)!r} of {float(best)!r} is said to be optimal")
        if result.bound is not None:
            counts["bounds"] += 1
            if Fraction(result.bound) < best - size * TOLERANCE / 1000:
                faults.append(f"{label}: bound {result.bound!r}, the optimum is {float(best)!r}")
    if proofs:
        try:
            proven = bound(problem)
        except ValueError:  # a user's rule that does not say what handovers can add
            counts["refusals"] += 1
            return faults
        counts["bounds"] += 1
        if Fraction(proven.value) < best:
            faults.append(f"{name}: bound {proven.value!r}, the optimum is {float(best)!r}")
        faults += _certified(problem, definition, best, counts, name)
    return faults


def _certified(
    problem: SAP, definition: Reference, best: Fraction, counts: Counter[str], name: str
) -> list[str]:
    """What a certificate promises is true, and it can be checked."""
    try:
        certificate = certify(problem, solve(problem, HAA()))
    except ValueError:
        counts["refusals"] += 1
        return []
    counts["certificates"] += 1
    faults = []
    if Fraction(verify(certificate, problem).bound) < best:
        faults.append(f"{name}: certified bound {certificate.bound!r}, the optimum is {float(best)!r}")
    worth, ratio = definition.value(certificate.plan), certificate.guarantee.ratio
    if certificate.guarantee.covers(HAA()) and ratio > 0:
        counts["guarantees"] += 1
        if worth is None or worth < best * Fraction(ratio) * (1 - TOLERANCE):
            faults.append(f"{name}: a ratio of {ratio} is promised")
    return faults


def _size(problem: SAP) -> Fraction:
    """The largest sum that any plan can come to, for tolerances."""
    steps = [np.asarray(problem.benefits.dense()[k]) for k in range(problem.T)]
    most = sum(Fraction(float(np.abs(step[np.isfinite(step)]).max(initial=0.0))) for step in steps)
    dynamics, costs = problem.dynamics, []
    for part in ("cost", "values", "start_up", "shut_down", "idling"):
        costs.append(float(np.abs(np.asarray(getattr(dynamics, part, 0.0), dtype=float)).max(initial=0.0)))
    return problem.n * (2 * most + problem.T * sum(map(Fraction, costs)))


def test_quick() -> None:
    """A few problems of every rule and kind; the dual methods on every fourth of them."""
    counts: Counter[str] = Counter()
    faults = [fault for seed in range(144) for fault in attack(seed, counts, planners=seed % 4 == 0)]
    print(dict(counts))
    assert not faults, "\n".join(faults)
    assert counts["problems"] > 100
    assert counts["optima"] > 50


@pytest.mark.parametrize("seed", FOUND)
def test_found(seed: int) -> None:
    """Problems at which something was false once."""
    faults = attack(seed, Counter(), planners=True)
    assert not faults, "\n".join(faults)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(20))
def test_many(part: int) -> None:
    """A thousand problems in each part, all methods."""
    counts: Counter[str] = Counter()
    seeds = range(1000 * (part + 1), 1000 * (part + 2))
    faults = [fault for seed in seeds for fault in attack(seed, counts, planners=True)]
    print(dict(counts))
    assert not faults, "\n".join(faults)
    assert counts["problems"] > 800
