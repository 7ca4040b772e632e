"""A plan of a window that is made step by step, with its state and value."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.matrices import GainMatrix
from sapopt.data.types import IntArray
from sapopt.data.windows import WindowSums
from sapopt.live.window import Window, with_names
from sapopt.running.outlook import Outlook
from sapopt.running.steps import Ledger

FREE = -2
"""Stands in a row of pins for an agent that may choose."""
ENDLESS = 10**6
"""Steps that are said to follow a window."""


def _never() -> None:
    """Nobody asks to stop."""


class Course:
    """Assignments of the first steps of a window, the state after them, and what they are worth.

    Parameters
    ----------
    window : Window
    change_cost : float
        Of every announced pair that is not kept.
    ends : bool
        Whether nothing follows the window.
    """

    def __init__(self, window: Window, change_cost: float, ends: bool) -> None:
        self.window = window
        self.change_cost = change_cost
        self.goes_on = 0 if ends else ENDLESS
        self.plan: list[IntArray] = []
        self.gains: list[float] = []
        self.state: Any = window.state
        self.sums = WindowSums(window.core.benefits)
        self._parking = np.arange(window.core.m)
        self._ledger = None if window.core.is_plain else Ledger(window.core)

    def copy(self) -> Course:
        """A course that goes on from here by itself."""
        out = copy.copy(self)
        out.plan, out.gains = list(self.plan), list(self.gains)
        out.sums = WindowSums(self.window.core.benefits)  # what it remembers is not for two threads
        if self._ledger is not None:
            out._ledger = copy.copy(self._ledger)
            out._ledger.used = self._ledger.used.copy()
        return out

    @property
    def length(self) -> int:
        """Steps so far."""
        return len(self.plan)

    @property
    def is_whole(self) -> bool:
        """Whether all steps of the window have their assignment."""
        return self.length == self.window.steps

    def outlook(
        self,
        check: Callable[[], None] = _never,
        deadline: float = np.inf,
        shortened: Callable[[], None] = _never,
    ) -> Outlook:
        """What a policy may know of the next step."""
        k, core = self.length, self.window.core
        rules = None if self._ledger is None else self._ledger.rules(k)
        return Outlook(
            k, core.T, self.state, core, self.sums, self._parking, check,
            rules=rules, deadline=deadline, shortened=shortened, goes_on=self.goes_on,
        )  # fmt: skip

    def play(self, places: IntArray) -> None:
        """Go on by an assignment of the core's places."""
        k, window = self.length, self.window
        held = window.truth.benefits.slice(k, k + 1).at(places[None])[0]
        gain = float(held.sum() + window.truth.model.handover_at(k, self.state, places).sum())
        if self.change_cost:
            agents, tasks = window.kept.at(k)
            gain -= self.change_cost * int((places[agents] != tasks).sum())
        self.gains.append(gain)
        self.plan.append(places)
        if self._ledger is not None:
            self._ledger.enter(k, places)
        self.state = window.core.model.transition(k, self.state, places)

    def best(self, pins: IntArray | None = None) -> IntArray:
        """The best assignment of the next step alone (HAA), with some agents' places given."""
        outlook = self.outlook()
        matrix = outlook.beta_hat()
        if pins is not None:
            matrix = pinned(matrix.toarray() if isinstance(matrix, GainMatrix) else matrix, pins, self._room)
        try:
            return outlook.assign(matrix)
        except InfeasibleError as error:
            raise InfeasibleError(with_names(str(error), self.window.agents, self.window.tasks)) from None

    def go_on(self, has_time: Callable[[float], bool]) -> None:
        """Fill the rest of the window: by the best assignment of each step, or when time is short by staying.

        `has_time` says whether there is time for something that takes so many seconds.
        """
        longest = 0.0
        while not self.is_whole:
            if self.plan and not has_time(2.0 * longest) and self._may_stay():
                self.play(self.plan[-1])
            else:
                began = time.perf_counter()
                self.play(self.best())
                longest = max(longest, time.perf_counter() - began)

    @property
    def value(self) -> float:
        """Of the steps so far; of a whole course with what limits and teams make of it."""
        rows, core = self.window.core.rows, self.window.core
        total = float(sum(self.gains))
        if core.is_plain or not self.is_whole:
            return total
        plan = np.stack(self.plan)
        use = rows.use(plan, core.initial_assignment)
        return total + float(rows.earned(plan).sum()) - float(rows.cost(use).sum())

    @property
    def _room(self) -> IntArray:
        capacity = self.window.core.capacity
        return np.ones(self.window.core.m, dtype=np.int64) if capacity is None else capacity[self.length]

    def _may_stay(self) -> bool:
        """Whether everybody may hold at the next step what he holds now."""
        k, places = self.length, self.plan[-1]
        if self._ledger is not None and not self._ledger.rules(k).allows(places):
            return False
        core = self.window.core
        held = core.benefits.slice(k, k + 1).at(places[None])[0]
        return bool(np.isfinite(held + core.model.handover_at(k, self.state, places)).all())


def pinned(matrix: np.ndarray, pins: IntArray, room: IntArray) -> np.ndarray:
    """A matrix (n, m) under which the agents of `pins` (n,) take their places, and nobody else a full one."""
    out = np.array(matrix, dtype=np.float64)
    fixed = np.flatnonzero(pins != FREE)
    own = out[fixed, pins[fixed]]
    taken = np.bincount(pins[fixed], minlength=out.shape[1])
    out[:, taken >= np.minimum(room, len(out))] = -np.inf
    out[fixed] = -np.inf
    out[fixed, pins[fixed]] = own
    return out
