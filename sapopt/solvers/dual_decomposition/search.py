"""One run of `DualDecomposition`: the order in which prices and plans get better, and what is known so far."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count, takewhile
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import PathOracle
from sapopt.dynamics.switching.torch_paths import path_oracle
from sapopt.formulations.dual import DualResult, ascend
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.solvers.base import gap_unit
from sapopt.solvers.dual_decomposition.early import looked_ahead
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

if TYPE_CHECKING:
    from sapopt.solvers.dual_decomposition.solver import DualDecomposition

_DUAL_SHARE = 0.35
"""Share of a time limit after which the first ascent yields to the search for plans."""

_DUAL_REST = 0.5
"""Seconds of further ascent for every second of windows, until the ascent converges."""

_RESTING = 0.5
"""What is left of these seconds when an ascent has closed less than `_LEAST_GAIN` of the gap."""

_LEAST_GAIN = 0.02
"""Share of the gap that a further ascent, or round of a large problem, must close for another one as long to follow."""

_QUIET = 6
"""Rounds without a better plan after which the search ends, if the prices have settled as well."""

_ROUNDS = 18
"""Rounds where neither a number nor a time limit is given."""

_GLANCE, _GLANCE_SHARE, _GLANCE_SWEEPS = 24, 0.04, 2
"""Dual iterations, share of the time limit and sweeps of a first glance, which gives an early plan."""


def paths_from(options: DualDecomposition, problem: SAP, k: int, state: Any) -> PathOracle:
    """The paths of the steps from ``k`` on, after ``state``."""
    return path_oracle(problem.model, problem.benefits.slice(k, problem.T), state, options.device)


@dataclass
class DualSearch:
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
        rest = _DUAL_REST
        for _ in self.turns():
            began, before = self.run.seconds, self.value
            way = self.portfolio.turn(self.bound - self.value, self.seconds_left, self.builder.has_untried)
            if way is None:
                yield from self.offered(self.builder.improve(self, windows))
                windows += 1
            else:
                yield from self.offered(way.improve(self))
            self.portfolio.learn(way, self.value - before, self.run.seconds - began)
            if not self.settled:
                bound = self.bound
                self.ascend(rest * (self.run.seconds - began))
                if math.isfinite(self.seconds_left) and bound - self.bound < _LEAST_GAIN * (
                    bound - self.value
                ):
                    rest *= _RESTING
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
        """Numbers of rounds, as many as the options and the clock allow."""
        most = self.options.rounds
        if most is None and self.run.time_limit is None:
            most = _ROUNDS
        return takewhile(lambda turn: self.seconds_left > 0.0, count() if most is None else range(most))

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
        return paths_from(self.options, self.problem, 0, self.problem.initial_state())

    def repricing(self, count: int) -> Reprice:
        """A repricing of ``count`` dual iterations."""

        def reprice(k: int, state: Any, prices: FloatArray) -> FloatArray:
            oracle = paths_from(self.options, self.problem, k, state)
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
