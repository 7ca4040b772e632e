"""The planner `DualDecomposition`: prices from the dual, plans from prices, and a proven gap between the two."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sapopt.dynamics.copies.groups import GroupPaths
from sapopt.dynamics.paths.first_rows import FirstRowsOracle
from sapopt.dynamics.switching.torch_paths import KERNELS, torch_device
from sapopt.formulations.bounds import largest_benefits
from sapopt.formulations.limited.building import TooLargeError
from sapopt.formulations.limited.disturbed import needs_limits
from sapopt.formulations.limited.folded import folded
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.running.rollout import rollout
from sapopt.solvers.base import EXTRAS, Outcome
from sapopt.solvers.dual_decomposition.copied_plans import CopiedPlans
from sapopt.solvers.dual_decomposition.network_plans import LargeNetworkPlans, NetworkPlans
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.waiting_places import wait_anywhere
from sapopt.solvers.dual_decomposition.oracle_plans import OraclePlans
from sapopt.solvers.dual_decomposition.plans import (
    PlanBuilder,
)
from sapopt.solvers.dual_decomposition.search import DualSearch, paths_from
from sapopt.solvers.haal import HAA
from sapopt.solvers.limited.counted import plan_counted
from sapopt.solvers.limited.planner import plan_limited
from sapopt.solvers.limited.unfolding import folded_run, unfolded

_LARGE = 4_000_000
"""Pairs of agents and tasks above which plans are built from sparse values of windows."""

_EXERCISE = 40
"""Dual iterations after which the kernels of all stages have been called."""

_NETWORK_SIZES = (1e-4, 1e30)
"""Largest benefits for which plans are made over the network; for others the oracles make them."""


@dataclass(frozen=True)
class DualDecomposition:
    """Near-optimal plans for the whole horizon, with a proven bound.

    A dual ascent changes the prices of the task capacities until the Lagrangian bound settles. Plans come from a
    rolling assignment that values the future by the prices, and from sweeps in which one agent after another takes its
    best priced path. With a `SwitchingCost`, windows of the best plan are then solved exactly, as network flows over
    the cells of small reduced cost; with other agent-local dynamics (those with a `path_oracle` or `local_model`) the
    sweeps go on. Where these no longer pay, all agents plan windows anew by dives under prices that settle on the way,
    and pairs of agents exchange segments of their paths by simulated annealing (both under a `SwitchingCost` or a
    `SyntheticSwitching`); the time goes to what has gained most lately.

    Parameters
    ----------
    iterations : int
        Most dual iterations.
    rounds : int, optional
        Most rounds of windows, exchanges or further sweeps. By default 18 where there is no time limit; where there is
        one, the search goes on until the time is over or nothing is found any more.
    sweeps : int
        Priced path sweeps of a round (none where every task is always taken).
    repricing : int
        Dual iterations before every few steps of a second rolling assignment, 0 for none.
    tolerance : float
        The run ends when the proven gap is at most this.
    threads : int
        Windows solved at the same time.
    device : str
        Where the dual's paths are computed: "cpu" (compiled kernels), or a torch device such as "cuda". The search for
        plans stays on the processor.

    Notes
    -----
    Without a time limit the result depends on the seed alone. A warm start is never made worse.
    """

    iterations: int = 2000
    rounds: int | None = None
    sweeps: int = 60
    repricing: int = 30
    tolerance: float = 1e-5
    threads: int = 2
    device: str = KERNELS

    def __post_init__(self) -> None:
        if self.device != KERNELS:
            torch_device(self.device)
        for name in ("iterations", "threads"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)!r}")
        for name in ("rounds", "sweeps", "repricing", "tolerance"):
            if getattr(self, name) is not None and not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)!r}")

    @property
    def name(self) -> str:
        """Name."""
        return "DualDecomposition"

    takes: ClassVar[frozenset[str]] = EXTRAS

    def plan(self, problem: SAP, run: Run) -> Outcome:
        """Find a plan and a bound; a time limit, the callback or an interruption ends with the best of both."""
        if needs_limits(problem):
            return self._limited(problem, run)
        search = self._begin(problem, run)
        status = Status.FEASIBLE
        try:
            for _ in search.steps():
                if search.gap <= self.tolerance or run.expired:
                    break
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
        if search.gap <= self.tolerance:
            status = Status.OPTIMAL
        elif run.stopped:
            status = Status.INTERRUPTED
        elif run.expired:
            status = Status.TIME_LIMIT
        bound = float(search.bound) if math.isfinite(search.bound) else None
        return Outcome(search.best, status, bound, search.prices, search.trace)

    def _limited(self, problem: SAP, run: Run) -> Outcome:
        """Over the graph of all that agents can do; where that is too large, as a plain problem if there is one."""
        try:
            return plan_limited(problem, run, self.tolerance, self.name)
        except TooLargeError:
            plain = folded(problem)
            if plain is None:
                raise
        if not plain.is_plain:
            return plan_counted(plain, run, self.tolerance, self.name)
        return unfolded(plain, self.plan(plain.problem, folded_run(plain, run)), self.tolerance)

    def exercise(self, problem: SAP, run: Run) -> None:
        """Do once what every long run does, proven or not: on a small problem that compiles its kernels."""
        if needs_limits(problem):
            plan_limited(problem, run, self.tolerance, self.name)
            return
        once = replace(self, sweeps=1, rounds=1, iterations=min(self.iterations, _EXERCISE))
        for _ in once._begin(problem, run).steps():
            if run.expired:
                return

    def exercise_others(self, problem: SAP, run: Run) -> None:
        """Do once what a long run turns to where windows and sweeps no longer pay: dives and exchanges."""
        if needs_limits(problem):
            return
        search = self._begin_without_prices(problem, run)
        search.portfolio.always = True
        for way in search.portfolio.others:
            for _ in search.offered(way.improve(search)):
                if run.expired:
                    return

    def exercise_windows(self, problem: SAP, run: Run) -> None:
        """Improve a plan once as `exercise` does at its end: what that takes longest to compile."""
        if needs_limits(problem):
            return
        search = self._begin_without_prices(problem, run)
        for _ in search.offered(search.builder.improve(search, 0)):
            if run.expired:
                return

    def _begin_without_prices(self, problem: SAP, run: Run) -> DualSearch:
        search = self._begin(problem, run)
        search.prices = np.zeros((problem.T, problem.model.price_columns(problem.n, problem.m)))
        return search

    def _begin(self, problem: SAP, run: Run) -> DualSearch:
        largest = max(largest_benefits(problem))
        # The plans over the network hold numbers in single precision and compare them to the ninth decimal.
        is_usual = largest == 0.0 or _NETWORK_SIZES[0] <= largest <= _NETWORK_SIZES[1]
        switching = problem.model.switching() is not None and is_usual
        if not problem.model.takes_prices:
            raise ValueError(
                f"dynamics: {problem.model.called} is not agent-local (it has neither path_oracle nor "
                "local_model), so no prices take its agents apart; HAAL and Exact(method='dp') serve any dynamics"
            )
        builder = _network_builder(self, problem, run) if switching else _oracle_builder(self, problem)
        start = rollout(problem, HAA(), run.part()).plan if run.start is None else run.start
        return DualSearch(self, problem, builder, run, start)


def _oracle_builder(options: DualDecomposition, problem: SAP) -> PlanBuilder:
    oracle = paths_from(options, problem, 0, problem.initial_state())
    if isinstance(oracle, GroupPaths):
        return CopiedPlans(problem, oracle, threads=options.threads)
    return OraclePlans(problem, oracle)


def _network_builder(options: DualDecomposition, problem: SAP, run: Run) -> PlanBuilder:
    """For the plain switching rule: whether a matrix of all agents and tasks is too much, and can be done without."""
    arrays = Arrays.of(problem)
    if problem.n * problem.m > _LARGE and isinstance(
        paths_from(options, problem, problem.T - 1, None), FirstRowsOracle
    ):
        in_windows = run.time_limit is not None and wait_anywhere(arrays)
        return LargeNetworkPlans(
            problem, arrays, options.threads, in_windows, at_length=options.rounds is None
        )
    return NetworkPlans(arrays, options.threads)
