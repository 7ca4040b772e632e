"""Value and bound from the definitions alone: plain numpy, no kernels, nothing shared with the solvers.

Slower than the solvers' own code on purpose: a reader should be able to check it line by line.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray, real_array
from sapopt.dynamics.paths.oracles import LocalOracle
from sapopt.problem.sap import SAP
from sapopt.proofs.plain_groups import groups_bound

_EPS = float(np.finfo(np.float64).eps)


def plain_value(problem: SAP, plan: Any) -> float:
    """Value of a plan, pair by pair: the greatest float64 that is not above the exact sum.

    Parameters
    ----------
    problem : SAP
    plan : array_like of int, shape (T, n)

    Returns
    -------
    float
        Benefits and handovers are added without a rounding error. The handovers themselves are exact for the rules of
        `SwitchingCost` and `Battery`; those of other dynamics count as the float64 that the dynamics returns.

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
        raise ValueError(f"the plan uses a forbidden pair at step {np.argwhere(~np.isfinite(worth))[0][1]}")
    return sum_down(worth.ravel().tolist())


def sum_down(numbers: list[float]) -> float:
    """The greatest float64 that is not above the exact sum.

    Raises
    ------
    ValueError
        If the sum overflows.
    """
    try:
        nearest = math.fsum(numbers)
        # `math.fsum` rounds the exact sum once, so the sign of what is left tells which way it went.
        return nearest if math.fsum([*numbers, -nearest]) >= 0 else math.nextafter(nearest, -math.inf)
    except OverflowError:
        raise ValueError("the numbers are so large that their sum overflows") from None


def _terms(problem: SAP, tasks: IntArray) -> FloatArray:
    """Benefit, handover and interaction (3, T, n) of every pair, from the matrices of any dynamics."""
    terms = np.zeros((3, *tasks.shape))
    agents, model = np.arange(problem.n), problem.model
    state = problem.initial_state()
    for k in range(problem.T):
        terms[0, k] = dense_step(problem.benefits.step(k))[agents, tasks[k]]
        terms[1, k] = problem.handover(k, state)[agents, tasks[k]]
        if model.interacts:
            terms[2, k] = model.interaction(k, state, tasks[k])
        if not np.isfinite(terms[:, k]).all():
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
        With agent-local dynamics, or copies of agents.
    prices : array_like, shape (T, m), with copies of agents (T, m + n)
        Finite, not negative.

    Raises
    ------
    ValueError
        If the prices do not prove a bound, or the dynamics has no agent-local form.
    """
    mu = real_array(prices, "prices")
    shape = (problem.T, problem.model.price_columns(problem.n, problem.m))
    if mu.shape != shape:
        name = "(T, m + n)" if problem.model.has_places else "(T, m)"
        raise ValueError(f"prices must have shape {name} = {shape}, got {mu.shape}")
    if not np.isfinite(mu).all() or (mu < 0).any():
        raise ValueError("prices must be finite and not negative")
    if problem.model.has_places:
        return groups_bound(problem, mu)
    plain = problem.model.plain(problem)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below
            if plain is None:
                values, charges = _local_values(problem, mu)
            else:
                values, charges = plain.path_values(mu), plain.largest_charge * problem.T
        total = math.fsum([*values.tolist(), *mu.ravel().tolist()])
    except OverflowError:
        total = math.inf
    if not math.isfinite(total):
        raise ValueError("prices and benefits are so large that the bound overflows")
    # A path's value is the result of at most 4 T + 4 roundings of numbers no larger than `size`.
    size = charges
    for k in range(problem.T):
        step = problem.benefits.step(k)
        entries = step if isinstance(step, np.ndarray) else step.data
        finite = np.abs(entries[np.isfinite(entries)])
        size += float(finite.max(initial=0.0)) + float(mu[k].max())
    rounding = (4 * problem.T + 4) * _EPS * problem.n * size + _EPS * abs(total)
    return math.nextafter(math.nextafter(total + rounding, math.inf), math.inf)


def handover_weight(problem: SAP, plan: IntArray, prices: FloatArray) -> float:
    """The sizes of all handovers behind value and bound, added up; 0 for a rule that is exact on every machine."""
    if problem.model.plain(problem) is not None or problem.model.has_places:  # sums and products alone
        return 0.0
    paid = float(np.abs(_terms(problem, plan)[1:]).sum())
    return paid + problem.n * _local_values(problem, prices)[1]


def _local_values(problem: SAP, mu: FloatArray) -> tuple[FloatArray, float]:
    """Path values by the plain dynamic programme over declared local states, and the sum over the steps of the most
    that a handover is worth, either way.
    """
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
    charges = 0.0
    for k in range(problem.T):
        benefit, most = dense_step(problem.benefits.step(k)), 0.0
        for i in range(problem.n):
            handover = np.asarray(oracle.model.step(k, i, benefit[i])[1])
            most = max(most, float(np.abs(handover[np.isfinite(handover)]).max(initial=0.0)))
        charges += most
    return values, charges


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
        size = max(float(np.abs(part[np.isfinite(part)]).max(initial=0.0)) for part in (benefit, eta))
        for i in agents:
            successor, handover = model.step(k, int(i), benefit[i])
            told, true = float(handover[local[i], plan[k, i]]), float(eta[i, plan[k, i]])
            if not math.isclose(told, true, rel_tol=1e-9, abs_tol=1e-12 * size):
                raise ValueError(
                    f"dynamics: {type(problem.dynamics).__name__} contradicts itself: for "
                    f"{problem.naming.agent(i)} on {problem.naming.task(plan[k, i])} at step {k} "
                    f"its local_model has a handover of {told:g}, its handover matrix {true:g}"
                )
            local[i] = int(successor[local[i], plan[k, i]])
        state = problem.transition(k, state, np.asarray(plan[k], dtype=np.int64))
