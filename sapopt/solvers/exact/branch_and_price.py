"""The exact search over stays: prices, cuts, neighbourhoods for a good plan, and branch and price for the proof."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import path_oracle
from sapopt.formulations import stays as formulation
from sapopt.formulations.bounds import cancellation
from sapopt.formulations.dual import ascend
from sapopt.formulations.stays import Stays
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.solvers.base import gap_unit
from sapopt.solvers.exact.cuts import coefficients, violated
from sapopt.solvers.exact.dive import dive
from sapopt.solvers.exact.forms import StaysForm
from sapopt.solvers.exact.master import Master
from sapopt.solvers.exact.neighbourhoods import Neighbourhoods
from sapopt.solvers.exact.tree import Tree
from sapopt.solvers.exact.warm import Incumbent

_BEGIN = 2000
"""Stays that the relaxation begins with."""
_FEW = 1500
"""Stays left in the game up to which the proof is begun at once."""
_CUTS = 100
"""Cuts that are added at a time."""
_ROUNDS = 15
_SHARE = 0.2
"""Share of the time left for better plans before the proof, at most."""
_POLISH = 0.01
"""Share of the time left that is spent on a plan which a dive during the proof has found."""
_QUIET = 0.15
"""Share of that time after which the search for better plans ends without one."""


class BranchAndPrice:
    """One run.

    Parameters
    ----------
    problem : SAP
    run : Run
    best : Incumbent
        A plan to start from; there must be one.
    tolerance : float
        Relative gap that counts as none.
    note : callable
        ``note(phase, bound, prices, plan) -> Incumbent``: takes over what was found and returns the best plan known.
    """

    def __init__(
        self,
        problem: SAP,
        run: Run,
        best: Incumbent,
        tolerance: float,
        note: Callable[[str, float | None, FloatArray | None, IntArray | None], Incumbent],
    ) -> None:
        self.problem = problem
        self.run = run
        self.best = best
        self.tolerance = tolerance
        self.unit = gap_unit(problem)
        self.hidden = cancellation(problem)
        self._note = note
        self.bound = np.inf
        self.lock = threading.Lock()
        self.local: Neighbourhoods | None = None

    def solve(self, threads: int) -> None:
        """Run all phases; ends early when the time is up."""
        stays = formulation.formulate(self.problem)
        prices = self._prices(len(stays))
        values, through = stays.through(stays.priced(prices))
        self._tell("prices", float(values.sum() + prices.sum()), prices)
        stays = stays.only(values[stays.agent] - through <= self._gap())
        master, regret = self._root(stays)
        if self._settled():
            return
        if int((regret <= self._gap()).sum()) > _FEW:
            self._improve(master, regret)
            if self._settled():
                return
        keep = np.flatnonzero(regret <= self._gap())
        stays, regret = stays.only(keep), regret[keep]
        tree = Tree(
            stays,
            np.argsort(regret)[:_BEGIN],
            self.bound,
            self._found,
            self._target,
            self._watch,
            self._polish,
            lambda: self.run.expired,
            self.unit,
        )
        tree.cuts, tree.right = master.cuts[:, keep], master.right
        bound = tree.search(threads)
        self._tell("branch and price", bound)

    def _prices(self, count: int) -> FloatArray:
        oracle = path_oracle(self.problem.model, self.problem.benefits, self.problem.initial_state())
        seconds = min(0.1 * self.run.seconds_left, 0.05 + count / 100_000)
        found = ascend(
            oracle, time_limit=seconds, max_iterations=5000, target=self.best.value, tolerance=1e-9,
            callback=lambda *_: self.run.expired,
        )  # fmt: skip
        self.prices: FloatArray = found.prices
        return found.prices

    def _root(self, stays: Stays) -> tuple[Master, FloatArray]:
        """Solve the relaxation with cuts; also how much a plan that uses a stay falls short of the bound."""
        values, through = stays.through(stays.priced(self.prices))
        master = Master(
            stays, np.argsort(values[stays.agent] - through)[:_BEGIN], lambda: self.run.expired, self.unit
        )
        everything = np.zeros(len(stays), dtype=bool)
        for _ in range(_ROUNDS):
            relaxed = master.solve(everything, self._target())
            plan = stays.plan_of(relaxed.stays[relaxed.x > 0.5]) if relaxed.whole else None
            self._tell("relaxation", relaxed.bound, None if len(master.right) else relaxed.prices, plan)
            if self._settled() or relaxed.whole:
                break
            rows = violated(stays, relaxed.stays, relaxed.x, _CUTS, self.run.rng, lambda: self.run.expired)
            if not rows:
                break
            master.cut(*coefficients(stays, rows))
        proof = master.proof(everything)
        values, through = stays.through(proof.weight)
        return master, values[stays.agent] - through + self.bound - proof.bound

    def _improve(self, master: Master, regret: FloatArray) -> None:
        """Better plans from dives into the relaxation, and from neighbourhoods of theirs."""

        def sample(first: bool) -> IntArray | None:
            noise = 0.0 if first else float(self.run.rng.uniform(0.1, 0.4))
            return dive(
                master, regret > self._gap(), lambda: -np.inf, self.run.rng, noise, lambda: self.run.expired
            )

        seconds = min(_SHARE * self.run.seconds_left, 1.0 + len(regret) / 1500)
        self.local = search = Neighbourhoods(
            self.problem,
            StaysForm(master.stays, regret),
            sample,
            self.bound,
            self.run,
            self._found,
            self.tolerance,
        )
        search.improve(self.best, seconds, _QUIET * (seconds + 3.0))

    def _tell(
        self,
        phase: str,
        bound: float | None = None,
        prices: FloatArray | None = None,
        plan: IntArray | None = None,
    ) -> None:
        with self.lock:
            if bound is not None:
                self.bound = min(self.bound, bound)
            self.best = self._note(phase, bound, prices, plan)

    def _found(self, plan: IntArray) -> float:
        self._tell("plan", plan=plan)
        return self.best.value

    def _polish(self, plan: IntArray) -> None:
        self._found(plan)
        if self.local is not None:
            left = self.run.seconds_left
            self.local.polish(plan, _POLISH * left if np.isfinite(left) else 5.0)

    def _watch(self, bound: float, nodes: int) -> bool:
        if bound < self.bound - 1e-7 * max(self.unit, abs(bound)):
            self._tell("branch and price", bound)
        return self.run.report(
            self.run.seconds, self.run.time_limit or 0.0, self.best.value, self.bound, f"{nodes} nodes"
        )

    def _slack(self) -> float:
        return self.tolerance * max(self.unit, abs(self.best.value))

    def _target(self) -> float:
        return self.best.value + self._slack()

    def _gap(self) -> float:
        # Where large numbers cancel out, a stay of the best plan may seem to fall short by what rounding hides.
        return self.bound - self.best.value + self._slack() + 2.0 * self.hidden

    def _settled(self) -> bool:
        return self.bound <= self._target() or self.run.expired
