"""Why no plan exists: the first step that no plan reaches, and the agents that stand in each other's way."""

from __future__ import annotations

import numpy as np

from sapopt.data.feasibility import explain_infeasible
from sapopt.formulations.highs import Ending, maximise
from sapopt.formulations.network import Network
from sapopt.problem.sap import SAP


def explain(problem: SAP, network: Network) -> str:
    """Name the step at which every plan has failed, and the agents to blame."""
    T, n, m = network.shape
    names = problem.naming
    reach = network.forward(np.zeros(network.arcs))
    open_arcs = np.isfinite(reach[network.tail]) & (network.slot >= 0)
    allowed = np.zeros((T, n, m), dtype=bool)
    allowed[network.step[open_arcs], network.agent[open_arcs], network.slot[open_arcs] % m] = True
    for k in range(T):
        stuck = np.flatnonzero(~allowed[k].any(axis=1))
        if len(stuck):
            return f"{names.step(k)}: {names.agent(stuck[0])} has no task left, whatever it did before"
        reason = explain_infeasible(allowed[k], names)
        if reason:
            return f"{names.step(k)}: {reason}"
    first, last = 0, T - 1  # the shortest horizon without a plan, by bisection
    while first < last:
        middle = (first + last) // 2
        if _feasible(network, middle, np.arange(n)):
            first = middle + 1
        else:
            last = middle
    agents = np.arange(n)
    for i in range(n):  # drop every agent whose absence does not help
        rest = agents[agents != i]
        if len(rest) and not _feasible(network, first, rest):
            agents = rest
    who = names.several(agents)
    return f"{names.step(first)}: no plan brings the {who} this far together; allow more pairs or append idle tasks"


def _feasible(network: Network, upto: int, agents: np.ndarray) -> bool:
    """Whether the agents can get through the steps ``0 .. upto`` together."""
    part = _horizon(network, upto, agents)
    keep = np.isin(part.agent, agents) & (part.step <= upto)
    programme = part.programme(keep)
    return maximise(programme).ending is not Ending.INFEASIBLE


def _horizon(network: Network, upto: int, agents: np.ndarray) -> Network:
    last = np.zeros_like(network.last)
    last[network.head[(network.step == upto) & (network.slot >= 0)]] = True
    return Network(
        network.shape, network.tail, network.head, np.zeros(network.arcs), network.slot, network.agent, network.step,
        network.ranks, network.source[agents], last,
    )  # fmt: skip
