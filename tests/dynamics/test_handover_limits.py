"""What a dynamics says of the largest entry of its handover matrix is true of it."""

from __future__ import annotations

import numpy as np

from sapopt.domains.tiny import tiny_problems
from sapopt.dynamics import AtMostInARow, Jobs, SlewCost


def test_no_entry_is_above_the_limit() -> None:
    """Along random plans of every built-in rule; rules that only cost say so, so that no bound has to look."""
    rng = np.random.default_rng(0)
    said = set()
    for name, problem in tiny_problems():
        limit = problem.model.handover_limit
        if limit is None:
            continue
        said.add(type(problem.dynamics))
        for _ in range(5):
            state = problem.initial_state()
            for k in range(problem.T):
                eta = problem.handover(k, state)
                assert eta.max() <= limit, name
                allowed = np.isfinite(problem.beta_hat(k, state))
                tasks = rng.permutation(problem.m)[: problem.n]
                if not allowed[np.arange(problem.n), tasks].all():
                    break
                state = problem.transition(k, state, tasks)
    assert {Jobs, AtMostInARow, SlewCost} <= said
