"""Results that the pages of these tests show."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sapopt import SAP, Limit, Result, SwitchingCost, solve
from sapopt.domains.instances import scenario
from sapopt.solvers import HAA, HAAL, DualDecomposition

EVIL = "</script><img src=x onerror=alert(1)> & <b>"


@pytest.fixture(scope="session")
def problem() -> SAP:
    """A problem of one's own, without a map; its labels try to break out of the page."""
    rng = np.random.default_rng(5)
    benefits = rng.random((12, 4, 6)) * (rng.random((12, 4, 6)) < 0.6)
    return SAP(
        benefits,
        SwitchingCost(0.3),
        range(4),
        agents=["Ada", EVIL, "Grace", "Mary"],
        tasks=[f"ward {j}" for j in range(5)] + [EVIL],
    )


@pytest.fixture(scope="session")
def results(problem: SAP) -> dict[str, Result]:
    """Three results, the last with a bound, prices and a trace."""
    solvers: dict[str, Any] = {"haa": HAA(), "haal:3": HAAL(3), "dual": DualDecomposition(rounds=2)}
    return {name: solve(problem, solver, time_limit=10) for name, solver in solvers.items()}


@pytest.fixture(scope="session")
def constellation() -> Any:
    """A small constellation."""
    return scenario("constellation-toy", steps=8)


@pytest.fixture(scope="session")
def limited() -> tuple[SAP, dict[str, Result]]:
    """A problem with limits, whose agents may idle, and a plan with prices beside one without."""
    rng = np.random.default_rng(2)
    benefits = rng.random((8, 3, 5)) * (rng.random((8, 3, 5)) < 0.7)
    limits = [Limit.once(), Limit.work(at_most=4, name="shifts"), Limit.cover([4], 1, penalty=0.2)]
    problem = SAP(benefits, 0.1, idle=True, limits=limits, agents=["Ada", EVIL, "Grace"])
    return problem, {"dual": solve(problem, DualDecomposition(), time_limit=5), "haa": solve(problem, HAA())}
