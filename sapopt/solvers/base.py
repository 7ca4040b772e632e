"""What a solver is: a policy (`sapopt.running.outlook.Policy`) decides by step, a planner sees the whole horizon."""

from __future__ import annotations

import numbers
from dataclasses import dataclass, field
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.running.outlook import Policy


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a planner hands back; `sapopt.solve` scores it and makes the Result.

    Attributes
    ----------
    plan : ndarray of int64, shape (T, n)
    status : Status
    bound : float or None
        Proven upper bound of the optimal value.
    prices : ndarray or None, shape (T, m)
        Task prices that prove the bound.
    trace : list of dict
        One record per iteration.
    limit_prices, team_prices : ndarray or None
        The rest of the proof, where the problem has limits and teams (`sapopt.proofs.certificate.Bound`).
    """

    plan: IntArray
    status: Status
    bound: float | None = None
    prices: FloatArray | None = None
    trace: list[dict[str, Any]] = field(default_factory=list)
    limit_prices: FloatArray | None = None
    team_prices: FloatArray | None = None


@runtime_checkable
class Planner(Protocol):
    """Sees the whole horizon. Immutable; the state of a run is in `Run`."""

    @property
    def name(self) -> str:
        """Name with options, for tables."""

    def plan(self, problem: SAP, run: Run) -> Outcome:
        """Find a plan. Must return its incumbent when ``run.expired``, or on KeyboardInterrupt."""


Solver = Policy | Planner


EXTRAS = frozenset({"capacity", "idle", "limits", "teams"})
"""What a problem may ask for beyond the thesis' model."""


@runtime_checkable
class Extended(Protocol):
    """A solver that takes problems with capacities, idleness, limits or teams, and says which of them."""

    @property
    def takes(self) -> frozenset[str]:
        """Of `EXTRAS`."""


def untaken(problem: SAP, solver: Any) -> list[str]:
    """What a problem asks for and a solver does not take."""
    asked = {"capacity": problem.capacity is not None, "idle": problem.idle,
             "limits": bool(problem.rows.count), "teams": bool(len(problem.rows.team_cell))}  # fmt: skip
    takes = solver.takes if isinstance(solver, Extended) else frozenset()
    return [name for name, is_asked in asked.items() if is_asked and name not in takes]


@runtime_checkable
class Talking(Policy, Protocol):
    """A distributed policy: its agents exchange packets through a graph."""

    @property
    def graph(self) -> Any:
        """One graph, a list of one for each step, or None: everyone hears everyone."""

    def with_graph(self, graph: Any) -> Self:
        """The same policy with other links."""


def check_lookahead(lookahead: int, name: str = "lookahead") -> None:
    """Raise a ValueError unless `lookahead` is a whole number of at least 1."""
    if isinstance(lookahead, bool) or not isinstance(lookahead, numbers.Integral) or lookahead < 1:
        raise ValueError(f"{name} must be a whole number of at least 1, got {lookahead!r}")


def gap_unit(problem: SAP) -> float:
    """What stands for 1 in tolerances of the form ``tolerance * max(1, value)``: less where all benefits are small.

    A gap of 1e-12 is no rounding error where the benefits are of that size themselves.
    """
    entries = np.abs(problem.benefits.flat().data)
    return min(1.0, float(entries[np.isfinite(entries)].max(initial=0.0)) or 1.0)
