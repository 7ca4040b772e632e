"""Proven upper bounds: the sum over the steps, and the Lagrangian dual."""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt.data.assignment import best_assignment
from sapopt.data.benefits import dense_step
from sapopt.data.matrices import GainMatrix
from sapopt.data.types import FloatArray
from sapopt.problem.sap import SAP
from sapopt.proofs.certificate import Bound
from sapopt.running.control import Run


def stepwise_bound(problem: SAP, run: Run | None = None) -> Bound:
    """The sum over the steps of alpha(beta_k): what could be had if no handover ever cost anything.

    When the run is over, the steps that are left count what every agent gains at most, which is valid too.

    Raises
    ------
    ValueError
        If the dynamics does not declare the largest entry that its handover matrix can have (``handover_limit``;
        0 for costs), without which nothing is proven.
    """
    limit = problem.model.handover_limit
    if limit is None:
        raise ValueError(
            f"dynamics: {problem.model.called} must declare handover_limit, the largest entry its own "
            "handover matrix can have (0.0 for costs), or path_oracle or local_model, before anything can be proven"
        )
    order = np.arange(problem.m)
    total = 0.0
    for k in range(problem.T):
        if run is not None and run.report(k, problem.T, None, None, "alpha(beta)"):
            total += float(dense_step(problem.benefits.step(k)).max(axis=1).sum())
        else:
            total += best_assignment(_matrix(problem, k), order).value
    padding = 1e-12 * max(1.0, abs(total))
    return Bound(total + problem.T * problem.n * float(limit) + padding, None, "sum of alpha(beta_k)")


def _matrix(problem: SAP, k: int) -> Any:
    step = problem.benefits.step(k)
    if isinstance(step, np.ndarray) or (step.nnz and step.data.min() < 0):
        dense: FloatArray = dense_step(step)
        return dense
    return GainMatrix.from_matrix(step)


def dual_bound(problem: SAP, run: Run, prices: FloatArray | None, device: str) -> Bound:
    from sapopt.dynamics.switching.torch_paths import path_oracle
    from sapopt.formulations.dual import ascend

    oracle = path_oracle(problem.model, problem.benefits, problem.initial_state(), device)

    def tell(iteration: int, value: float, _: FloatArray) -> bool:
        done, total = (iteration, 0) if run.time_limit is None else (run.seconds, run.time_limit)
        return run.report(done, total, None, value, f"iteration {iteration}")

    limit = None if run.time_limit is None else max(run.seconds_left, 0.0)
    found = ascend(oracle, prices, time_limit=limit, callback=tell)
    return Bound(float(found.bound), found.prices, "Lagrangian dual of the task capacities")
