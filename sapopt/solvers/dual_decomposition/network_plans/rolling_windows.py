"""Rolling windows with priced futures: several steps planned together and exactly, of which the first are kept.

Where moves are dear, the tasks that agents hold without serving them get in the way of others for many steps, and an
assignment of one step (`priced_futures`) cannot see that. Here the network of a window (`restricted_flow`) ends in the
values of the agents' best priced paths to the end of the horizon; this is the relax-and-fix heuristic of lot sizing
(Pochet and Wolsey 2006, section 3.6) with prices in place of the relaxed variables.

Where agents may wait wherever there is room (`waiting_places`), waiting is one arc of the agent and not one for every
task. So networks may hold cells of many times the reduced cost, and see three times as far ahead as they keep. That is
what counts: a window's end does not know that the agents' best paths after it exclude each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels import clock
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.flow_programme import solve_flow
from sapopt.solvers.dual_decomposition.network_plans.rear import Rear
from sapopt.solvers.dual_decomposition.network_plans.restricted_flow import (
    RestrictedFlow,
    restricted_flow,
)
from sapopt.solvers.dual_decomposition.network_plans.waiting_places import (
    PLACES_REGRET,
    Places,
    can_wait,
    waiting_flow,
)
from sapopt.solvers.dual_decomposition.network_plans.window_search import (
    largest,
    parking_tasks,
    typical_benefit,
)

_REGRETS = (2.0, 1.4, 1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12)
"""Ladder of reduced costs, in typical benefits; far larger than in `window_search`, since agents leave their paths."""

_WAITING_REGRETS = tuple(8.0 / 1.2**rung for rung in range(28))
"""The same where agents wait wherever there is room (`waiting_places`): there what they may do is less."""

_LONGEST, _SHORTEST = 12, 4
"""Steps of a window, of which the first half are kept."""

_LONGEST_SPELLS, _KEPT = 20, 0.36
"""Steps of a window with places to wait, and the share of them that is kept: what follows is what matters there."""

_DENSITY, _DENSEST = 7.0, 10.0
"""Arcs of a network with places to wait for every agent and step: fewer, and shorter windows are better; and where time
is ample."""

_REACH = 2.0
"""How much larger the reduced cost of a window may be than that of the last one."""

_SPARSEST = 5.0
"""Arcs for every agent and step below which networks are worth nothing."""

_USUAL, _LONG_WAITING = 6, 10
"""Steps of the first window where time is short, and of all windows with places to wait where it is not."""

_FIRST_ARCS = 25_000
"""Arcs of the first network with places to wait where time is short, if that leaves it steps enough."""

_ARCS, _FEWEST_ARCS = 60_000, 4_000
"""Sizes of a window's network: where time is ample, and where even the shortest windows take too long."""

_FEWER = 0.7
"""Share of the arcs that a network keeps when the last one took too long."""

_SLOWLY = 0.9
"""The same of a network with places to wait."""

_REPRICING_SHARE = 0.4
"""Share of the time that repricing may take; where it takes more, some windows go without."""

_PARKING = 3
"""Random tasks that each agent may use without seeing them."""

_GAP = 1e-4
"""Relative gap at which a window counts as solved; its value includes the future's."""

_PATIENCE = 4.0
"""A window is given up after so many times the seconds it should take."""


@dataclass
class _Pace:
    """How long the windows and how large their networks may be, from how long the last one took."""

    length: int
    arcs: float
    repricing: float = 0.0
    """Seconds of the last repricing."""
    credit: float = 0.0
    """Seconds that repricing was allowed and has not taken."""
    regret: float = math.inf
    """Reduced cost of the last window's network."""

    def ladder(self, regrets: tuple[float, ...]) -> tuple[float, ...]:
        """Those of the falling reduced costs that are worth trying after the last window."""
        return regrets

    @property
    def kept(self) -> int:
        """Steps of a window that are kept."""
        return self.length // 2

    def learn(self, took: float, allowed: float) -> None:
        if took > 1.2 * allowed and self.length > _SHORTEST:
            self.length -= 1
        elif took > 1.5 * allowed:
            self.arcs = max(_FEWEST_ARCS, _FEWER * self.arcs)
        elif took < 0.6 * allowed:
            if self.arcs < _ARCS:
                self.arcs = min(_ARCS, self.arcs / _FEWER)
            else:
                self.length = min(_LONGEST, self.length + 1)

    def shrink(self) -> bool:
        """Half the arcs, after a window that gave nothing in its time; False where there are no fewer."""
        fewer = max(_FEWEST_ARCS, 0.5 * self.arcs)
        shrunk, self.arcs = fewer < self.arcs, fewer
        return shrunk

    def has_credit(self, allowed: float) -> bool:
        """Whether it is time for a repricing, and for this one; asked once a window."""
        self.credit += _REPRICING_SHARE * allowed
        return self.credit >= self.repricing

    def repriced(self, seconds: float) -> None:
        self.credit, self.repricing = max(self.credit - seconds, 0.0), seconds


