"""Good plans for large networks: neighbourhoods of one plan, and mixtures of several, solved exactly over few arcs.

A plan is improved by freeing some agents for all steps, or all agents for some steps, while the rest stays as it
is. Plans that were improved from different beginnings share their good parts: the best plan over the union of their
arcs (and those of small regret) is found quickly, and is better than any of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sapopt.control import Run
from sapopt.formulations import network as formulation
from sapopt.formulations.highs import Answer, Ending, maximise
from sapopt.formulations.network import Network, NetworkOracle
from sapopt.problem import SAP
from sapopt.solvers.exact.warm import Incumbent, Prices
from sapopt.types import FloatArray, IntArray

_POOL = 6
_NOISE = 0.1
"""Relative noise on the prices that begin a new plan."""
_SMALL, _LARGE = 7, 10
"""Agents or steps that are free in a quick descent, and in a thorough one."""


class Neighbourhoods:
    """Improves the incumbent until a deadline.

    Parameters
    ----------
    problem, network, prices
        What is solved, and the regrets of its arcs.
    run : Run
        Clock and random numbers.
    note : callable
        ``note(plan) -> value of the incumbent``, told of every better plan.
    """

    def __init__(
        self,
        problem: SAP,
        network: Network,
        prices: Prices,
        run: Run,
        note: Callable[[IntArray], float],
        tolerance: float,
    ) -> None:
        self.problem = problem
        self.network = network
        self.prices = prices
        self.run = run
        self.note = note
        self.tolerance = tolerance
        self.scale = max(1.0, abs(prices.bound))
        self.stop_at = 0.0
        oracle: Any = NetworkOracle(network)
        if hasattr(problem.model, "path_oracle"):
            oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
        self.oracle = oracle

    @property
    def left(self) -> float:
        """Seconds until the deadline."""
        return min(self.stop_at - self.run.seconds, self.run.seconds_left)

    def improve(self, best: Incumbent, seconds: float) -> Incumbent:
        """Improve an incumbent for some seconds."""
        self.stop_at = self.run.seconds + seconds
        pool = [best := self._descend(best, _SMALL, 12)]
        while self._going(best):
            other = self._descend(self._sample(), _SMALL, 12)
            if other.plan is not None:
                pool = sorted([*pool, other], key=lambda entry: -entry.value)[:_POOL]
            best = self._mixture(pool, best)
            best = self._descend(best, _LARGE, 12)
            if best.value > pool[0].value:
                pool = [best, *pool][:_POOL]
        return best

    def _going(self, best: Incumbent) -> bool:
        if best.plan is not None and best.value >= self.prices.bound - self.tolerance * self.scale:
            return False
        return self.left > 0 and not self.run.expired

    def _sample(self) -> Incumbent:
        """A plan from noisy prices: the agents in random order take their best path through what is left."""
        T, n, m = self.network.shape
        noise = 1.0 + _NOISE * self.run.rng.standard_normal((T, m))
        prices: FloatArray = self.prices.prices * np.maximum(noise, 0.0)
        plan = np.empty((T, n), dtype=np.int64)
        for agent in self.run.rng.permutation(n):
            value, path = self.oracle.best_path(int(agent), prices)
            if not np.isfinite(value):
                return Incumbent()
            plan[:, agent] = path
            prices[np.arange(T), path] = np.inf
        return Incumbent().better(self.problem, plan)

    def _descend(self, best: Incumbent, size: int, patience: int) -> Incumbent:
        """Improve a plan by random neighbourhoods until `patience` of them in a row give nothing."""
        T, n, _ = self.network.shape
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
        net = self.network
        T, _, m = net.shape
        assert best.plan is not None
        taken = np.zeros(T * m, dtype=bool)
        taken[(np.arange(T)[:, None] * m + best.plan)[~free]] = True
        keep = self._near(min(self.prices.bound - best.value, 0.002 * self.scale))
        keep &= (net.slot < 0) | (free[net.step, net.agent] & ~taken[net.slot])
        return self._solve(keep, best, max(2.0, 0.03 * self.left))

    def _mixture(self, pool: list[Incumbent], best: Incumbent) -> Incumbent:
        """The best plan over the arcs of several plans and those of small regret."""
        keep = self._near(1e-4 * self.scale)
        for entry in pool:
            if entry.plan is not None:
                keep |= self.network.follow(entry.plan) > 0.5
        return self._kept(best, self._solve(keep, best, max(5.0, 0.1 * self.left)))

    def _near(self, regret: float) -> np.ndarray:
        return self.prices.regret <= regret + 1e-7 * self.scale

    def _solve(self, keep: np.ndarray, best: Incumbent, seconds: float) -> Incumbent:
        """The best plan over the arcs `keep` and those of the incumbent."""
        start = None
        if best.plan is not None:
            path = self.network.follow(best.plan) > 0.5
            keep = keep | path
            start = path[keep].astype(np.float64)
        answer: Answer = maximise(
            self.network.programme(keep), seconds=min(seconds, self.left), tolerance=1e-6, start=start,
            watch=lambda value, bound: self.run.expired,
        )  # fmt: skip
        if answer.x is None or answer.ending is Ending.INFEASIBLE:
            return Incumbent()
        return Incumbent().better(self.problem, formulation.recover(self.network, answer.x, keep))

    def _kept(self, best: Incumbent, found: Incumbent) -> Incumbent:
        if found.plan is None or found.value <= best.value:
            return best
        self.note(found.plan)
        return found
