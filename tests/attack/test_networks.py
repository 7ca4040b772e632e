"""Distributed methods on networks that lose packets, split, heal and lose agents: a plan, or a clear refusal."""

from __future__ import annotations

import logging
from collections import Counter
from typing import Any

import networkx as nx
import numpy as np
import pytest
from attack import reference

from sapopt import SAP, SwitchingCost, solve
from sapopt.data.feasibility import InfeasibleError
from sapopt.solvers import CBBA, HAALD, DistributedDualLookahead
from sapopt.solvers.distributed import Cut, DistributedAuction, Faults


def attack(seed: int, counts: Counter[str]) -> None:
    """All methods on one problem and one network; plans are checked against the definition."""
    rng = np.random.default_rng([seed, 29])
    n, T = int(rng.integers(2, 6)), int(rng.integers(1, 4))
    m = n + int(rng.integers(0, 3))
    benefits = rng.random((T, n, m)) if seed % 3 else rng.integers(-2, 3, (T, n, m)).astype(float)
    if seed % 4 == 0:
        benefits = np.where(rng.random(benefits.shape) < 0.1, -np.inf, benefits)
    free, initial = bool(rng.integers(2)), rng.permutation(m)[:n] if rng.integers(2) else None
    cost = float(rng.choice([0.0, 0.3, 2.0]))
    try:
        problem = SAP(benefits, SwitchingCost(cost, idle_is_free=free), initial)
    except InfeasibleError:
        counts["problems without a plan"] += 1
        return
    except ValueError as error:
        assert "full assignment" in str(error)  # noqa: PT017
        counts["problems without a plan"] += 1
        return
    graph = nx.gnp_random_graph(n, float(rng.choice([0.3, 0.7, 1.0])), seed=seed)
    cut = Cut(tuple(int(i) for i in rng.permutation(n)[: int(rng.integers(1, n))]), 0, int(rng.integers(T)))
    dead = {int(rng.integers(n)): int(rng.integers(T))} if seed % 5 == 0 else {}
    faults = Faults(float(rng.choice([0.0, 0.3])), int(rng.integers(3)), dead, (cut,) if seed % 2 else ())
    made: dict[str, Any] = {"graph": graph, "allow_disconnected": True, "faults": faults}
    rounds = int(rng.choice([1, 5, 20_000]))
    definition = reference.switching(benefits, cost, free, initial)
    for method in (
        HAALD(int(rng.integers(1, 4)), max_rounds=rounds, **made), DistributedAuction(max_rounds=rounds, **made),
        CBBA(2, **made), DistributedDualLookahead(2, **made),
    ):  # fmt: skip
        try:
            result = solve(problem, method, seed=seed)
        except ValueError as error:
            # Forbidden pairs may leave no plan under the keepers' rule, and two methods know none.
            assert not np.isfinite(benefits).all(), f"seed {seed}: {method.name}: {error}"  # noqa: PT017
            counts["refusals"] += 1
            continue
        worth = definition.value(result.plan)
        assert worth is not None, f"seed {seed}: {method.name} has no plan"
        assert abs(float(worth) - result.value) <= 1e-9
        counts["runs"] += 1


def test_quick(caplog: pytest.LogCaptureFixture) -> None:
    """Sixty networks."""
    caplog.set_level(logging.ERROR)
    counts: Counter[str] = Counter()
    for seed in range(60):
        attack(seed, counts)
    print(dict(counts))
    assert counts["runs"] > 150


@pytest.mark.slow
@pytest.mark.parametrize("part", range(11))
def test_many(part: int, caplog: pytest.LogCaptureFixture) -> None:
    """About three thousand runs in each part."""
    caplog.set_level(logging.ERROR)
    counts: Counter[str] = Counter()
    for seed in range(850 * (part + 1), 850 * (part + 2)):
        attack(seed, counts)
    print(dict(counts))
    assert counts["runs"] > 2500
