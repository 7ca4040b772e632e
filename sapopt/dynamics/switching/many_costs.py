"""Priced paths of agents that pay different costs for a move, by the recursions of one cost.

Agents of one cost form a part with an oracle of its own. What waiting costs on a task that an agent never sees does
not depend on the cost of moves, so all parts share one table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.switching.paths import StrictSwitching


@dataclass(frozen=True, eq=False)
class ManyCosts:
    """The paths of all agents (a `sapopt.dynamics.paths.oracles.SoftPathOracle`).

    Attributes
    ----------
    whole : StrictSwitching
        Of all agents. Its cost does not count, but waiting, which is the same for all, is asked of it.
    parts : sequence of (agents, StrictSwitching)
        The agents of every cost, ascending, and their paths.
    """

    whole: StrictSwitching
    parts: Sequence[tuple[IntArray, StrictSwitching]]

    @classmethod
    def of(cls, whole: StrictSwitching, costs: FloatArray) -> ManyCosts:
        """The paths where agent i pays ``costs[i]`` for a move, shape (n,)."""
        levels, level = np.unique(costs, return_inverse=True)
        parts = []
        for number, cost in enumerate(levels):
            agents = np.flatnonzero(level == number)
            parts.append((agents, whole.alone(agents, float(cost))))
        return cls(whole, parts)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window."""
        return self.whole.shape

    @property
    def scale(self) -> float:
        """Typical size of a benefit."""
        return self.whole.scale

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`."""
        return max((part.coldest for _, part in self.parts), default=0.0)

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        p = np.ascontiguousarray(prices, dtype=np.float64)
        waiting = self.whole.waiting(p)
        T, n, _ = self.shape
        values, plan = np.empty(n), np.empty((T, n), dtype=np.int64)
        for agents, part in self.parts:
            values[agents], plan[:, agents] = part.best_beside(p, waiting)
        return values, plan

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""
        for agents, part in self.parts:
            at = int(np.searchsorted(agents, agent))
            if at < len(agents) and agents[at] == agent:
                return part.best_path(at, prices)
        raise IndexError(agent)

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        T, n, m = self.shape
        whole = self.whole.smoothing(prices, temperature)
        waiting = self.whole.soft_waiting(whole)
        values, usage, mass = np.empty(n), np.zeros((T, m)), np.zeros((T, T + 1))
        for agents, part in self.parts:
            own = whole._replace(move=float(np.exp(-part.cost / temperature)))
            values[agents], used, waits = part.soft_beside(own, waiting)
            usage += used
            mass += waits
        self.whole.spread(whole, waiting, mass, usage)
        return values, usage

    @property
    def worth_narrowing(self) -> bool:
        """Whether some of the agents are."""
        return any(part.worth_narrowing for _, part in self.parts)

    def narrowed(self, prices: FloatArray, regret: float) -> ManyCosts:
        """The same problem without the benefits that no path within `regret` of its agent's best one collects."""
        return ManyCosts(self.whole, [(agents, part.narrowed(prices, regret)) for agents, part in self.parts])

    def blocks(self, length: int) -> list[ManyCosts]:
        """The problem cut into blocks of `length` steps; the later ones begin with a free step."""
        wholes = self.whole.blocks(length)
        cut = [(agents, part.blocks(length)) for agents, part in self.parts]
        return [
            ManyCosts(whole, [(agents, parts[number]) for agents, parts in cut])
            for number, whole in enumerate(wholes)
        ]
