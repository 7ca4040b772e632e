"""What counts as a handover: every change of task, those that were paid, and those that an operator would see."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, Result, SwitchingCost, solve
from sapopt.dynamics import SyntheticSwitching
from sapopt.solvers import HAA


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), idle_is_free=st.booleans(), begun=st.booleans(), idle=st.booleans())
def test_counts_are_those_of_the_definitions(seed: int, idle_is_free: bool, begun: bool, idle: bool) -> None:
    """On random plans the three numbers are what walking through the plan, agent by agent, gives."""
    rng = np.random.default_rng(seed)
    T, n, m = 6, 3, 5
    benefits = rng.random((T, n, m)) * (rng.random((T, n, m)) < 0.5)
    initial = rng.permutation(m)[:n] if begun else None
    problem = SAP(benefits, SwitchingCost(0.3, idle_is_free=idle_is_free), initial, idle=idle)
    plan = np.array([rng.permutation(m)[:n] for _ in range(T)])
    if idle:
        plan[rng.random(plan.shape) < 0.3] = -1
    handovers = paid = switches = 0
    for i in range(n):
        for k in range(T):
            task = int(plan[k, i])
            before = plan[k - 1, i] if k else (initial[i] if initial is not None else None)
            if before is None or task == before or task < 0:
                continue
            handovers += 1
            gain = benefits[k, i, task]
            paid += gain > 0 or not idle_is_free
            if k and before >= 0:
                switches += gain > 0 and benefits[k - 1, i, before] > 0
    score = problem.evaluate(plan)
    assert (score.handovers, score.paid_handovers, score.switches) == (handovers, paid, switches)


def test_copies_of_one_task() -> None:
    """From copy to copy of one task nothing is paid and nothing really changes, though the index does."""
    model = SyntheticSwitching(0.3, task_of=[0, 0, 1])
    problem = SAP(np.ones((3, 1, 3)), model)
    score = problem.evaluate([[0], [1], [2]])
    assert (score.handovers, score.paid_handovers, score.switches) == (2, 1, 1)


def test_counts_are_kept_in_files(tmp_path: pytest.TempPathFactory) -> None:
    """A result that is written and read again has the same numbers."""
    rng = np.random.default_rng(0)
    result = solve(SAP(rng.random((5, 3, 4)), SwitchingCost(0.1)), HAA())
    path = str(tmp_path / "r.npz")  # type: ignore[operator]
    result.save(path)
    again = Result.load(path)
    assert again.evaluation.paid_handovers == result.evaluation.paid_handovers
    assert again.evaluation.switches == result.evaluation.switches
