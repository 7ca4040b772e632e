"""The planner `DualDecomposition`: prices from the dual, plans from prices, and a proven gap between the two."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any, ClassVar

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.copies.groups import GroupPaths
from sapopt.dynamics.paths.first_rows import FirstRowsOracle
from sapopt.dynamics.paths.oracles import PathOracle
from sapopt.dynamics.switching.torch_paths import KERNELS, path_oracle, torch_device
from sapopt.formulations.bounds import largest_benefits
from sapopt.formulations.dual import DualResult, ascend
from sapopt.formulations.limited.building import TooLargeError
from sapopt.formulations.limited.disturbed import needs_limits
from sapopt.formulations.limited.folded import folded
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.running.rollout import rollout
from sapopt.solvers.base import EXTRAS, Outcome, gap_unit
from sapopt.solvers.dual_decomposition.copied_plans import CopiedPlans
from sapopt.solvers.dual_decomposition.early import looked_ahead
from sapopt.solvers.dual_decomposition.network_plans import LargeNetworkPlans, NetworkPlans
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.oracle_plans import OraclePlans
from sapopt.solvers.dual_decomposition.plans import (
    REPRICED,
    SWEEPS,
    Found,
    PlanBuilder,
    Reprice,
    path_sweeps,
)
from sapopt.solvers.dual_decomposition.portfolio import Portfolio
from sapopt.solvers.dual_decomposition.repricing import repriced
from sapopt.solvers.dual_lookahead import values_first_tasks
from sapopt.solvers.haal import HAA
from sapopt.solvers.limited.counted import plan_counted
from sapopt.solvers.limited.planner import plan_limited
from sapopt.solvers.limited.unfolding import folded_run, unfolded

_DUAL_SHARE = 0.35
"""Share of a time limit after which the first ascent yields to the search for plans."""

_DUAL_REST = 0.5
"""Seconds of further ascent for every second of windows, until the ascent converges."""

_LARGE = 4_000_000
"""Pairs of agents and tasks above which plans are built from sparse values of windows."""

_LEAST_GAIN = 0.02
"""Share of the gap that a further round of a large problem must close for another one to follow."""

_EXERCISE = 40
"""Dual iterations after which the kernels of all stages have been called."""

_QUIET = 6
"""Rounds without a better plan after which the search ends, if the prices have settled as well."""

_ROUNDS = 18
"""Rounds where neither a number nor a time limit is given."""

_GLANCE, _GLANCE_SHARE, _GLANCE_SWEEPS = 24, 0.04, 2
"""Dual iterations, share of the time limit and sweeps of a first glance, which gives an early plan."""

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

    def _begin_without_prices(self, problem: SAP, run: Run) -> _Search:
        search = self._begin(problem, run)
        search.prices = np.zeros((problem.T, problem.model.price_columns(problem.n, problem.m)))
        return search

    def _begin(self, problem: SAP, run: Run) -> _Search:
        largest = max(largest_benefits(problem))
        # The plans over the network hold numbers in single precision and compare them to the ninth decimal.
        is_usual = largest == 0.0 or _NETWORK_SIZES[0] <= largest <= _NETWORK_SIZES[1]
        switching = problem.model.switching() is not None and is_usual
        if not problem.model.takes_prices:
            raise ValueError(
                f"dynamics: {problem.model.called} is not agent-local (it has neither path_oracle nor "
                "local_model), so no prices take its agents apart; HAAL and Exact(method='dp') serve any dynamics"
            )
        builder = _network_builder(self, problem) if switching else _oracle_builder(self, problem)
        start = rollout(problem, HAA(), run.part()).plan if run.start is None else run.start
        return _Search(self, problem, builder, run, start)


def _oracle_builder(options: DualDecomposition, problem: SAP) -> PlanBuilder:
    oracle = _oracle(options, problem, 0, problem.initial_state())
    if isinstance(oracle, GroupPaths):
        return CopiedPlans(problem, oracle, threads=options.threads)
    return OraclePlans(problem, oracle)


def _network_builder(options: DualDecomposition, problem: SAP) -> PlanBuilder:
    """For the plain switching rule: whether a matrix of all agents and tasks is too much, and can be done without."""
    arrays = Arrays.of(problem)
    if problem.n * problem.m > _LARGE and isinstance(
        _oracle(options, problem, problem.T - 1, None), FirstRowsOracle
    ):
        return LargeNetworkPlans(problem, arrays)
    return NetworkPlans(arrays, options.threads)


def _oracle(options: DualDecomposition, problem: SAP, k: int, state: Any) -> PathOracle:
    """The paths of the steps from ``k`` on, after ``state``."""
    return path_oracle(problem.model, problem.benefits.slice(k, problem.T), state, options.device)


@dataclass
class _Search:
    """State of one run (a `sapopt.solvers.dual_decomposition.plans.Search`)."""

    options: DualDecomposition
    problem: SAP
    builder: PlanBuilder
    run: Run
    best: IntArray
    value: float = -math.inf
    bound: float = math.inf
    prices: FloatArray | None = None
    settled: bool = False  # whether the ascent ended by itself
    dual: DualResult | None = None
    iterations: int = 0
    ascent_seconds: float = 0.0
    trace: list[dict[str, Any]] = field(default_factory=list)
    portfolio: Portfolio = field(init=False)

    def __post_init__(self) -> None:
        self.value = self.problem.evaluate(self.best).value
        self._no_less_than = 1e-9 * gap_unit(self.problem)
        self.portfolio = Portfolio(self.problem, self.options.threads, self.run.time_limit)

    @property
    def settled_prices(self) -> FloatArray:
        """The best prices so far; there are some once the first ascent is over."""
        assert self.prices is not None
        return self.prices

    @property
    def gap(self) -> float:
        """The proven gap so far, relative to the bound."""
        if not math.isfinite(self.bound):
            return math.inf
        return max(self.bound - self.value, 0.0) / max(abs(self.bound), self._no_less_than)

    @property
    def rng(self) -> np.random.Generator:
        """The run's random numbers."""
        return self.run.rng

    @property
    def sweep_count(self) -> int:
        """Sweeps of a round."""
        return self.options.sweeps

    @property
    def most_repricings(self) -> int:
        """Dual iterations that a repricing may take when there is time."""
        return self.options.repricing

    @property
    def iteration_seconds(self) -> float:
        """Time that a dual iteration over the whole horizon took."""
        return self.ascent_seconds / max(self.iterations, 1)

    @property
    def seconds_left(self) -> float:
        """Time left, infinite without a limit; none once the run was stopped."""
        return 0.0 if self.run.stopped else self.run.seconds_left

    def steps(self) -> Iterator[None]:
        """Work on; a caller may stop at every yield."""
        limit = self.run.time_limit
        dives = self.portfolio.first_dives
        if limit is not None and (self.problem.n < self.problem.m or dives is not None):
            yield from self.glance(_GLANCE_SHARE * limit)
        if (
            limit is not None
            and dives is None
            and self.run.start is None
            and values_first_tasks(self.oracle())
        ):
            yield from self.offered(looked_ahead(self.problem, self.run, self.report))
        self.ascend(math.inf if limit is None else max(0.0, _DUAL_SHARE * limit - self.run.seconds))
        yield
        if dives is not None:
            yield from self.offered(dives.improve(self))
        else:
            yield from self.offered(self.builder.rolling(self))
        if self.builder.lives_on_prices:
            yield from self.rounds_of_prices()
            yield from self.offered(path_sweeps(self, self.builder))
            yield from self.rounds_of_others()
        else:
            yield from self.offered(path_sweeps(self, self.builder))
            yield from self.rounds_of_plans()

    def glance(self, seconds: float) -> Iterator[None]:
        """Early plans, by sweeps (and a dive on full problems) under prices of a few iterations."""
        self.ascend(seconds, _GLANCE)
        dives = self.portfolio.first_dives
        if dives is not None:
            yield from self.offered(dives.glance(self))
        until = self.run.seconds + seconds
        plan = self.best
        for share in np.linspace(1.0, 0.0, _GLANCE_SWEEPS if self.problem.n < self.problem.m else 0):
            left = min(until - self.run.seconds, self.seconds_left)
            if left <= 0 or self.gap <= self.options.tolerance:
                break
            plan = self.builder.sweep(
                plan, self.settled_prices * share, self.rng, lambda: until - self.run.seconds
            )
            self.offer(plan, SWEEPS)
            yield
        if self.gap > self.options.tolerance:
            self.dual, self.settled = None, False  # the true descent begins anew, and hot

    def rounds_of_plans(self) -> Iterator[None]:
        """Improve the best plan by what pays, and the prices beside, until neither gets better."""
        quiet = windows = 0
        for _ in self.turns():
            began, before = self.run.seconds, self.value
            way = self.portfolio.turn(self.bound - self.value, self.seconds_left)
            if way is None:
                yield from self.offered(self.builder.improve(self, windows))
                windows += 1
            else:
                yield from self.offered(way.improve(self))
            self.portfolio.learn(way, self.value - before, self.run.seconds - began)
            if not self.settled:
                self.ascend(_DUAL_REST * (self.run.seconds - began))
                yield
            quiet = quiet + 1 if self.value <= before + 1e-6 * abs(before) else 0
            if quiet >= _QUIET and self.settled and (self.run.time_limit is None or self.portfolio.is_tired):
                break

    def rounds_of_prices(self) -> Iterator[None]:
        """Improve the prices and plan again, until that gains next to nothing."""
        for turn in self.turns():
            value, bound = self.value, self.bound
            self.ascend(_DUAL_REST * self.seconds_left)
            yield
            yield from self.offered(self.builder.improve(self, turn))
            if self.bound - self.value > (1.0 - _LEAST_GAIN) * (bound - value):
                break

    def rounds_of_others(self) -> Iterator[None]:
        """Dives, exchanges and the prices by turns, where there is time for more than planning anew."""
        for _ in self.turns():
            way = self.portfolio.other(self.bound - self.value, self.seconds_left)
            if way is None:
                break
            began, before = self.run.seconds, self.value
            yield from self.offered(way.improve(self))
            self.portfolio.learn(way, self.value - before, self.run.seconds - began)
            if not self.settled:
                self.ascend(_DUAL_REST * (self.run.seconds - began))
                yield

    def turns(self) -> Iterator[int]:
        """Numbers of rounds, as many as the options or the clock allow."""
        most = self.options.rounds
        if most is None and self.run.time_limit is None:
            most = _ROUNDS
        return iter(count() if most is None else range(most))

    def offered(self, found: Iterator[Found]) -> Iterator[None]:
        """Score plans as they come."""
        for phase, plan in found:
            self.offer(plan, phase)
            yield

    def ascend(self, seconds: float, most: int | None = None) -> None:
        """Improve the prices for some time, in at most so many iterations."""
        if self.settled:
            return
        began = self.run.seconds

        def tell(iteration: int, bound: float, prices: FloatArray) -> bool:
            if bound < self.bound:
                self.bound, self.prices = bound, prices
            if iteration % 20 == 0:
                self.record("prices")
            return self.report("prices")

        # a large problem gains more from a second smooth descent than from the subgradient steps that would follow
        anew = self.dual is None or self.builder.lives_on_prices
        self.dual = ascend(
            self.oracle(),
            None if self.dual is None else self.prices,
            state=None if anew or self.dual is None else self.dual.state,
            time_limit=None if math.isinf(seconds) else max(0.0, min(seconds, self.seconds_left)),
            max_iterations=min(most or self.options.iterations, self.options.iterations - self.iterations),
            target=self.value,
            tolerance=self.options.tolerance,
            callback=tell,
        )
        self.iterations += self.dual.iterations
        self.ascent_seconds += self.run.seconds - began
        self.settled = self.dual.converged or self.iterations >= self.options.iterations
        if self.dual.bound <= self.bound:
            self.bound, self.prices = float(self.dual.bound), self.dual.prices
        self.record("prices")

    def oracle(self) -> PathOracle:
        """The paths over all steps."""
        return _oracle(self.options, self.problem, 0, self.problem.initial_state())

    def repricing(self, count: int) -> Reprice:
        """A repricing of ``count`` dual iterations."""

        def reprice(k: int, state: Any, prices: FloatArray) -> FloatArray:
            oracle = _oracle(self.options, self.problem, k, state)
            return repriced(oracle, prices, count, lambda: self.report(REPRICED))

        return reprice

    def offer(self, plan: IntArray, phase: str) -> None:
        """Keep a plan if it is the best."""
        if self.builder.promises(plan, self.value):
            value = self.problem.evaluate(plan).value
            if value > self.value:
                self.best, self.value = plan.copy(), value
                self.record(phase)
        self.report(phase)

    def record(self, phase: str) -> None:
        """Add a line to the trace."""
        bound = self.bound if math.isfinite(self.bound) else None
        gap = self.gap if bound is not None else None
        self.trace.append(
            {"seconds": self.run.seconds, "phase": phase, "value": self.value, "bound": bound, "gap": gap}
        )

    def report(self, phase: str) -> bool:
        """Tell of a phase; whether the run is to stop."""
        limit = self.run.time_limit
        done, total = (self.iterations, 0) if limit is None else (self.run.seconds, limit)
        bound = self.bound if math.isfinite(self.bound) else None
        return self.run.report(done, total, self.value, bound, phase)
