"""The method "network". Where stays can be written down, branch and price over them; else a search in the network.

Search over the time-expanded network: prices, reduced-cost fixing, neighbourhoods, and a mixed-integer programme.

With prices that prove the bound D, a plan that uses an arc of reduced cost r is worth at most D - r. So all plans worth
more than D - delta use arcs of reduced cost below delta, a small share of the network if the prices are good. The
search guesses a small delta and solves the rest exactly: either the best plan found is worth at least D - delta,
and is optimal, or D - delta is a better bound and delta grows, at most to the gap of the incumbent. On large
problems neighbourhoods of the incumbent (some agents, or all agents in some steps, free) are solved first, over the
same arcs.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import path_oracle
from sapopt.formulations import network as formulation
from sapopt.formulations import stays
from sapopt.formulations.bounds import cancellation
from sapopt.formulations.highs import Answer, Ending, maximise
from sapopt.formulations.network import Network, NetworkOracle
from sapopt.kernels.blocks import thread_count
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.solvers.base import gap_unit
from sapopt.solvers.exact import warm
from sapopt.solvers.exact.branch_and_price import BranchAndPrice
from sapopt.solvers.exact.forms import NetworkForm
from sapopt.solvers.exact.infeasible import explain
from sapopt.solvers.exact.neighbourhoods import Neighbourhoods

log = logging.getLogger(__name__)

_LARGE = 2500
"""Arcs within the gap beyond which neighbourhoods pay."""
_NOISE = 0.1
"""Relative noise on the prices that begin a new plan."""
_FIRST = 1e-4
"""First guess of the gap, relative to the bound."""
_ARCS_A_SECOND = 50_000
"""Arcs of a programme for every second left, above which the time would be over before HiGHS has begun to search."""


@dataclass(eq=False)
class State:
    """What is known so far.

    Attributes
    ----------
    best : Incumbent
    bound : float
        No plan is worth more.
    trace : list of dict
    prices : ndarray or None
        Prices, while it is they that prove the bound.
    """

    best: warm.Incumbent
    bound: float
    trace: list[dict[str, Any]]
    prices: FloatArray | None = None


class Search:
    """One run of the network method."""

    def __init__(self, problem: SAP, run: Run, tolerance: float, fix: bool) -> None:
        self.problem = problem
        self.run = run
        self.tolerance = tolerance
        self.fix = fix
        self.unit = gap_unit(problem)
        self.hidden = cancellation(problem)
        self.state = State(warm.Incumbent(), np.inf, [])
        self.options: dict[str, Any] = {}

    @cached_property
    def network(self) -> Network:
        """The network, made when it is needed."""
        return formulation.formulate(self.problem)

    def solve(self) -> State:
        """Run all phases; ends early when the time is up, keeping what is known."""
        state = self.state
        try:
            left = self.run.seconds_left
            self.state.best = warm.incumbent(self.problem, self.run, min(0.1 * left, 20.0))
            self.note("heuristics")
            if self.fix and self.state.best.plan is not None and stays.refusal(self.problem) is None:
                self._branch_and_price()
            else:
                self._over_network()
        except KeyboardInterrupt:
            self.run.stopped = True
        if state.best.plan is None and np.isneginf(state.bound):
            raise InfeasibleError(explain(self.problem, self.network))
        return state

    @property
    def proven(self) -> bool:
        """Whether bound and value meet."""
        return self.state.bound - self.state.best.value <= self.slack

    @property
    def slack(self) -> float:
        """Gap that counts as none."""
        value = self.state.best.value
        return self.tolerance * max(self.unit, abs(value)) if np.isfinite(value) else 0.0

    def note(self, phase: str, bound: float | None = None, plan: IntArray | None = None) -> None:
        """Take over a bound or a plan, and report."""
        state = self.state
        state.best = state.best.better(self.problem, plan)
        if bound is not None and bound < state.bound:
            state.bound, state.prices = bound, None
        # a bound below the incumbent is the solver's rounding
        state.bound = max(state.bound, state.best.value)
        record = {
            "phase": phase,
            "seconds": self.run.seconds,
            "value": state.best.value,
            "bound": state.bound,
        }
        state.trace.append(record)
        log.debug("%(phase)s %(seconds).2f s: value %(value).9g, bound %(bound).9g", record)
        self.run.report(self.run.seconds, self.run.time_limit or 0.0, state.best.value, state.bound, phase)

    def _branch_and_price(self) -> None:
        def tell(
            phase: str, bound: float | None, prices: FloatArray | None, plan: IntArray | None
        ) -> warm.Incumbent:
            self.note(phase, bound, plan)
            if prices is not None and self.state.bound == bound:
                self.state.prices = prices
            return self.state.best

        search = BranchAndPrice(self.problem, self.run, self.state.best, self.tolerance, tell)
        search.solve(thread_count())

    def _over_network(self) -> None:
        self._price()
        if not self.proven and not self.run.expired:
            self._stages()

    def _price(self) -> None:
        left = self.run.seconds_left
        T, n, m = self.network.shape
        effort = 0.05 + self.network.arcs / 700
        self.prices = warm.price(
            self.problem, self.network, self.run, self.state.best.value, min(0.15 * left, effort)
        )
        if not np.isfinite(self.prices.bound):
            self.note("prices", -np.inf)
            return
        self.note("prices", self.prices.bound)
        if self.state.bound == self.prices.bound:
            self.state.prices = self.prices.prices

    def _within(self, delta: float) -> np.ndarray:
        return self.prices.regret <= delta + 1e-7 * max(self.unit, abs(self.prices.bound)) + 2.0 * self.hidden

    def _gap(self) -> float:
        """All better plans than the incumbent live on arcs of at most this reduced cost."""
        return self.prices.bound - self.state.best.value if self.fix else np.inf

    def _stages(self) -> None:
        if int(self._within(self._gap()).sum()) > _LARGE:
            seconds = min(0.1 * self.run.seconds_left, 0.5 + self.network.arcs / 4000)
            plan = warm.decomposition(self.problem, self.run, seconds)
            self.note("decomposition", plan=plan)
            left = self.run.seconds_left
            if int(self._within(self._gap()).sum()) < 4 * _LARGE:
                self._neighbourhoods(min(0.1 * left, 0.5 + self.network.arcs / 4000))
            else:
                self._neighbourhoods(0.35 * left if np.isfinite(left) else 120.0)
            # plans come from the neighbourhoods: the solver is to prove
            self.options = {"mip_heuristic_effort": 0.01}
        delta = _FIRST * max(self.unit, abs(self.prices.bound)) if self.fix else np.inf
        last = False
        while not self.proven and not self.run.expired:
            last = 4 * delta >= min(self._gap(), 0.05 * max(self.unit, abs(self.prices.bound)))
            if last:
                delta = self._gap()
            if not self._fits(delta):
                break
            ended = self._programme(delta, 1.0 if last else 0.4)
            if last or not ended:
                break
            delta *= 3
        if self.proven or self.run.expired:
            return
        if not self._fits(self._gap()):
            self._neighbourhoods(self.run.seconds_left)
        elif not last:
            self._programme(self._gap(), 1.0)

    def _fits(self, delta: float) -> bool:
        """Whether there is time for a programme of the arcs of reduced cost up to `delta`, or no other way to plan."""
        most = _ARCS_A_SECOND * self.run.seconds_left
        return self.state.best.plan is None or int(self._within(delta).sum()) <= most

    def _programme(self, delta: float, share: float) -> bool:
        """Solve the arcs of reduced cost up to `delta` in a share of the time that is left once they are written down.

        Returns whether the search came to its end.
        """
        gap = self._gap()
        keep = self._within(delta)
        floor = self.prices.bound - delta if np.isfinite(delta) else -np.inf
        cutoff, start = floor, None
        if delta >= gap:
            cutoff = self.state.best.value
        if delta >= gap and self.state.best.plan is not None:
            path = self.network.follow(self.state.best.plan) > 0.5
            keep |= path
            start = path[keep].astype(np.float64)
            cutoff = -np.inf
        answer = self._solve(keep, share, cutoff=cutoff, start=start)
        if answer.ending is Ending.INFEASIBLE:
            self.note("programme", -np.inf if self.state.best.plan is None else self.state.best.value)
            return True
        plan = None if answer.x is None else formulation.recover(self.network, answer.x, keep)
        # Plans over other arcs are worth at most `floor`; below the cut-off the solver says nothing.
        self.note("programme", max(answer.bound, floor), plan)
        return answer.ending is Ending.OPTIMAL

    def _solve(self, keep: np.ndarray, share: float, **options: Any) -> Answer:
        def watch(value: float, bound: float) -> bool:
            best = self.state.best.value
            return self.run.report(
                self.run.seconds, self.run.time_limit or 0.0, best, self.state.bound, "programme"
            )

        programme = self.network.programme(keep)
        return maximise(
            programme, seconds=share * self.run.seconds_left, tolerance=self.tolerance,
            watch=watch, options=self.options, **options,
        )  # fmt: skip

    def _neighbourhoods(self, seconds: float) -> None:
        """Improve the incumbent by small exact problems for some seconds."""
        local = Neighbourhoods(
            self.problem, NetworkForm(self.network, self.prices.regret), self._sample, self.prices.bound, self.run,
            self._found, self.tolerance,
        )  # fmt: skip
        self.state.best = max(
            self.state.best, local.improve(self.state.best, seconds), key=lambda entry: entry.value
        )

    def _sample(self, first: bool) -> IntArray | None:
        """A plan from noisy prices: the agents in random order take their best path through what is left."""
        if first:
            return None
        oracle: Any = NetworkOracle(self.network)
        if self.problem.model.is_agent_local:
            oracle = path_oracle(self.problem.model, self.problem.benefits, self.problem.initial_state())
        T, n, m = self.network.shape
        noise = 1.0 + _NOISE * self.run.rng.standard_normal((T, m))
        prices: FloatArray = self.prices.prices * np.maximum(noise, 0.0)
        plan = np.empty((T, n), dtype=np.int64)
        for agent in self.run.rng.permutation(n):
            value, path = oracle.best_path(int(agent), prices)
            if not np.isfinite(value):
                return None
            plan[:, agent] = path
            prices[np.arange(T), path] = np.inf
        return plan

    def _found(self, plan: IntArray) -> float:
        before = self.state.best.value
        best = self.state.best.better(self.problem, plan)
        if best.value > before:
            self.note("neighbourhood", plan=plan)
        return self.state.best.value


def solve(problem: SAP, run: Run, tolerance: float, fix: bool = True) -> State:
    """Solve over the network; see the module."""
    return Search(problem, run, tolerance, fix).solve()
