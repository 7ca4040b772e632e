"""What a round of the search does next: the work of its builder, dives or exchanges. The time goes to what pays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

from sapopt.problem.sap import SAP
from sapopt.solvers.dual_decomposition.dives import Dives
from sapopt.solvers.dual_decomposition.exchanges import Exchanges

_PAYING = 0.5
"""Share of the gap that the builder's rounds must be on the way to close in the time left, for nothing else to be
tried."""

_PAYING_TURN = 0.1
"""The same for a single round, where there is no time limit."""

_FELT = 1e-3
"""Share of the gap that a way must be on the way to close in the time left, to count at all."""

_LATEST, _LATEST_SPARSE = 0.3, 0.5
"""Share of the time that must be left for a way to be tried for the first time, where most pairs are worth something
and elsewhere: it has to be made, and may have to be compiled. Where agents wait for long, it gains little."""

_FORGETTING = 0.25
"""What is left of a way's promise when it has found nothing."""

_MOST_FAILURES = 9
"""Rounds without a better plan after which no more are tried; every exchange is twice as long as the last."""

_LEAST_CELLS = 300
"""Agents times steps below which networks and sweeps say all there is to say."""

Way = Dives | Exchanges | None
"""What a round does; None is the work of the builder."""

_BUILDER = type(None)
"""The builder's key among the ways."""

W = TypeVar("W", bound=Way)


@dataclass(eq=False)
class Portfolio:
    """The ways to a better plan, and what they have gained.

    Attributes
    ----------
    problem : SAP
    threads : int
        Of dives and exchanges.
    time_limit : float or None
        Of the run, in seconds.
    always : bool
        Dives and exchanges are made on a problem of any size.
    """

    problem: SAP
    threads: int
    time_limit: float | None = None
    always: bool = False
    _rates: dict[type, float] = field(default_factory=dict)
    """Gain for every second of the last rounds of a way; infinite at first."""
    _turns: dict[type, int] = field(default_factory=dict)
    _idle: dict[type, float] = field(default_factory=dict)
    """Seconds since a way's last better plan that it has worked."""
    _last_gain: float = math.inf
    _last: type = _BUILDER

    @cached_property
    def others(self) -> list[Dives | Exchanges]:
        """What there is beside the builder; nothing where the rule does not allow for it or on small problems."""
        if self.problem.T * self.problem.n < _LEAST_CELLS and not self.always:
            return []
        made = (Dives.of(self.problem, self.threads), Exchanges.of(self.problem, self.threads))
        return [way for way in made if way is not None]

    @property
    def first_dives(self) -> Dives | None:
        """The dives, if a first plan is to come from them."""
        return next((way for way in self.others if isinstance(way, Dives) and way.is_full), None)

    @property
    def awake(self) -> list[Dives | Exchanges]:
        """Those that may still have something to say."""
        return [way for way in self.others if way.quiet < _MOST_FAILURES]

    @property
    def is_tired(self) -> bool:
        """Whether nothing but the builder has anything to say any more."""
        return not self.awake

    def turn(self, distance: float, seconds_left: float, has_untried: bool = False) -> Way:
        """Whose turn it is; the others are compiled and made only where the builder's rounds do not pay.

        Parameters
        ----------
        distance : float
            Between bound and plan.
        seconds_left : float
            Infinite without a time limit. Then nothing may depend on the clock: all take turns from the first poor
            round on.
        has_untried : bool
            Whether the builder has work of a kind that was not tried yet: where agents wait for long it goes first,
            since the others gain little there.
        """
        if math.isinf(seconds_left):
            if self._last is not _BUILDER or not self._last_gain < _PAYING_TURN * distance or self.is_tired:
                return None
            return min(self.awake, key=lambda way: self._turns.get(type(way), 0))
        if self._rate(_BUILDER) * seconds_left > _PAYING * distance or self.is_tired:
            return None
        if has_untried and self.first_dives is None:
            return None
        latest = _LATEST_SPARSE if self.first_dives is None else _LATEST
        is_late = self.time_limit is not None and seconds_left < latest * self.time_limit
        ways = [way for way in self.awake if type(way) in self._rates or not is_late]
        return self._best([None, *ways], distance, seconds_left)

    def other(self, distance: float, seconds_left: float) -> Dives | Exchanges | None:
        """Whose turn it is where the builder has none; None where nobody has anything to say."""
        if self.is_tired:
            return None
        if math.isinf(seconds_left):
            return min(self.awake, key=lambda way: self._turns.get(type(way), 0))
        return self._best(list(self.awake), distance, seconds_left)

    def learn(self, way: Way, gain: float, seconds: float) -> None:
        """Remember what a round gained, by itself and for every second."""
        kind = type(way)
        before = self._rate(kind)
        floor = 0.0 if math.isinf(before) else _FORGETTING * before
        self._rates[kind] = max(gain / max(seconds, 1e-3), floor)
        self._turns[kind] = self._turns.get(kind, 0) + 1
        self._idle[kind] = 0.0 if gain > 0.0 else self._idle.get(kind, 0.0) + seconds
        self._last, self._last_gain = kind, gain

    def _rate(self, kind: type) -> float:
        return self._rates.get(kind, math.inf)

    def _best(self, ways: list[W], distance: float, seconds_left: float) -> W:
        # What would not be felt in the time left counts as nothing, and then all get as much time.
        least = _FELT * distance / max(seconds_left, 1e-3)

        def promise(way: W) -> tuple[float, float]:
            rate = self._rate(type(way))
            return rate if rate > least else 0.0, -self._idle.get(type(way), 0.0)

        return max(ways, key=promise)
