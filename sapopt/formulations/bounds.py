"""Proven upper bounds: the sum over the steps, and the Lagrangian dual."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sapopt.data.assignment import best_assignment
from sapopt.data.benefits import dense_step
from sapopt.data.matrices import GainMatrix
from sapopt.data.types import FloatArray
from sapopt.problem.sap import SAP
from sapopt.proofs.certificate import Bound
from sapopt.running.control import Run

_EPS = float(np.finfo(np.float64).eps)


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
    total += problem.T * problem.n * float(limit)
    # Every step adds up n numbers, in an order that is scipy's, and the steps are added up.
    size = problem.n * sum(largest_benefits(problem)) + problem.T * problem.n * abs(float(limit))
    padding = 4.0 * (problem.n + problem.T) * _EPS * size
    return Bound(math.nextafter(total + padding, math.inf), None, "sum of alpha(beta_k)")


def largest_benefits(problem: SAP) -> list[float]:
    """The size of the largest benefit of every step, forbidden pairs left out."""
    found = []
    for k in range(problem.T):
        step = problem.benefits.step(k)
        entries = step if isinstance(step, np.ndarray) else step.data
        found.append(float(np.abs(entries[np.isfinite(entries)]).max(initial=0.0)))
    return found


def cancellation(problem: SAP) -> float:
    """What rounding may hide from a bound because numbers of both signs cancel out along a path.

    The oracles pad their bounds by shares of the values of whole paths. That is safe as long as nothing is added that
    is taken away again: benefits that are not negative, and handovers that only cost. Otherwise a partial sum may be
    far larger than the value it ends in, as with benefits of 1e16, 1 and -1e16, and its last bits are lost.
    """
    lost = 0.0
    if _has_negative(problem):
        lost = sum(largest_benefits(problem))
    limit = problem.model.handover_limit
    states = problem.model.local_model(problem.benefits, problem.initial_state())
    if states is not None and (limit is None or limit > 0):
        for k in range(problem.T):
            benefit, most = dense_step(problem.benefits.step(k)), 0.0
            for i in range(problem.n):
                handover = np.asarray(states.step(k, i, benefit[i])[1])
                most = max(most, float(np.abs(handover[np.isfinite(handover)]).max(initial=0.0)))
            lost += most
    return 4.0 * (problem.T + 2) * _EPS * problem.n * lost


def _has_negative(problem: SAP) -> bool:
    for k in range(problem.T):
        step = problem.benefits.step(k)
        entries = step if isinstance(step, np.ndarray) else step.data
        if (np.isfinite(entries) & (entries < 0)).any():
            return True
    return False


def _matrix(problem: SAP, k: int) -> Any:
    step = problem.benefits.step(k)
    if isinstance(step, np.ndarray) or (step.nnz and step.data.min() < 0):
        dense: FloatArray = dense_step(step)
        return dense
    return GainMatrix.from_matrix(step)


def dual_bound(problem: SAP, run: Run, prices: FloatArray | None, device: str) -> Bound:
    from sapopt.dynamics.switching.torch_paths import path_oracle
    from sapopt.formulations.dual import ascend

    hidden = cancellation(problem)  # first, for it may take long
    oracle = path_oracle(problem.model, problem.benefits, problem.initial_state(), device)

    def tell(iteration: int, value: float, _: FloatArray) -> bool:
        done, total = (iteration, 0) if run.time_limit is None else (run.seconds, run.time_limit)
        return run.report(done, total, None, value, f"iteration {iteration}")

    limit = None if run.time_limit is None else max(run.seconds_left, 0.0)
    found = ascend(oracle, prices, time_limit=limit, callback=tell)
    return Bound(float(found.bound) + hidden, found.prices, "Lagrangian dual of the task capacities")
