"""Value and bound from the definitions alone: plain numpy, no kernels, nothing shared with the solvers.

Slower than the solvers' own code on purpose: a reader should be able to check it line by line.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import LocalOracle
from sapopt.problem.sap import SAP


def plain_value(problem: SAP, plan: Any) -> float:
    """Value of a plan, pair by pair.

    Parameters
    ----------
    problem : SAP
    plan : array_like of int, shape (T, n)

    Raises
    ------
    ValueError
        If the plan is not feasible.
    """
    tasks = np.asarray(plan)
    if tasks.shape != (problem.T, problem.n) or tasks.dtype.kind not in "iu":
        raise ValueError(f"the plan must be integers of shape {(problem.T, problem.n)}, got {tasks.shape}")
    if tasks.min() < 0 or tasks.max() >= problem.m:
        raise ValueError(f"the plan holds a task outside 0..{problem.m - 1}")
    for k in range(problem.T):
        _check_step(tasks, k)
    plain = problem.model.plain(problem)
    worth = _terms(problem, tasks) if plain is None else plain.terms(tasks)
    if not np.isfinite(worth).all():
        raise ValueError(f"the plan uses a forbidden pair at step {np.argwhere(~np.isfinite(worth))[0][0]}")
    return math.fsum(worth.ravel().tolist())


def _terms(problem: SAP, tasks: IntArray) -> FloatArray:
    """Benefit plus handover (T, n) of every pair, from the matrices of a dynamics that has no plainer form."""
    terms = np.full(tasks.shape, -np.inf)
    agents, model = np.arange(problem.n), problem.model
    state = problem.initial_state()
    for k in range(problem.T):
        eta = problem.handover(k, state)[agents, tasks[k]]
        if model.interacts:
            eta = eta + model.interaction(k, tasks[k])
        terms[k] = dense_step(problem.benefits.step(k))[agents, tasks[k]] + eta
        if not np.isfinite(terms[k]).all():
            break
        state = problem.transition(k, state, tasks[k].astype(np.int64))
    return terms


def _check_step(tasks: IntArray, k: int) -> None:
    if len(set(tasks[k].tolist())) < tasks.shape[1]:
        raise ValueError(f"the plan gives one task to two agents at step {k}")


def plain_bound(problem: SAP, prices: Any) -> float:
    """Upper bound of the optimal value that task prices prove, rounded to the safe side.

    Parameters
    ----------
    problem : SAP
        With agent-local dynamics.
    prices : array_like, shape (T, m)
        Finite, not negative.

    Raises
    ------
    ValueError
        If the prices do not prove a bound, or the dynamics has no agent-local form.
    """
    mu = np.asarray(prices, dtype=np.float64)
    if mu.shape != (problem.T, problem.m):
        raise ValueError(f"prices must have shape (T, m) = {(problem.T, problem.m)}, got {mu.shape}")
    if not np.isfinite(mu).all() or (mu < 0).any():
        raise ValueError("prices must be finite and not negative")
    plain = problem.model.plain(problem)
    if plain is None:
        values, charge = _local_values(problem, mu)
    else:
        values, charge = plain.path_values(mu), plain.largest_charge
    total = math.fsum(values.tolist()) + math.fsum(mu.ravel().tolist())
    # A path's value is the result of at most 4 T + 4 roundings of numbers no larger than `size`.
    size = charge * problem.T
    for k in range(problem.T):
        step = problem.benefits.step(k)
        entries = step if isinstance(step, np.ndarray) else step.data
        finite = np.abs(entries[np.isfinite(entries)])
        size += float(finite.max(initial=0.0)) + float(mu[k].max())
    rounding = (4 * problem.T + 4) * np.finfo(np.float64).eps * (problem.n * size + abs(total))
    return float(np.nextafter(total + rounding, np.inf))


def _local_values(problem: SAP, mu: FloatArray) -> tuple[FloatArray, float]:
    """Path values by the plain dynamic programme over declared local states."""
    model = problem.model
    if not model.is_agent_local:
        raise ValueError(f"dynamics: {problem.model.called} is not agent-local, so prices prove nothing")
    states = model.local_model(problem.benefits, problem.initial_state())
    oracle = (
        model.path_oracle(problem.benefits, problem.initial_state())
        if states is None
        else LocalOracle(problem.benefits, states)
    )
    if not isinstance(oracle, LocalOracle):
        raise ValueError(f"dynamics: {problem.model.called} has no plain path recursion to verify with")
    values, _ = oracle.best_paths(mu)
    return values, float(np.abs(values).max(initial=0.0))


def check_local_model(problem: SAP, plan: IntArray) -> None:
    """Check that declared local states give the steps of a plan the handovers that the handover matrices give them.

    A bound follows from the former, a value from the latter; where a user wrote both, they could disagree.

    Raises
    ------
    ValueError
        If they do.
    """
    state, agents = problem.initial_state(), np.arange(problem.n)
    model = problem.model.local_model(problem.benefits, state)
    if model is None:
        return
    local = [model.start(int(i)) for i in agents]
    for k in range(problem.T):
        benefit = dense_step(problem.benefits.step(k))
        eta = problem.handover(k, state)
        for i in agents:
            successor, handover = model.step(k, int(i), benefit[i])
            told, true = float(handover[local[i], plan[k, i]]), float(eta[i, plan[k, i]])
            if not math.isclose(told, true, rel_tol=1e-9, abs_tol=1e-12):
                raise ValueError(
                    f"dynamics: {type(problem.dynamics).__name__} contradicts itself: for agent {i} on task "
                    f"{plan[k, i]} at step {k} its local_model has a handover of {told:g}, its handover matrix {true:g}"
                )
            local[i] = int(successor[local[i], plan[k, i]])
        state = problem.transition(k, state, np.asarray(plan[k], dtype=np.int64))
