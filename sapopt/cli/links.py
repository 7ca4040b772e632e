"""Which satellites hear each other: the communication graphs that the distributed solvers are given."""

from __future__ import annotations

from typing import Any

from sapopt.cli.progress import Reporter
from sapopt.domains.scenario import Moving, Scenario
from sapopt.solvers.base import Talking
from sapopt.solvers.names import NamedSolver

DEFAULT_RANGE_KM = 2500.0


def talks(named: NamedSolver) -> bool:
    """Whether a solver sends packets through a graph."""
    return isinstance(named.solver, Talking)


def check_range(range_km: float | None, solvers: list[NamedSolver]) -> None:
    """Refuse a range that is no length or that no solver uses, before any work."""
    if range_km is None:
        return
    if not range_km > 0:
        raise ValueError(f"--range-km must be a positive number of kilometres, got {range_km:g}")
    if not any(talks(named) for named in solvers):
        raise ValueError("--range-km is for solvers that exchange packets: haal-d, cbba, dual-lookahead-d")


def connect(
    solvers: list[NamedSolver], scenario: Scenario | None, range_km: float | None, reporter: Reporter
) -> list[NamedSolver]:
    """Give the distributed solvers the links of a constellation; elsewhere everyone hears everyone.

    Parameters
    ----------
    solvers : list of NamedSolver
    scenario : object or None
        What the problem was made of; a `Constellation` has links.
    range_km : float or None
        Satellites that are closer hear each other; None: 2500 km, as in the thesis; inf: all hear all.

    Raises
    ------
    ValueError
        If the problem has no satellites, or the links leave them in several parts at some step.
    """
    if not any(talks(named) for named in solvers):
        return solvers
    if not isinstance(scenario, Moving):
        if range_km is not None:
            raise ValueError("--range-km is for constellations; without it everyone hears everyone")
        return solvers
    reach = DEFAULT_RANGE_KM if range_km is None else range_km
    if reach == float("inf"):
        return solvers
    from sapopt.domains.constellation.graphs import linked_pairs
    from sapopt.solvers.distributed import Network

    networks = []
    positions = scenario.positions_km
    with reporter.phase(f"linking satellites closer than {reach:g} km", total=len(positions)) as phase:
        for k, now in enumerate(positions):
            network = Network.from_pairs(linked_pairs(now, reach), len(now))
            parts = int(network.components.max()) + 1
            if parts > 1:
                raise ValueError(
                    f"links below {reach:g} km leave the satellites in {parts} parts at step {k}; pass a larger "
                    "--range-km (inf: everyone hears everyone)"
                )
            networks.append(network)
            phase.update(k + 1)
    return [_linked(named, networks) for named in solvers]


def shortened(solvers: list[NamedSolver], steps: int) -> list[NamedSolver]:
    """The same solvers for the first steps of the problem."""
    return [_linked(named, None, steps) for named in solvers]


def _linked(named: NamedSolver, networks: Any, steps: int | None = None) -> NamedSolver:
    """A solver with these links, or with the first `steps` of its own."""
    solver = named.solver
    if not isinstance(solver, Talking):
        return named
    if steps is not None:
        if solver.graph is None:
            return named
        networks = solver.graph[:steps]
    return NamedSolver(named.name, solver.with_graph(networks))
