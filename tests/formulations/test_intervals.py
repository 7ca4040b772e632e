"""HAAL's interval subproblems, spelled out, against the solver."""

from __future__ import annotations

import numpy as np
import pytest

from sapopt import SAP, SwitchingCost, solve
from sapopt.formulations import intervals
from sapopt.solvers import HAAL


@pytest.mark.parametrize("lookahead", [1, 2, 3, 4])
def test_same_as_haal(lookahead: int) -> None:
    """Played step by step, the plain subproblems give HAAL's plan."""
    rng = np.random.default_rng(lookahead)
    problem = SAP(rng.random((6, 3, 4)), SwitchingCost(0.4))
    assert intervals.refusal(problem) is None
    state, plan = problem.initial_state(), []
    for k in range(problem.T):
        plan.append(intervals.recover(intervals.formulate(problem, k, lookahead, state)))
        state = problem.transition(k, state, plan[-1])
    assert np.array_equal(plan, solve(problem, HAAL(lookahead)).plan)


def test_sequences() -> None:
    """There are 2^(L-1) ways to cut a window of L steps, each covering it."""
    found = list(intervals.cuts(2, 6))
    assert len(found) == len(set(found)) == 8
    for sequence in found:
        assert [k for a, b in sequence for k in range(a, b)] == [2, 3, 4, 5]
    problem = SAP(np.ones((3, 1, 1)), SwitchingCost(1.0))
    assert len(intervals.formulate(problem, 1, 5, None).sequences) == 2
    with pytest.raises(ValueError, match="lookahead"):
        intervals.formulate(problem, 0, 40, None)
    with pytest.raises(ValueError, match="step 3"):
        intervals.formulate(problem, 3, 2, None)