@dataclass
class _WaitingPace(_Pace):
    """The same for windows with places to wait, whose arcs for every agent and step are what matters.

    Windows get longer where time allows for it, and networks denser where they are as long as it makes sense.
    """

    agents: int = 1
    density: float = _DENSITY
    is_late: bool = False
    """Whether more of a window is kept than should be, since smaller networks would be worth nothing."""

    def __post_init__(self) -> None:
        self.arcs = self.density * self.agents * self.length

    @property
    def kept(self) -> int:
        """Steps of a window that are kept."""
        return self.length - 1 if self.is_late else max(round(_KEPT * self.length), _SHORTEST // 2)

    def ladder(self, regrets: tuple[float, ...]) -> tuple[float, ...]:
        """Those of the falling reduced costs that are worth trying after the last window."""
        return tuple(regret for regret in regrets if regret <= _REACH * self.regret)

    def shrink(self) -> bool:
        """Half the arcs."""
        self.density *= 0.5
        self.__post_init__()
        return self.density > 0.1 * _SPARSEST

    def learn(self, took: float, allowed: float) -> None:
        if took > 1.2 * allowed:
            if self.length > _SHORTEST and self.density <= _DENSITY:
                self.length -= 1
            else:
                self.is_late = self.density <= _SPARSEST
                self.density = max(_SPARSEST, _SLOWLY * self.density)
        elif took < 0.7 * allowed:
            if self.is_late:
                self.is_late = took >= 0.5 * allowed  # what is kept next is a third less
            elif self.density < _DENSITY or self.length == _LONGEST_SPELLS:
                self.density = min(_DENSEST, self.density / _SLOWLY)
            else:
                self.length = min(_LONGEST_SPELLS, self.length + (1 if took > 0.4 * allowed else 2))
        self.__post_init__()


def rolling_windows(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    rng: np.random.Generator,
    *,
    reprice: Callable[[int, IntArray, FloatArray], FloatArray] | None = None,
    seconds: float = math.inf,
    stop: Callable[[], object] = lambda: False,
    threads: int = 1,
) -> IntArray | None:
    """Return the plan of the rolling windows, or None if ``stop()`` came first.

    Parameters
    ----------
    plan : (T, n)
        Any plan: what the agents do where nothing better is found.
    prices : (T, m)
        Prices of the cells.
    reprice : callable, optional
        As in `priced_futures.plan_by_futures`, before every window but the first, or fewer where time is short; never
        where windows have places to wait, which gain more by being longer.
    seconds : float
        Time for everything; the windows get shorter and their networks smaller as it demands, and where it ends before
        the horizon does the agents go on as in ``plan`` (None if it ends at once). The result depends on it, and
        otherwise on ``rng``.
    threads : int
        With a second one, and a clock, windows behind the front are improved meanwhile (`Rear`), unless they have
        places to wait: there little is left to be improved, and the front gets on faster alone.
    """
    end = clock.now() + seconds

    def roll(joined: Callable[[IntArray, int], IntArray]) -> IntArray | None:
        return _rolled(
            arrays, plan, prices, rng, reprice=reprice, seconds=seconds, end=end, stop=stop, joined=joined
        )

    if threads == 1 or math.isinf(seconds) or can_wait(arrays):
        return roll(lambda plan, front: plan)
    with Rear(arrays, prices, np.random.default_rng(rng.integers(2**63)), lambda: end - clock.now()) as rear:
        return roll(rear.joined)


def _rolled(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    rng: np.random.Generator,
    *,
    reprice: Callable[[int, IntArray, FloatArray], FloatArray] | None,
    seconds: float,
    end: float,
    stop: Callable[[], object],
    joined: Callable[[IntArray, int], IntArray],
) -> IntArray | None:
    """The front of `rolling_windows`; ``joined(plan, front)`` hears of kept steps, returns the plan to go on with."""
    steps = arrays.steps
    waits, unhurried = can_wait(arrays), math.isinf(seconds)
    if waits:
        fitting = _FIRST_ARCS / (_DENSITY * arrays.agents)
        length = _LONG_WAITING if unhurried else int(np.clip(fitting, _SHORTEST, _LONG_WAITING))
        pace: _Pace = _WaitingPace(length, 0.0, agents=arrays.agents)
    else:
        pace = _Pace(_LONGEST if unhurried else _USUAL, _ARCS)
    first = 0
    while True:
        began = clock.now()
        left = end - began
        if stop():
            return None
        if left <= 0.0:
            return None if first == 0 else joined(plan, first)
        last, kept = min(first + pace.length, steps), pace.kept
        allowed = left * kept / (steps - first)
        if first > 0 and not waits and reprice is not None and pace.has_credit(allowed):
            prices = prices.copy()
            prices[first:] = reprice(first, plan[first - 1], prices[first:])
            pace.repriced(clock.now() - began)
        flow, places = _fitting_flow(arrays, plan, prices, first, last, rng, pace, waits)
        limit = min(left, _PATIENCE * allowed)
        found = solve_flow(flow, plan, arrays.tasks, gap=_GAP, seconds=limit, stop=stop, places=places)
        if found is None and not unhurried and pace.shrink():
            continue  # what agents do otherwise is far worse than a smaller network
        plan = plan if found is None else found
        if not unhurried:
            pace.learn(clock.now() - began, allowed)
        if last == steps:
            return joined(plan, steps)
        first += kept
        plan = joined(plan, first)


def _fitting_flow(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    first: int,
    last: int,
    rng: np.random.Generator,
    pace: _Pace,
    waits: bool,
) -> tuple[RestrictedFlow, Places | None]:
    """The network of all agents in a window with the largest reduced cost that fits, or else the smallest.

    With the places for those who wait, if they may do so wherever there is room.
    """
    everyone = np.arange(arrays.agents)
    parking = None if waits else parking_tasks(arrays, plan, first, last, _PARKING, rng)
    scale = typical_benefit(arrays, 0, arrays.steps)

    def network(regret: float, limit: int) -> RestrictedFlow:
        pace.regret, end = regret / scale, arrays.steps
        if parking is None:
            return waiting_flow(arrays, plan, prices, everyone, first, last, regret, limit, end)
        return restricted_flow(arrays, plan, prices, everyone, first, last, regret, parking, limit, end)

    flow = largest(network, pace.ladder(_WAITING_REGRETS if waits else _REGRETS), scale, int(pace.arcs))
    if not waits:
        return flow, None
    return flow, Places.of(arrays, flow, plan, prices, everyone, first, last, PLACES_REGRET * scale)
