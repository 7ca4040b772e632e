"""Dual lookahead: a receding horizon that prices the competition instead of enumerating intervals.

At every step the tasks of the next `window` steps are priced by a few iterations of dual descent, warm-started from the
step before. The prices of the later steps tell every agent what the best continuation from each task is worth; with
these values the current step is one assignment problem, so its assignment is free of conflicts. The cost is linear in
the window, where HAAL's is exponential in the lookahead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.first_rows import FirstRowsOracle
from sapopt.dynamics.paths.oracles import (
    FirstGainsOracle,
    FirstValueOracle,
    PathOracle,
    SoftPathOracle,
    path_oracle,
)
from sapopt.formulations.dual.lagrangian import lowered
from sapopt.formulations.dual.smooth import SmoothDescent
from sapopt.formulations.dual.subgradient import Subgradient
from sapopt.formulations.limited.dual import Prices
from sapopt.kernels import clock
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Change, Outlook
from sapopt.solvers.base import EXTRAS, check_lookahead
from sapopt.solvers.limited.receding import priced_step

_SHARES, _FIRST_SHARES = 0.8, 4.0
"""Time for the prices of a step, in even shares of the time left; assignments take the rest. The first step, which has
no prices to begin with, may take more. A step that is cut short is played with the prices it has."""
_FIRST_PART = 0.4
"""Most of the time left that the first step's prices may take, however few steps there are."""
_RENEWAL = 10
"""Iterations between two looks at what no good path uses, and at the time."""
_PLANNED = 0.95
"""Share of the time left that iterations are planned for."""


def values_first_tasks(oracle: PathOracle) -> bool:
    """Whether `assign_first` can work with an oracle."""
    return isinstance(oracle, (FirstGainsOracle, FirstRowsOracle, FirstValueOracle))


def _seconds(outlook: Outlook, is_first: bool) -> float:
    """What the prices of a step may take."""
    if not is_first:
        return _SHARES * outlook.allowance
    return min(_FIRST_SHARES, _FIRST_PART * (outlook.problem.T - outlook.k)) * outlook.allowance


def assign_first(outlook: Outlook, oracle: PathOracle, prices: FloatArray) -> IntArray:
    """The assignment (n,) of a window's first step, its later steps being settled by prices (T, m)."""
    if isinstance(oracle, FirstGainsOracle):
        return outlook.assign(oracle.first_gains(prices))
    if isinstance(oracle, FirstRowsOracle):
        return oracle.first_rows(prices).assign(check=outlook.check)
    assert isinstance(oracle, FirstValueOracle)
    return outlook.assign(oracle.first_values(prices))


