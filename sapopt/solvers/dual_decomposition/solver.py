"""The planner `DualDecomposition`: prices from the dual, plans from prices, and a proven gap between the two."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from sapopt.dynamics.paths.oracles import PathOracle, SoftPathOracle, is_agent_local
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.dynamics.switching.torch_paths import KERNELS, path_oracle, torch_device
from sapopt.formulations.dual import DualResult, ascend, dual_value
from sapopt.formulations.dual.smooth import SmoothDescent
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.running.outlook import rollout
from sapopt.solvers.base import Outcome
from sapopt.solvers.dual_decomposition import paths
from sapopt.solvers.dual_decomposition.arrays import Arrays, Floats, Ints
from sapopt.solvers.dual_decomposition.neighbourhoods import Effort, improved
from sapopt.solvers.dual_decomposition.rolling import rolling_plan
from sapopt.solvers.dual_decomposition.rolling_windows import rolling_windows
from sapopt.solvers.dual_decomposition.sweeps import sweep
from sapopt.solvers.dual_decomposition.windowed import windowed_plan
from sapopt.solvers.haal import HAA

log = logging.getLogger(__name__)

_EFFORTS = (Effort(10, 8_000), Effort(15, 11_000), Effort(20, 15_000), Effort(30, 30_000), Effort(40, 40_000))
"""Windows of the successive rounds, from small ones that go fast to large ones; the last one is repeated."""

_DUAL_REST = 0.5
"""Seconds of further ascent for every second of windows, until the ascent converges."""

_GROUP_ARCS = 10_000
"""Size of the networks of few agents over the whole horizon."""

_DUAL_SHARE = 0.35
"""Share of a time limit after which the first ascent yields to the search for plans."""


_BLOCK = 3
"""Steps between two repricings."""

_REPRICING_SHARE = 0.5
"""Share of the time left that repricing may take."""

_FEWEST_REPRICINGS = 10
"""Dual iterations below which a repricing does more harm than good."""

_WIDE_GAP = 0.02
"""Gap of the rolling assignment above which rolling windows, which take longer, are worth their time."""

_WINDOWS_SHARE = 0.8
"""Share of the time left that rolling windows may take."""

_WINDOW_REPRICINGS = 20
"""Dual iterations before each of the rolling windows."""

_LARGE = 4_000_000
"""Pairs of agents and tasks above which plans are built from sparse values of windows."""

_REPRICED_WINDOW = 10
"""Steps whose prices are improved before each step of a large problem."""

_LEAST_GAIN = 0.02
"""Share of the gap that a further round of a large problem must close for another one to follow."""

_REPRICING_HEAT = 0.01
"""Temperature of the repricing, in typical benefits."""


@dataclass(frozen=True)
class DualDecomposition:
    """Near-optimal plans for the whole horizon, with a proven bound.

    The prices of the task capacities are ascended until the Lagrangian bound settles. They turn into plans by a rolling
    assignment with priced futures and by sweeps in which one agent after another takes its best priced path. With a
    `SwitchingCost`, windows of the best plan are then solved exactly, as network flows restricted to cells whose prices
    show that a near-optimal plan may use them; with other agent-local dynamics (those with a
    `path_oracle` or `local_model`) the sweeps go on.

    Parameters
    ----------
    iterations : int
        Most dual iterations.
    rounds : int
        Most rounds of windows (or of further sweeps).
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
    rounds: int = 18
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
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)!r}")

    @property
    def name(self) -> str:
        """Name."""
        return "DualDecomposition"

    def plan(self, problem: SAP, run: Run) -> Outcome:
        """Find a plan and a bound; a time limit, the callback or an interruption ends with the best of both."""
        switching = type(problem.dynamics) is SwitchingCost
        if not is_agent_local(problem.model):
            raise ValueError(
                f"dynamics: {type(problem.dynamics).__name__} is not agent-local (it has neither path_oracle nor "
                "local_model), so no prices take its agents apart; HAAL and Exact(method='dp') serve any dynamics"
            )
        arrays = Arrays.of(problem) if switching else None
        start = rollout(problem, HAA(), run.part()).plan if run.start is None else run.start
        search = _Search(self, problem, arrays, run, start)
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


