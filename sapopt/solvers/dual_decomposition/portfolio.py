"""What a round of the search does next: the work of its builder, or exchanges. The time goes to what pays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

from sapopt.problem.sap import SAP
from sapopt.solvers.dual_decomposition.exchanges import Exchanges

_PAYING = 0.5
"""Share of the gap that the builder's rounds must be on the way to close in the time left, for nothing else to be
tried."""

_PAYING_TURN = 0.1
"""The same for a single round, where there is no time limit."""

_FELT = 1e-3
"""Share of the gap that a way must be on the way to close in the time left, to count at all."""

_FORGETTING = 0.25
"""What is left of a way's promise when it has found nothing."""

_MOST_FAILURES = 9
"""Exchanges without a better plan, each twice as long as the last, after which no more are tried."""

_LEAST_CELLS = 300
"""Agents times steps below which networks and sweeps say all there is to say."""


@dataclass(eq=False)
class Portfolio:
    """The two ways to a better plan, and what they have gained.

    Attributes
    ----------
    problem : SAP
    threads : int
        Of the exchanges.
    always : bool
        Exchanges are made on a problem of any size.
    """

    problem: SAP
    threads: int
    always: bool = False
    _rates: dict[bool, float] = field(default_factory=lambda: {False: math.inf, True: math.inf})
    """Gain for every second of the last rounds, without and with exchanges."""
    _last_gain: float = math.inf
    _exchanged: bool = False

    @cached_property
    def exchanges(self) -> Exchanges | None:
        """The exchanges of the run; None where the rule does not allow for them or the problem is too small."""
        if self.problem.T * self.problem.n < _LEAST_CELLS and not self.always:
            return None
        return Exchanges.of(self.problem, self.threads)

    @property
    def is_tired(self) -> bool:
        """Whether exchanges have nothing to say any more."""
        return self.exchanges is None or self.exchanges.quiet >= _MOST_FAILURES

    def turn(self, distance: float, seconds_left: float) -> Exchanges | None:
        """The exchanges, if it is their turn; compiled and made only where the builder's rounds do not pay.

        Parameters
        ----------
        distance : float
            Between bound and plan.
        seconds_left : float
            Infinite without a time limit. Then nothing may depend on the clock: the two take turns from the first poor
            round on.
        """
        if math.isinf(seconds_left):
            poor = self._last_gain < _PAYING_TURN * distance
            return self.exchanges if poor and not self._exchanged else None
        if self._rates[False] * seconds_left > _PAYING * distance or self.is_tired:
            return None
        # What would not be felt in the time left counts as nothing, and then the two take turns.
        least = _FELT * distance / max(seconds_left, 1e-3)
        with_them, without = (self._rates[key] if self._rates[key] > least else 0.0 for key in (True, False))
        by_turns = with_them == without and not self._exchanged
        return self.exchanges if with_them > without or by_turns else None

    def learn(self, exchanged: bool, gain: float, seconds: float) -> None:
        """Remember what a round gained, by itself and for every second."""
        self._exchanged, self._last_gain = exchanged, gain
        before = self._rates[exchanged]
        floor = 0.0 if math.isinf(before) else _FORGETTING * before
        self._rates[exchanged] = max(gain / max(seconds, 1e-3), floor)
