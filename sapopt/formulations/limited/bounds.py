"""The proven bound of a problem with capacities, idleness, limits or teams."""

from __future__ import annotations

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray
from sapopt.formulations.bounds import cancellation
from sapopt.formulations.limited.ascent import Ascent
from sapopt.formulations.limited.building import TooLargeError, path_graph
from sapopt.formulations.limited.disturbed import untangled
from sapopt.formulations.limited.dual import Prices
from sapopt.formulations.limited.folded import folded
from sapopt.formulations.limited.folded_dual import FoldedPaths
from sapopt.formulations.limited.joint_descent import descend
from sapopt.kernels import clock
from sapopt.problem.sap import SAP
from sapopt.proofs.certificate import Bound
from sapopt.running.control import Run

_NAME = "Lagrangian dual of capacities, limits and teams"


def limited_bound(problem: SAP, run: Run, prices: FloatArray | None) -> Bound:
    """Minimise the Lagrangian dual of capacities, limits, teams, and tasks that disturb each other.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local.
    InfeasibleError
        If an agent has no way through at all.
    """
    core = untangled(problem.core)
    hidden = cancellation(core)  # first, for it may take long

    def tell(iteration: int, value: float) -> bool:
        done, total = (iteration, 0) if run.time_limit is None else (run.seconds, run.time_limit)
        return run.report(done, total, None, value, f"iteration {iteration}")

    start = given = None
    if prices is not None:
        given = np.asarray(prices, dtype=np.float64)
        if given.shape != (problem.T, problem.m) or not np.isfinite(given).all() or (given < 0).any():
            raise ValueError(f"prices: expected finite numbers >= 0 of shape {(problem.T, problem.m)}")
        wide = np.zeros((core.T, core.m))
        wide[:, : problem.m] = given
        start = Prices(wide, np.zeros(core.rows.count), np.zeros(len(core.rows.team_cell)))
    try:
        graph = path_graph(core, tight=False)  # as whoever verifies the prices has it
    except TooLargeError:
        plain = folded(core)
        if plain is None:
            raise
        dual = descend(plain, FoldedPaths(plain), clock.now() + max(run.seconds_left, 0.0), tell, given)
        return Bound(dual.bound + hidden, dual.prices, _NAME, dual.multipliers(plain), np.zeros(0))
    found = Ascent(graph, clock.now() + max(run.seconds_left, 0.0), tell).run(start)
    if not np.isfinite(found.bound):
        raise InfeasibleError("an agent has no way through the horizon; allow more pairs or pass idle=True")
    return Bound(
        found.bound + hidden,
        found.prices.tasks[:, : problem.m],
        _NAME,
        found.prices.limits,
        found.prices.teams,
    )