@dataclass
class _Search:
    """State of one run."""

    options: DualDecomposition
    problem: SAP
    arrays: Arrays | None  # None: no SwitchingCost, so no windows; plans come from the oracle alone
    run: Run
    best: Ints
    value: float = -math.inf
    bound: float = math.inf
    prices: Floats | None = None
    settled: bool = False  # whether the ascent ended by itself
    dual: DualResult | None = None
    iterations: int = 0
    ascent_seconds: float = 0.0
    repricings: int = 0
    trace: list[dict[str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.value = self.problem.evaluate(self.best).value

    @property
    def gap(self) -> float:
        if not math.isfinite(self.bound):
            return math.inf
        return max(self.bound - self.value, 0.0) / max(abs(self.bound), 1e-9)

    def steps(self) -> Iterator[None]:
        """Work on; a caller may stop at every yield."""
        limit = self.run.time_limit
        self.ascend(math.inf if limit is None else _DUAL_SHARE * limit)
        yield
        yield from self.first_plans()
        if self.is_large:
            yield from self.further_plans()
            yield from self.sweeps()
            return
        quiet = 0
        for turn in range(self.options.rounds):
            began, before = self.run.seconds, self.value
            yield from self.sweeps() if self.arrays is None else self.windows(self.arrays, turn)
            if not self.settled:
                self.ascend(_DUAL_REST * (self.run.seconds - began))
                yield
            quiet = quiet + 1 if self.value <= before + 1e-6 * abs(before) else 0
            if quiet >= 6 and self.settled:
                break

    def windows(self, arrays: Arrays, turn: int) -> Iterator[None]:
        """Solve neighbourhoods exactly: windows, windows shifted by half, few agents over the whole horizon."""
        assert self.prices is not None
        effort = _EFFORTS[min(turn // 3, len(_EFFORTS) - 1)]
        shift = turn % 3 * effort.length // 2
        if turn % 3 == 2:
            effort, shift = Effort(arrays.steps, _GROUP_ARCS), 0
        search = improved(
            arrays, self.best, self.prices, effort, shift, self.run.rng,
            threads=self.options.threads, seconds_left=self.seconds_left,
        )  # fmt: skip
        for plan in search:
            self.offer(plan, f"windows of {effort.length} steps")
            yield

    def seconds_left(self) -> float:
        return 0.0 if self.run.stopped else self.run.seconds_left

    def ascend(self, seconds: float) -> None:
        """Improve the prices for some time."""
        if self.settled:
            return
        began = self.run.seconds

        def tell(iteration: int, bound: float, prices: Floats) -> bool:
            if bound < self.bound:
                self.bound, self.prices = bound, prices
            if iteration % 20 == 0:
                self.record("prices")
            return self.report("prices")

        self.dual = ascend(
            self.oracle(0, self.problem.initial_state()),
            self.prices,
            # a large problem gains more from a second smooth descent than from the subgradient steps that would follow
            state=None if self.dual is None or self.is_large else self.dual.state,
            time_limit=None if math.isinf(seconds) else max(0.0, min(seconds, self.seconds_left())),
            max_iterations=self.options.iterations - self.iterations,
            target=self.value,
            tolerance=self.options.tolerance,
            callback=tell,
            seed=self.run.seed,
        )
        self.iterations += self.dual.iterations
        self.ascent_seconds += self.run.seconds - began
        self.settled = self.dual.converged or self.iterations >= self.options.iterations
        if self.dual.bound <= self.bound:
            self.bound, self.prices = float(self.dual.bound), self.dual.prices
        self.record("prices")

    def oracle(self, k: int, state: Any) -> PathOracle:
        """Return the paths of the steps from ``k`` on, after ``state``."""
        benefits = self.problem.benefits.slice(k, self.problem.T)
        return path_oracle(self.problem.model, benefits, state, self.options.device)

    def reprice(self, k: int, state: Any, prices: Floats) -> Floats:
        """Return prices for what is left of the problem at step ``k``."""
        oracle = self.oracle(k, state)
        if not isinstance(oracle, SoftPathOracle):
            return prices
        descent = SmoothDescent(iterations=1, hot=_REPRICING_HEAT)
        walk = descent.begin(prices)
        bound = dual_value(oracle, prices).bound
        while walk.iteration < self.repricings:
            walk = descent.step(oracle, walk)
            if self.report("repriced assignment"):
                break
            if walk.iteration % 10 == 0:
                found = dual_value(oracle, walk.prices).bound
                if found < bound:
                    bound, prices = found, walk.prices
        return prices

    def rolling(self, phase: str, **options: Any) -> Ints | None:
        """Return the plan of a rolling assignment, None if the run ended first."""
        assert self.prices is not None
        if self.arrays is None:
            return paths.rolling_plan(self.problem, self.prices, lambda: self.report(phase), **options)
        return rolling_plan(self.arrays, self.prices, lambda: self.report(phase), **options)

    def first_plans(self) -> Iterator[None]:
        """Build plans from the prices alone, the quick ones first."""
        if self.is_large:
            yield from self.windowed_plans()
            return
        plan = self.rolling("rolling assignment")
        if plan is not None:
            self.offer(plan, "rolling assignment")
            yield
        if self.arrays is not None and self.problem.n < self.problem.m and self.gap > _WIDE_GAP:
            plan, phase = self.windows_ahead(self.arrays), "rolling windows"
        else:
            self.repricings, phase = self.affordable_repricings(), "repriced assignment"
            if not self.repricings or self.report(phase):
                plan = None
            else:
                plan = self.rolling(phase, block=_BLOCK, reprice=self.reprice)
        if plan is not None:
            self.offer(plan, phase)
            yield
        yield from self.sweeps()

    def windows_ahead(self, arrays: Arrays) -> Ints | None:
        """Return the plan of the rolling windows, None if the run ended first."""
        assert self.prices is not None
        self.repricings = _WINDOW_REPRICINGS
        return rolling_windows(
            arrays, self.best, self.prices, self.run.rng,
            reprice=self.reprice, seconds=_WINDOWS_SHARE * self.seconds_left(),
            stop=lambda: self.report("rolling windows"),
        )  # fmt: skip

    @cached_property
    def is_large(self) -> bool:
        """Whether a matrix of all agents and tasks at every step is too much, and can be done without."""
        return (
            self.problem.n * self.problem.m > _LARGE
            and self.arrays is not None
            and hasattr(self.oracle(self.problem.T - 1, None), "first_rows")
        )

    def windowed_plans(self) -> Iterator[None]:
        """Rolling assignments that look at a window of steps, without and with improved prices."""
        assert self.prices is not None

        def seconds(k: int) -> float:
            return _REPRICING_SHARE * self.seconds_left() / (self.problem.T - k)

        ways: dict[str, dict[str, Any]] = {"rolling assignment": {}}
        if self.options.repricing:
            ways["repriced assignment"] = {
                "window": _REPRICED_WINDOW, "iterations": 2 * self.options.repricing, "seconds": seconds
            }  # fmt: skip
        for phase, options in ways.items():
            plan = windowed_plan(self.problem, self.prices, lambda at=phase: self.report(at), **options)  # type: ignore[misc]
            if plan is None:
                return
            self.offer(plan, phase)
            yield

    def further_plans(self) -> Iterator[None]:
        """Improve the prices and plan again, until that gains next to nothing: networks of windows gain less here."""
        for _ in range(self.options.rounds):
            value, bound = self.value, self.bound
            self.ascend(_DUAL_REST * self.seconds_left())
            yield
            yield from self.windowed_plans()
            if self.bound - self.value > (1.0 - _LEAST_GAIN) * (bound - value):
                break

    def sweeps(self) -> Iterator[None]:
        """Let the agents move to their best paths in turn, under prices that fall to nothing."""
        assert self.prices is not None
        if self.problem.n == self.problem.m:
            return
        plan = self.best
        count = self.options.sweeps
        oracle = self.oracle(0, self.problem.initial_state())
        for q in range(count):
            prices = self.prices * (1.0 - q / max(count - 1, 1))
            if self.arrays is None:
                plan = paths.sweep(oracle, plan, prices, self.run.rng, self.seconds_left)
            else:
                plan = sweep(self.arrays, plan, prices, self.run.rng, self.seconds_left)
            self.offer(plan, "path sweeps")
            yield

    def affordable_repricings(self) -> int:
        """Return how many dual iterations every repricing may take: 0 if there is no time for enough of them."""
        most = self.options.repricing
        if math.isinf(self.run.seconds_left):
            return most
        once = self.ascent_seconds / max(self.iterations, 1) * self.problem.T / _BLOCK / 2
        count = min(most, int(_REPRICING_SHARE * self.seconds_left() / max(once, 1e-9)))
        return count if count >= _FEWEST_REPRICINGS else 0

    def offer(self, plan: Ints, phase: str) -> None:
        """Keep a plan if it is the best."""
        if self.arrays is None or self.arrays.value(plan) > self.value + 1e-9:
            value = self.problem.evaluate(plan).value
            if value > self.value:
                self.best, self.value = plan.copy(), value
                self.record(phase)
        self.report(phase)

    def record(self, phase: str) -> None:
        bound = self.bound if math.isfinite(self.bound) else None
        gap = self.gap if bound is not None else None
        self.trace.append(
            {"seconds": self.run.seconds, "phase": phase, "value": self.value, "bound": bound, "gap": gap}
        )

    def report(self, phase: str) -> bool:
        limit = self.run.time_limit
        done, total = (self.iterations, 0) if limit is None else (self.run.seconds, limit)
        bound = self.bound if math.isfinite(self.bound) else None
        return self.run.report(done, total, self.value, bound, phase)
