"""Every solver that the command line knows, in a small setting, and a problem that it takes.

Tests of what all solvers must do are parametrised with `EVERY`, so that a new solver cannot be forgotten: it is enough
that `sapopt.solvers.names.METHODS` lists it.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import networkx as nx

from sapopt import SAP, SwitchingCost
from sapopt.dynamics import Interference
from sapopt.solvers.names import METHODS, NamedSolver, parse_solver

LOOKAHEAD = 3
SHORT: dict[str, dict[str, int]] = {
    "DualDecomposition": {"iterations": 60, "rounds": 2, "sweeps": 5},
    "DualLookahead": {"iterations": 20},
    "DistributedDualLookahead": {"iterations": 5},
}
"""Options that keep a method short on problems of a few agents; the others run as they come."""

EVERY = [parse_solver(method.name, LOOKAHEAD if method.parameter else None) for method in METHODS]
EVERY = [
    NamedSolver(s.name, dataclasses.replace(s.solver, **SHORT.get(type(s.solver).__name__, {})))
    for s in EVERY
]


def by_name(solver: NamedSolver) -> str:
    """The name of a solver, for the names of tests."""
    return solver.name


def problem_for(named: NamedSolver, benefits: Any, cost: float = 0.4, initial: Any = None) -> SAP:
    """A problem with a switching cost, or with benefits that interact where the solver is for those alone."""
    if named.name == "iterated":
        return SAP(benefits, Interference([[0, 1]], 0.5, cost), initial)
    return SAP(benefits, SwitchingCost(cost), initial)


def on_ring(named: NamedSolver, agents: int) -> Any:
    """The solver, on a ring of agents if it passes messages."""
    if any(field.name == "graph" for field in dataclasses.fields(named.solver)):
        return dataclasses.replace(named.solver, graph=nx.cycle_graph(agents))
    return named.solver
