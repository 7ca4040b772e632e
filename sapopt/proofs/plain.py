"""Value and bound from the definitions alone: plain numpy, no kernels, nothing shared with the solvers.

Slower than the solvers' own code on purpose: a reader should be able to check it line by line.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.battery.model import Battery
from sapopt.dynamics.paths.oracles import LocalOracle
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.problem.sap import SAP
from sapopt.proofs.plain_battery import plain_paths, plain_terms

_BLOCK = 2_000_000  # entries of the largest array built at once


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
    agents = np.arange(problem.n)
    if type(problem.dynamics) is Battery:
        for k in range(problem.T):
            _check_step(tasks, k)
        worth = plain_terms(problem, tasks)
        if not np.isfinite(worth).all():
            raise ValueError(
                f"the plan uses a forbidden pair at step {np.argwhere(~np.isfinite(worth))[0][0]}"
            )
        return math.fsum(worth.ravel().tolist())
    terms: list[float] = []
    state = problem.initial_state()
    for k in range(problem.T):
        _check_step(tasks, k)
        benefit = dense_step(problem.benefits.step(k))[agents, tasks[k]]
        if type(problem.dynamics) is SwitchingCost:
            eta = -_charges(problem.dynamics, state, tasks[k], benefit)
        else:
            eta = problem.handover(k, state)[agents, tasks[k]]
            if hasattr(problem.model, "interaction"):
                eta = eta + problem.model.interaction(k, tasks[k])
        if not np.isfinite(benefit + eta).all():
            raise ValueError(f"the plan uses a forbidden pair at step {k}")
        terms += (benefit + eta).tolist()
        state = problem.transition(k, state, tasks[k].astype(np.int64))
    return math.fsum(terms)


def _check_step(tasks: IntArray, k: int) -> None:
    if len(set(tasks[k].tolist())) < tasks.shape[1]:
        raise ValueError(f"the plan gives one task to two agents at step {k}")


def _charges(
    dynamics: SwitchingCost, held: IntArray | None, tasks: IntArray, benefit: FloatArray
) -> FloatArray:
    """What every agent pays for its move: the cost if it changes task (and gains by the new one, if idling is free)."""
    if held is None:
        return np.zeros(len(tasks))
    if dynamics.is_uniform:
        charge = np.where(tasks != held, float(dynamics.cost), 0.0)
    else:
        charge = np.asarray(dynamics.cost)[held, tasks]
    return np.where(benefit > 0, charge, 0.0) if dynamics.idle_is_free else charge


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
    if type(problem.dynamics) is SwitchingCost:
        values = np.concatenate([_best_paths(problem, mu, block) for block in _blocks(problem)])
        charge = float(np.max(problem.dynamics.cost))
    elif type(problem.dynamics) is Battery:
        values, charge = plain_paths(problem, mu), problem.dynamics.cost
    else:
        values, charge = _local_values(problem, mu)
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
    if hasattr(problem.model, "local_model"):
        model = problem.model.local_model(problem.benefits, problem.initial_state())
        oracle = LocalOracle(problem.benefits, model)
    elif hasattr(problem.model, "path_oracle"):
        oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
    else:
        raise ValueError(
            f"dynamics: {type(problem.dynamics).__name__} is not agent-local, so prices prove nothing"
        )
    if not isinstance(oracle, LocalOracle):
        raise ValueError(
            f"dynamics: {type(problem.dynamics).__name__} has no plain path recursion to verify with"
        )
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
    local = [model.start(i) for i in agents]
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


def _blocks(problem: SAP) -> Iterator[IntArray]:
    """Groups of agents whose arrays stay small."""
    width = problem.m if problem.dynamics.is_uniform else problem.m**2
    size = max(1, _BLOCK // width)
    for first in range(0, problem.n, size):
        yield np.arange(first, min(first + size, problem.n))


def _best_paths(problem: SAP, mu: FloatArray, agents: IntArray) -> FloatArray:
    """Value of each agent's best path under the prices: the maximum over all sequences of tasks, by recursion.

    ``best[i, j]`` is the value of the best path of agent i up to step k that ends on task j.
    """
    dynamics: SwitchingCost = problem.dynamics
    best = np.empty(0)
    for k in range(problem.T):
        step = problem.benefits.step(k)
        benefit = step[agents] if isinstance(step, np.ndarray) else step[agents].toarray()
        if k == 0:
            arrive = -_first_charges(problem, benefit, agents)
        elif dynamics.is_uniform:
            free = best.max(axis=1, keepdims=True)
            paid = free - float(dynamics.cost)
            arrive = np.maximum(best, np.where(benefit > 0, paid, free) if dynamics.idle_is_free else paid)
        else:
            paid = (best[:, :, None] - np.asarray(dynamics.cost)[None]).max(axis=1)
            free = best.max(axis=1, keepdims=True)
            arrive = np.where(benefit > 0, paid, free) if dynamics.idle_is_free else paid
        best = arrive + (benefit - mu[k])
    return np.asarray(best.max(axis=1))


def _first_charges(problem: SAP, benefit: FloatArray, agents: IntArray) -> FloatArray:
    """Charge of every agent for every task at the first step."""
    if problem.initial_assignment is None:
        return np.zeros_like(benefit)
    dynamics: SwitchingCost = problem.dynamics
    held = problem.initial_assignment[agents]
    if dynamics.is_uniform:
        charge = np.full_like(benefit, float(dynamics.cost))
        charge[np.arange(len(agents)), held] = 0.0
    else:
        charge = np.asarray(dynamics.cost)[held]
    return np.where(benefit > 0, charge, 0.0) if dynamics.idle_is_free else charge
