"""Forbidden pairs on networks that split and with few rounds: the documented rule, or a clear refusal."""

from __future__ import annotations

import logging

import networkx as nx
import numpy as np
import pytest

from sapopt import SAP, SwitchingCost, solve
from sapopt.data.feasibility import InfeasibleError
from sapopt.solvers import HAALD
from sapopt.solvers.distributed import DistributedAuction
from sapopt.solvers.distributed.haal_d import CentralHAALD, reach

SPLIT = nx.disjoint_union(nx.path_graph(3), nx.path_graph(2))


def random_problem(seed: int, share: float) -> SAP | None:
    """Five agents, six tasks, three steps; None if too much is forbidden."""
    rng = np.random.default_rng(seed)
    benefits = np.where(rng.random((3, 5, 6)) < share, -np.inf, rng.random((3, 5, 6)))
    try:
        return SAP(benefits, SwitchingCost(0.3))
    except InfeasibleError:
        return None


@pytest.mark.parametrize("rounds", [1, 5, 100])
@pytest.mark.parametrize("lookahead", [0, 2, 3])
def test_a_plan_or_a_refusal(rounds: int, lookahead: int, caplog: pytest.LogCaptureFixture) -> None:
    """No foreign error and no forbidden pair, however few the rounds are; most problems have a plan."""
    caplog.set_level(logging.ERROR)
    made = {"graph": SPLIT, "allow_disconnected": True, "max_rounds": rounds}
    solver = HAALD(lookahead, **made) if lookahead else DistributedAuction(**made)
    plans = refused = 0
    for seed in range(40):
        problem = random_problem(seed, 0.08)
        if problem is None:
            continue
        try:
            result = solve(problem, solver)
        except InfeasibleError as error:
            assert "step" in str(error)  # noqa: PT017
            refused += 1
        else:
            assert np.isfinite(result.value)
            plans += 1
    assert plans > refused


def test_the_rule_by_hand() -> None:
    """One round is too few: agent 0 may not keep task 0, so it takes the better of the others that it keeps."""
    benefits = np.zeros((1, 2, 6))
    benefits[0, 0, 0] = -np.inf
    benefits[0, 0, 4] = 3.0
    benefits[0, :, 3] = 9.0  # kept by agent 1
    for solver in (HAALD(1, max_rounds=1), DistributedAuction(max_rounds=1)):
        assert solve(SAP(benefits, SwitchingCost(0.5)), solver).plan.tolist() == [[4, 1]]
    benefits[0, 0, [2, 4]] = -np.inf
    for solver in (HAALD(1, max_rounds=1), DistributedAuction(max_rounds=1)):
        with pytest.raises(InfeasibleError, match=r"step 0: agent 0 may not do task 0.*raise max_rounds"):
            solve(SAP(benefits, SwitchingCost(0.5)), solver)


def test_a_window_with_a_step_that_has_no_assignment() -> None:
    """A later step that no part can fill shortens the sequences; it was a KeyError before the step was reached."""
    benefits = np.ones((2, 4, 4))
    benefits[1, 0] = [-np.inf, -np.inf, 1.0, -np.inf]  # task 2 is kept by the other part
    graph = nx.disjoint_union(nx.path_graph(2), nx.path_graph(2))
    problem = SAP(benefits, SwitchingCost(0.5), [0, 1, 2, 3])
    with pytest.raises(InfeasibleError, match=r"step 1: .*tasks that its part of the network keeps"):
        solve(problem, HAALD(2, graph=graph, allow_disconnected=True))
    assert reach({(0, 1), (2, 3)}, 0) == 1
    assert reach({(0, 1), (1, 3), (0, 2)}, 0) == 3
    assert solve(problem, CentralHAALD(2)).value > 0
