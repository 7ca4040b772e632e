"""The distributed dual lookahead."""

from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP, SwitchingCost
from sapopt.running.rollout import rollout
from sapopt.solvers import DistributedAuction, DistributedDualLookahead
from sapopt.solvers.distributed import Faults, play


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 7), st.integers(0, 4), st.integers(0, 10_000), st.booleans(), st.integers(1, 3))
def test_feasible_and_unmoved_by_loss(n: int, extra: int, seed: int, idle_is_free: bool, hops: int) -> None:
    """Plans are feasible under both cost rules, and lost packets change nothing but the traffic."""
    rng = np.random.default_rng(seed)
    benefits = rng.random((4, n, n + extra)) * (rng.random((4, n, n + extra)) < 0.5)
    problem = SAP(benefits, SwitchingCost(0.3, idle_is_free=idle_is_free))
    options: dict[str, Any] = {"graph": nx.path_graph(n), "iterations": 8, "hops": hops}
    calm, _ = play(problem, DistributedDualLookahead(3, 0.01, **options))
    rough, _ = play(problem, DistributedDualLookahead(3, 0.01, faults=Faults(0.3, 1), **options))
    problem.evaluate(calm.plan)
    assert (calm.plan == rough.plan).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 6), st.integers(0, 4), st.integers(0, 10_000), st.booleans())
def test_window_of_one_is_the_auction(n: int, extra: int, seed: int, idle_is_free: bool) -> None:
    """With a window of one step nothing is priced and alpha(beta_hat) is played."""
    rng = np.random.default_rng(seed)
    benefits = rng.integers(0, 6, (1, n, n + extra)).astype(float)
    problem = SAP(benefits, SwitchingCost(2.0, idle_is_free=idle_is_free), rng.permutation(n + extra)[:n])
    epsilon = 0.9 / n
    mine = problem.evaluate(rollout(problem, DistributedDualLookahead(1, epsilon)).plan).value
    assert mine == problem.evaluate(rollout(problem, DistributedAuction(epsilon)).plan).value


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 4), st.integers(1, 5), st.integers(0, 10_000), st.booleans(), st.booleans())
def test_one_agent_is_optimal(m: int, steps: int, seed: int, idle_is_free: bool, held: bool) -> None:
    """An agent alone needs no prices and plans the best path, if the window is the horizon."""
    rng = np.random.default_rng(seed)
    benefits = rng.integers(0, 5, (steps, 1, m + 1)).astype(float)
    benefits[:, :, m] = 0.0
    problem = SAP(benefits, SwitchingCost(2.0, idle_is_free=idle_is_free), [m] if held else None)
    policy = DistributedDualLookahead(steps, 1e-3, iterations=1)
    got = problem.evaluate(rollout(problem, policy).plan).value
    best = max(problem.evaluate(np.array(path)[:, None]).value for path in np.ndindex(*[m + 1] * steps))
    # One round of prices moves nothing: an agent never wants a task more than once.
    assert got == pytest.approx(best)


def test_looks_ahead_where_haa_does_not() -> None:
    """An agent leaves the better task of the moment to a rival who needs it for longer."""
    benefits = np.zeros((4, 2, 4))
    benefits[:, 0, 1], benefits[:, 1, 0] = 0.9, 1.0
    benefits[0, 0, 0], benefits[0, 1, 2] = 1.1, 0.95
    problem = SAP(benefits, 0.8)
    graph = nx.path_graph(2)
    ahead = problem.evaluate(rollout(problem, DistributedDualLookahead(4, 0.01, graph)).plan).value
    myopic = problem.evaluate(rollout(problem, DistributedAuction(0.01, graph)).plan).value
    assert ahead == pytest.approx(7.6)
    assert myopic < ahead


def test_refuses_what_it_cannot_price() -> None:
    """Costs by pair of tasks and forbidden pairs are refused with a way out."""
    cost = np.array([[0.0, 1.0], [1.0, 0.0]])
    with pytest.raises(ValueError, match="use HAALD"):
        rollout(SAP(np.zeros((1, 2, 2)), SwitchingCost(cost)), DistributedDualLookahead(2))
    values = np.zeros((1, 2, 2))
    values[0, 0, 0] = -np.inf
    with pytest.raises(ValueError, match="forbidden pairs; use HAALD"):
        rollout(SAP(values), DistributedDualLookahead(2))
    for option in ("window", "iterations", "hops"):
        with pytest.raises(ValueError, match=f"{option} must be"):
            DistributedDualLookahead(**{option: 0})
