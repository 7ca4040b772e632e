"""Good plans for large networks: neighbourhoods of one plan, and mixtures of several, solved exactly over few arcs.

A plan is improved by freeing some agents for all steps, or all agents for some steps, while the rest stays as it
is. Plans that were improved from different beginnings share their good parts: the best plan over the union of their
arcs (and those of small reduced cost) is found quickly, and is better than any of them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sapopt.data.types import IntArray
from sapopt.formulations.highs import Answer, Ending, maximise
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.solvers.base import gap_unit
from sapopt.solvers.exact.forms import Form
from sapopt.solvers.exact.warm import Incumbent

_POOL = 6
_REACH = 0.002
"""Largest reduced cost of a column in a neighbourhood, relative to the bound."""
_SMALL, _LARGE = 7, 10
"""Agents or steps that are free in a quick descent, and in a thorough one."""


class Neighbourhoods:
    """Improves the incumbent until a deadline.

    Parameters
    ----------
    problem : SAP
    form : Form
        The programme in which plans are improved, with the reduced costs of its columns.
    sample : callable
        ``sample(first) -> plan or None``, the beginning of another plan.
    bound : float
        Bound that the reduced costs belong to.
    run : Run
        Clock and random numbers.
    note : callable
        ``note(plan) -> value of the incumbent``, told of every better plan.
    """

    def __init__(
        self,
        problem: SAP,
        form: Form,
        sample: Callable[[bool], IntArray | None],
        bound: float,
        run: Run,
        note: Callable[[IntArray], float],
        tolerance: float,
    ) -> None:
        self.problem = problem
        self.form = form
        self.bound = bound
        self.run = run
        self.note = note
        self.tolerance = tolerance
        self.scale = max(gap_unit(problem), abs(bound))
        self.stop_at = self.last = self.began = 0.0
        self.quiet = np.inf
        self.written = 0.0  # seconds that it took to write down the last neighbourhood
        self.top = -np.inf
        self.sample = sample

    @property
    def left(self) -> float:
        """Seconds until the deadline."""
        return min(self.stop_at - self.run.seconds, self.run.seconds_left)

    def improve(self, best: Incumbent, seconds: float, quiet: float = np.inf) -> Incumbent:
        """Improve an incumbent for some seconds, or until for `quiet` seconds nothing better was found."""
        self.stop_at = self.run.seconds + seconds
        self.quiet = quiet
        self.last = self.run.seconds
        first = Incumbent().better(self.problem, self.sample(True))
        best = self._kept(best, first)
        pool = [best := self._descend(best, _SMALL, 12)]
        while self._going(best):
            start = Incumbent().better(self.problem, self.sample(False))
            other = self._descend(start, _SMALL, 12)
            if other.plan is not None:
                pool = sorted([*pool, other], key=lambda entry: -entry.value)[:_POOL]
            best = self._mixture(pool, best)
            best = self._descend(best, _LARGE, 12)
            if best.value > pool[0].value:
                pool = [best, *pool][:_POOL]
        return best

    def polish(self, plan: IntArray, seconds: float) -> None:
        """Improve another plan for some seconds; better ones are noted."""
        self.stop_at = self.run.seconds + seconds
        self.quiet = np.inf
        self._descend(Incumbent().better(self.problem, plan), _SMALL, 12)

    def _going(self, best: Incumbent) -> bool:
        if best.plan is not None and best.value >= self.bound - self.tolerance * self.scale:
            return False
        return self.left > self.written and not self.run.expired and self.run.seconds < self.last + self.quiet

    def _descend(self, best: Incumbent, size: int, patience: int) -> Incumbent:
        """Improve a plan by random neighbourhoods until `patience` of them in a row give nothing."""
        T, n, _ = self.form.shape
        failures = 0
        while best.plan is not None and failures < patience and self._going(best):
            free = np.zeros((T, n), dtype=bool)
            if self.run.rng.random() < 0.5:
                free[:, self.run.rng.choice(n, min(size, n), replace=False)] = True
            else:
                first = int(self.run.rng.integers(1 - size // 2, T - size // 2)) if size < T else 0
                free[max(first, 0) : first + size] = True
            found = self._around(best, free)
            failures = 0 if found.value > best.value + 1e-9 * self.scale else failures + 1
            best = self._kept(best, found)
        return best

    def _around(self, best: Incumbent, free: np.ndarray) -> Incumbent:
        """The best plan that differs from this one only where (T, n) `free` allows it."""
        assert best.plan is not None
        self.began = self.run.seconds
        near = self._near(min(self.bound - best.value, _REACH * self.scale))
        keep = self.form.around(best.plan, free) & near
        return self._solve(keep, best, max(2.0, 0.03 * self.left))

    def _mixture(self, pool: list[Incumbent], best: Incumbent) -> Incumbent:
        """The best plan over the arcs of several plans and those of small reduced cost."""
        self.began = self.run.seconds
        keep = self._near(1e-4 * self.scale)
        for entry in pool:
            if entry.plan is not None:
                keep |= self.form.follow(entry.plan)
        return self._kept(best, self._solve(keep, best, max(5.0, 0.1 * self.left)))

    def _near(self, regret: float) -> np.ndarray:
        return self.form.regret <= regret + 1e-7 * self.scale

    def _solve(self, keep: np.ndarray, best: Incumbent, seconds: float) -> Incumbent:
        """The best plan over the arcs `keep` and those of the incumbent, in some seconds once it is written down."""
        start = None
        if best.plan is not None:
            path = self.form.follow(best.plan)
            keep = keep | path
            start = path[keep].astype(np.float64)
        programme = self.form.programme(keep)
        self.written = self.run.seconds - self.began
        answer: Answer = maximise(
            programme, seconds=min(seconds, self.left), tolerance=1e-6, start=start,
            watch=lambda value, bound: self.run.expired,
        )  # fmt: skip
        if answer.x is None or answer.ending is Ending.INFEASIBLE:
            return Incumbent()
        return Incumbent().better(self.problem, self.form.recover(answer.x, keep))

    def _kept(self, best: Incumbent, found: Incumbent) -> Incumbent:
        if found.plan is None or found.value <= best.value:
            return best
        if self.note(found.plan) <= found.value and found.value > self.top:
            self.top, self.last = found.value, self.run.seconds
        return found
