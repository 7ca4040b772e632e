"""The mid-size constellation of the thesis: conflict-free plans, rounds, and the twin."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from sapopt import SAP
from sapopt.data.assignment import best_assignment
from sapopt.data.matrices import value_of
from sapopt.data.windows import WindowSums
from sapopt.domains.instances import scenario
from sapopt.running.outlook import Outlook
from sapopt.solvers import CBBA, HAAL, HAALD, DistributedDualLookahead
from sapopt.solvers.distributed import play
from sapopt.solvers.distributed.common import begin, open_step
from sapopt.solvers.distributed.haal_d import interval_problems

EPSILON = 0.01


@cache
def mid(steps: int) -> tuple[SAP, Any]:
    """The first steps of the instance, with its links."""
    constellation = scenario("constellation-mid")
    whole = constellation.problem()
    return SAP(whole.benefits.slice(0, steps), whole.dynamics), constellation.graphs(steps=range(steps))


@pytest.mark.parametrize("lookahead", [1, 2, 3])
def test_cbba_is_free_of_conflicts(lookahead: int) -> None:
    """No task is given to two satellites, and the consensus itself comes to rest."""
    problem, graphs = mid(3)
    played, traffic = play(problem, CBBA(lookahead, graphs))
    problem.evaluate(played.plan)
    assert all(one.rounds < 100 for one in traffic)


def test_haald_against_the_twin() -> None:
    """All 21 intervals of a step with handovers are within n epsilon of their best; far closer, in fact."""
    whole, graphs = mid(8)
    held = play(SAP(whole.benefits.slice(0, 1), whole.dynamics), HAALD(1, EPSILON, graphs[0]))[0].plan[0]
    problem = SAP(whole.benefits.slice(1, 8), whole.dynamics, held)
    outlook = Outlook(0, problem.T, held, problem, WindowSums(problem.benefits), np.arange(problem.m))
    memory = begin(problem, graphs[1:], False, None, 0)
    scene = open_step(outlook, memory, False, None)
    solved, agreed = HAALD(6, EPSILON).solve_intervals(outlook, scene)
    assert agreed.all()
    assert len(solved) == 21
    for interval, matrix in interval_problems(outlook, 6).items():
        best = best_assignment(matrix, outlook.parking).value
        value = value_of(matrix, solved[interval])
        assert len(set(solved[interval])) == problem.n
        assert best - problem.n * EPSILON <= value <= best + 1e-9
    # The thesis reports about 80 rounds a step at this size and L = 6.
    assert scene.simulator.traffic().rounds < 130


@pytest.mark.slow
def test_values_of_the_whole_orbit() -> None:
    """HAAL-D is about as good as HAAL, well above CBBA, and below the distributed dual lookahead."""
    problem, graphs = mid(93)
    value = {
        type(policy).__name__: problem.evaluate(play(problem, policy)[0].plan).value
        for policy in (
            HAALD(3, EPSILON, graphs),
            CBBA(3, graphs),
            DistributedDualLookahead(6, EPSILON, graphs),
        )
    }
    from sapopt.running.rollout import rollout

    haal = problem.evaluate(rollout(problem, HAAL(3)).plan).value
    assert value["HAALD"] == pytest.approx(haal, rel=0.05)
    assert value["HAALD"] > 1.05 * value["CBBA"]
    assert value["DistributedDualLookahead"] > 1.02 * value["HAALD"]
