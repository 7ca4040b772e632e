"""The rules of `more_cases` against their optimum, and HAAL on them against Algorithm 2 by brute force.

A subclass that changes a part of a built-in rule is among them: it must be played, scored and bounded by its own rule.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
from attack import more_cases, reference
from attack.more_cases import Case
from attack.test_problems import METHODS, TOLERANCE, check
from by_the_letter import Tied, haal

from sapopt import solve
from sapopt.solvers import HAAL, DualDecomposition, Exact, IteratedAssignment

MORE: tuple[Any, ...] = (*METHODS, HAAL(4), IteratedAssignment())


def attack(seed: int, counts: Counter[str], planners: bool) -> list[str]:
    """One case: everything that `check` tries, and HAAL with lookaheads 2 to 4 by the letter."""
    case = more_cases.case(seed)
    methods = (*MORE, DualDecomposition(), Exact("milp")) if planners else MORE
    faults = check(case.name, case.problem, case.definition, case.size, counts, methods, planners)
    if case.problem is not None and case.definition.optimum() is not None:
        for lookahead in (2, 3, 4):
            faults += by_the_letter(case, lookahead, counts)
    return faults


def by_the_letter(case: Case, lookahead: int, counts: Counter[str]) -> list[str]:
    """HAAL plays what Algorithm 2 says, wherever that leaves no choice."""
    hat, raw = case.hat, reference.exact(case.benefits)

    def entered(k: int, stop: int, state: Any, tasks: tuple[int, ...]) -> Any:
        played = hat.step(k, state, tasks)
        later = [raw[t][i][j] for t in range(k + 1, stop) for i, j in enumerate(tasks)]
        if played is None or None in later:
            return None
        return played[0] + sum(x for x in later if x is not None)

    try:
        plan = haal(
            (hat.T, hat.n, hat.m), hat.start, entered, case.definition.step, lookahead, case.size * TOLERANCE
        )
    except Tied:
        counts["free choices"] += 1
        return []
    counts["plans by the letter"] += 1
    assert case.problem is not None
    found = [tuple(row) for row in solve(case.problem, HAAL(lookahead)).plan.tolist()]
    return [] if found == plan else [f"{case.name}: HAAL({lookahead}) plays {found}, Algorithm 2 {plan}"]


def test_quick() -> None:
    """A few problems of every rule and kind; proofs on every fourth of them."""
    counts: Counter[str] = Counter()
    faults = [fault for seed in range(162) for fault in attack(seed, counts, planners=seed % 4 == 0)]
    print(dict(counts))
    assert not faults, "\n".join(faults)
    assert counts["problems"] > 120
    assert counts["optima"] > 60
    assert counts["plans by the letter"] > 100


@pytest.mark.slow
@pytest.mark.parametrize("part", range(5))
def test_many(part: int) -> None:
    """A thousand problems in each part, all methods."""
    counts: Counter[str] = Counter()
    seeds = range(1000 * (part + 1), 1000 * (part + 2))
    faults = [fault for seed in seeds for fault in attack(seed, counts, planners=True)]
    print(dict(counts))
    assert not faults, "\n".join(faults)
    assert counts["problems"] > 800
