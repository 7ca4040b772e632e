"""Windows and groups of plans whose agents may take up only so many tasks."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import SAP, Limit, SwitchingCost
from sapopt.data.types import IntArray
from sapopt.formulations.limited.folded import Folded, folded
from sapopt.solvers.dual_decomposition.network_plans.window_search import Effort
from sapopt.solvers.limited.counted_windows import Count, CountedWindows

KEPT, ALONE, FREE = Count(True, True), Count(True, False), Count(False, True)
SMALL = Effort(4, 60)
"""So few arcs that the agents of a window come in groups."""


def drawn(seed: int) -> tuple[Folded, IntArray]:
    """A problem of three take-ups each, begun at some tasks every second time, and a plan without take-ups."""
    rng = np.random.default_rng(seed)
    T, n, m = 12, 8, 11
    benefits = np.round(rng.random((T, n, m)) * (rng.random((T, n, m)) < 0.4), 3)
    initial = rng.permutation(m)[:n] if seed % 2 else None
    problem = SAP(benefits, SwitchingCost(0.1), initial, limits=[Limit.handovers(3, each=True)])
    found = folded(problem.core)
    assert found is not None
    start = rng.permutation(m)[:n] if initial is None else initial
    return found, np.tile(start, (T, 1))


def windows(found: Folded, seed: int) -> CountedWindows:
    """At prices and multipliers that were drawn."""
    rng = np.random.default_rng(seed)
    T, n, m = found.problem.T, found.problem.n, found.problem.m
    return CountedWindows.of(found, 0.2 * rng.random((T, m)), 0.1 * rng.random(n))


def worth(found: Folded, at: CountedWindows, plan: IntArray, *, priced: bool) -> float:
    """Value of a plan, which `evaluate` checks, at the multipliers if they count."""
    return found.problem.evaluate(plan).value - priced * float(found.take_ups(plan) @ at.dearer)


@pytest.mark.parametrize("count", [KEPT, ALONE, FREE])
@pytest.mark.parametrize("seed", range(4))
def test_windows_only_gain(seed: int, count: Count) -> None:
    """A round of windows gains by what it looks at, and where limits count keeps them, side by side too."""
    found, plan = drawn(seed)
    at, rng = windows(found, seed), np.random.default_rng(seed)
    first = worth(found, at, plan, priced=count.priced)
    value = first
    for shift in (0, 1, 3):
        plan = at.improved(plan, SMALL, shift, count, rng, lambda: 60.0)
        now = worth(found, at, plan, priced=count.priced)
        assert now >= value - 1e-6
        value = now
        if count.limited:
            assert (found.take_ups(plan) <= found.most).all()
    assert value > first + 1.0


@pytest.mark.parametrize("seed", range(4))
def test_windows_add_nothing_to_what_is_too_much(seed: int) -> None:
    """An agent that has too many take-ups may keep them, and comes to have no more."""
    found, plan = drawn(seed)
    at, rng = windows(found, seed), np.random.default_rng(seed)
    free = plan
    for shift in (0, 2):
        free = at.improved(free, SMALL, shift, FREE, rng, lambda: 60.0)
    before = found.take_ups(free)
    assert (before > found.most).any()
    kept = at.improved(free, SMALL, 1, KEPT, rng, lambda: 60.0)
    assert (found.take_ups(kept) <= np.maximum(before, found.most)).all()


@pytest.mark.parametrize("seed", range(4))
def test_groups_share_no_cell(seed: int) -> None:
    """Groups solved at the same time keep to cells of their own and to their limits, and the plan only gains."""
    found, plan = drawn(seed)
    at, rng = windows(found, seed), np.random.default_rng(seed)
    value = first = worth(found, at, plan, priced=False)
    for _ in range(3):
        plan = at.regrouped(plan, Effort(found.problem.T, 100), rng, lambda: 60.0)
        now = worth(found, at, plan, priced=False)
        assert now >= value - 1e-6
        assert (found.take_ups(plan) <= found.most).all()
        value = now
    assert value > first + 1.0


def test_one_window_has_it_all() -> None:
    """A window of the whole horizon, or longer, is solved like any other."""
    found, plan = drawn(1)
    at, rng = windows(found, 1), np.random.default_rng(1)
    better = at.improved(plan, Effort(20, 20_000), 0, ALONE, rng, lambda: 60.0)
    assert worth(found, at, better, priced=False) > worth(found, at, plan, priced=False) + 1.0
    assert (found.take_ups(better) <= found.most).all()


def test_no_time_changes_nothing() -> None:
    """When time is over, the plan comes back."""
    found, plan = drawn(0)
    at, rng = windows(found, 0), np.random.default_rng(0)
    assert (at.improved(plan, SMALL, 0, KEPT, rng, lambda: 0.0) == plan).all()
    assert (at.regrouped(plan, SMALL, rng, lambda: 0.0) == plan).all()
