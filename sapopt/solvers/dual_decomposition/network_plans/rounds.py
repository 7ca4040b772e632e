"""Which windows a round solves: where there is a clock, those that have gained most for their time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from sapopt.solvers.dual_decomposition.network_plans.window_search import EFFORTS, Effort

_GROUP_ARCS = 10_000
"""Size of the networks of few agents over the whole horizon."""

_PAYING = 0.5
"""Share of the gap that the best rounds must be on the way to close in the time left, or something larger is tried."""

_FRONT = 0.1
"""The same below which rolling windows are tried again, from the best plan."""

_FRONT_TIME = 1.25
"""So many times the seconds that the last ones took must be left for that."""

_MEMORY = 0.5
"""Weight of the past in what an effort gains for every second."""

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
"""Successive multiples of this fall evenly on a circle."""


@dataclass(eq=False)
class Rounds:
    """The rounds of windows of a run, and what they gained.

    Attributes
    ----------
    steps : int
        Steps T of the horizon.
    efforts : tuple of Effort
        Windows to choose from, small ones first.
    whole_tried : float
        Distance between bound and plan at which the whole horizon was solved at once for the last time.
    """

    steps: int
    efforts: tuple[Effort, ...] = EFFORTS
    whole_tried: float = math.inf
    _rates: dict[Effort, float] = field(default_factory=dict)
    """Gain for every second of the efforts that were tried."""
    _turns: dict[Effort, int] = field(default_factory=dict)
    _front_seconds: float = math.inf
    """Seconds of the last rolling windows; infinite where there were none."""

    def planned(self, turn: int) -> tuple[Effort, int]:
        """Effort and shift of round number ``turn`` where there is no clock.

        Windows, windows shifted by half and groups, one effort after the other, the last of which is repeated.
        """
        effort = self.efforts[min(turn // 3, len(self.efforts) - 1)]
        if turn % 3 == 2:
            return self._groups, 0
        return effort, turn % 3 * effort.length // 2

    def paying(self, distance: float, seconds_left: float) -> tuple[Effort, int]:
        """Effort and shift of the next round where there is one.

        Parameters
        ----------
        distance : float
            Between bound and plan.
        seconds_left : float
        """
        best = max(self._rates, key=lambda effort: (self._rates[effort], -self._turns[effort]), default=None)
        untried = [effort for effort in self._ladder if effort not in self._rates]
        if best is None or (untried and self._rates[best] * seconds_left <= _PAYING * distance):
            best = untried[0]
        shift = int(self._turns.get(best, 0) * GOLDEN % 1.0 * best.length)
        return best, 0 if best == self._groups else shift

    @property
    def has_untried(self) -> bool:
        """Whether there are windows of a kind that was not tried yet."""
        return any(effort not in self._rates for effort in self._ladder)

    def learn(self, effort: Effort, gain: float, seconds: float) -> None:
        """Remember what a round gained."""
        rate = gain / max(seconds, 1e-3)
        self._rates[effort] = _MEMORY * self._rates.get(effort, rate) + (1.0 - _MEMORY) * rate
        self._turns[effort] = self._turns.get(effort, 0) + 1

    def wants_front(self, distance: float, seconds_left: float) -> bool:
        """Whether it is time for rolling windows again: where all windows were tried, gain little, and time is left."""
        if math.isinf(seconds_left) or seconds_left < _FRONT_TIME * self._front_seconds:
            return False
        if self.has_untried:
            return False
        return max(self._rates.values()) * seconds_left <= _FRONT * distance

    def learn_front(self, gain: float, seconds: float) -> None:
        """Remember how long rolling windows took; where they gained nothing they are not tried again soon."""
        self._front_seconds = (
            seconds if gain > 0.0 or math.isinf(self._front_seconds) else 2.0 * self._front_seconds
        )

    @property
    def _groups(self) -> Effort:
        return Effort(self.steps, _GROUP_ARCS)

    @property
    def _ladder(self) -> list[Effort]:
        return [*self.efforts, self._groups]  # groups take longest for what they gain
