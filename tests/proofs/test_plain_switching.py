"""The quick recursion of verified bounds against the table of all pairs of tasks."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

from sapopt import SAP, SwitchingCost
from sapopt.dynamics.switching.model import SwitchingCost as Rule
from sapopt.proofs.plain_limits import _local_values
from sapopt.proofs.plain_switching import switching_values


@pytest.mark.parametrize("seed", range(20))
def test_equal_to_the_table_of_all_pairs(seed: int) -> None:
    """Values agree whatever is taken from pairs, take-ups and stays, with forbidden pairs and one task too."""
    rng = np.random.default_rng(seed)
    T, n, m = (int(size) for size in rng.integers(1, 5, 3))
    n = min(n, m)
    benefits = np.round(rng.normal(0.5, 1.0, (T, n, m)), 2) * (rng.random((T, n, m)) < 0.7)
    initial = rng.permutation(m)[:n] if rng.random() < 0.5 else None
    problem = SAP(benefits, SwitchingCost(0.4, idle_is_free=bool(rng.integers(2))), initial)
    weights = [np.round(rng.normal(0.0, 0.7, (T, n, m)), 2) for _ in range(3)]
    rule = problem.model.switching()
    assert rule is not None
    quick = switching_values(problem, rule, *weights)
    with mock.patch.object(Rule, "switching", return_value=None):
        slow, _ = _local_values(problem, *weights, remembers=True)
    assert quick == pytest.approx(slow, abs=1e-12)
