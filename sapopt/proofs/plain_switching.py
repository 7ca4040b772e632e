"""Best paths under the switching rule of one cost, with what limits take from them: plain numpy, from the definition.

The general way keeps a table of all pairs of tasks for every agent and step. Here what an agent did before counts by
one number for each task, so that problems of hundreds of agents and tasks can be verified too.
"""

from __future__ import annotations

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray
from sapopt.dynamics.base import Switching
from sapopt.problem.sap import SAP


def switching_values(
    core: SAP, rule: Switching, pair: FloatArray, taken: FloatArray, stayed: FloatArray
) -> FloatArray:
    """Value (n,) of every agent's best path: the maximum over all sequences of tasks, by recursion.

    ``best[i, j]`` is the value of the best path of agent i up to step k that ends on task j. It stayed there, or came
    from another task, the best of the others.

    Parameters
    ----------
    core : SAP
    rule : Switching
        With one cost.
    pair, taken, stayed : ndarray, shape (T, n, m)
        Taken from the gains: always, on taking a task up, on staying.
    """
    T, n, m = core.T, core.n, core.m
    cost, initial, agents = rule.uniform_cost, core.initial_assignment, np.arange(core.n)
    assert cost is not None
    best = np.zeros((n, m))
    for k in range(T):
        benefit = dense_step(core.benefits.step(k))
        charge = np.where(benefit > 0, cost, 0.0) if rule.idle_is_free else np.full((n, m), cost)
        if k > 0:
            arrive = np.maximum(best - stayed[k], _best_of_others(best) - charge - taken[k])
        elif initial is None:
            arrive = -taken[k]
        else:
            arrive = -charge - taken[k]
            arrive[agents, initial] = -stayed[k][agents, initial]
        best = arrive + (benefit - pair[k])
    return np.asarray(best.max(axis=1))


def _best_of_others(best: FloatArray) -> FloatArray:
    """For every agent and task the greatest number of the agent's other tasks; -inf if there is none."""
    agents, at = np.arange(len(best)), best.argmax(axis=1)
    rest = best.copy()
    rest[agents, at] = -np.inf
    out = np.repeat(best.max(axis=1)[:, None], best.shape[1], axis=1)
    out[agents, at] = rest.max(axis=1)
    return out