@dataclass(frozen=True)
class DualLookahead:
    """Decide step by step, by the Lagrangian dual of the next `window` steps.

    Parameters
    ----------
    window : int
        Steps looked at, the current one among them. 1 is alpha(beta_hat).
    iterations : int
        Price iterations at every step; the first step gets four times as many, as it has no prices to start from.
    end_value : ChargeValue, optional
        What a battery's charge is worth after the window, in place of `sapopt.dynamics.battery.paths.leftover`; for a
        `Battery` only. Any callable ``end_value(problem, left)`` that returns one number for each level, when `left`
        steps follow the window.

    Notes
    -----
    Needs an agent-local dynamics: one with a `path_oracle` that values first tasks (every `SwitchingCost`).
    Where there are limits, what is left of each is priced along with the tasks, and the multipliers are carried from
    step to step. Nothing is random. Under a time limit a step takes its share of the time and plays the prices that it
    has by then.
    """

    window: int
    iterations: int = 60
    end_value: Callable[[SAP, int], FloatArray] | None = None
    takes: ClassVar[frozenset[str]] = EXTRAS

    def __post_init__(self) -> None:
        check_lookahead(self.window, "window")
        check_lookahead(self.iterations, "iterations")

    @property
    def name(self) -> str:
        """Name with options, for tables."""
        valued = "" if self.end_value is None else ", end_value"
        return f"DualLookahead(window={self.window}{valued})"

    def begin(self, problem: SAP, rng: np.random.Generator) -> FloatArray | Prices | None:
        """No prices yet."""
        if not (problem.model.is_agent_local or (problem.is_plain and problem.model.has_places)):
            raise ValueError(
                f"DualLookahead needs an agent-local dynamics; {problem.model.called} has "
                "neither path_oracle nor local_model"
            )
        if self.end_value is not None and problem.model.batteries() is None:
            raise ValueError(f"end_value is for batteries; {problem.model.called} has no charge to value")
        if self.end_value is not None and not problem.is_plain:
            raise ValueError(
                "end_value is for problems without capacities, idleness and limits; leave it out"
            )
        return None

    def act(
        self, outlook: Outlook, memory: FloatArray | Prices | None
    ) -> tuple[IntArray, FloatArray | Prices | None]:
        """Prices of the window, then one assignment problem."""
        if outlook.rules is not None:
            before = memory if isinstance(memory, Prices) else None
            seconds = min(_seconds(outlook, before is None), outlook.deadline - clock.now())
            until = clock.now() + seconds
            answer = priced_step(outlook, self.window, self.iterations, before, seconds)
            if clock.now() >= until:
                outlook.shortened()
            return answer
        assert not isinstance(memory, Prices)
        benefits = outlook.benefits(self.window)
        left = outlook.problem.T - outlook.k - benefits.shape[0] + outlook.goes_on
        batteries = outlook.model.batteries()
        oracle: PathOracle
        if self.end_value is None or batteries is None:
            oracle = path_oracle(outlook.model, benefits, outlook.state, goes_on=left > 0)
        else:
            end = self.end_value(outlook.problem, left)
            oracle = batteries.path_oracle(benefits, outlook.state, end)
        if not values_first_tasks(oracle):
            raise ValueError(
                f"DualLookahead: the path oracle of {type(outlook.problem.dynamics).__name__} has no first_values"
            )
        T, _, m = oracle.shape
        if T == 1:
            return assign_first(outlook, oracle, np.zeros((1, m))), None
        prices = np.zeros((T, m))
        if memory is not None:
            known = min(T, len(memory) - 1)
            # What a session has carried over lacks the places of copies: they cost nothing at first.
            prices[:known, : memory.shape[1]] = memory[1 : known + 1]
        until = min(clock.now() + _seconds(outlook, memory is None), outlook.deadline)
        prices = self._priced(oracle, prices, memory is None, outlook, until)
        return assign_first(outlook, oracle, prices), prices

    def carried(self, memory: FloatArray | Prices | None, change: Change) -> FloatArray | Prices | None:
        """The prices of the tasks that are still there; new tasks cost nothing at first."""
        if memory is None:
            return None
        tasks = memory.tasks if isinstance(memory, Prices) else memory
        known = change.tasks >= 0
        prices = (
            np.zeros((len(tasks) + 1 - change.steps, len(change.tasks)))
            if change.steps <= len(tasks)
            else None
        )
        if prices is None:  # all that was priced is over
            return None
        first = max(change.steps - 1, 0)
        prices[len(prices) - (len(tasks) - first) :, known] = tasks[first:, change.tasks[known]]
        if not isinstance(memory, Prices):
            return prices
        limits = np.where(change.limits >= 0, np.append(memory.limits, 0.0)[change.limits], 0.0)
        return Prices(prices, limits, np.zeros(0))

    def stored(self, memory: FloatArray | Prices | None) -> dict[str, np.ndarray]:
        """The prices of tasks and limits; those of teams begin anew at every step."""
        if memory is None:
            return {}
        return (
            {"tasks": memory.tasks, "limits": memory.limits}
            if isinstance(memory, Prices)
            else {"tasks": memory}
        )

    def restored(self, arrays: dict[str, np.ndarray]) -> FloatArray | Prices | None:
        """The prices of `stored`."""
        if "limits" in arrays:
            return Prices(arrays["tasks"], arrays["limits"], np.zeros(0))
        return arrays.get("tasks")

    def _priced(
        self,
        oracle: PathOracle,
        prices: FloatArray,
        first: bool,
        outlook: Outlook,
        until: float,
    ) -> FloatArray:
        """Prices after all iterations, or after as many as there is time for until the clock shows `until`."""
        iterations = 4 * self.iterations if first else self.iterations
        if isinstance(oracle, SoftPathOracle):
            descent = SmoothDescent(iterations, hot=0.5 if first else 0.1, cold=0.02, rate=0.2)
            state = descent.begin(prices)
            cheaper = None
            iteration, began = 0, clock.now()
            while iteration < descent.iterations:
                outlook.check()
                now = clock.now()
                if now >= until:
                    break
                if iteration % _RENEWAL == 0:
                    if (
                        iteration and now > began and np.isfinite(until)
                    ):  # cool down in the steps that there is time for
                        affordable = int(_PLANNED * (until - now) / (now - began) * iteration)
                        descent = descent.replanned(iteration, min(iterations - iteration, affordable))
                        if iteration >= descent.iterations:
                            break
                    cheaper, state = descent.cheaper(oracle, state)
                state = descent.step(oracle, state, cheaper)
                iteration += 1
            if iteration < iterations:
                outlook.shortened()
            return lowered(state.prices)
        method = Subgradient(length=0.5)
        walk = method.begin(prices, 1.0)
        for _ in range(iterations):
            outlook.check()
            if clock.now() >= until:
                outlook.shortened()
                break
            walk, _ = method.step(oracle, walk)
        return walk.best
