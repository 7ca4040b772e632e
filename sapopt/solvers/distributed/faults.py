"""What can go wrong in a network: lost and late packets, dead agents, partitions that heal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sapopt.solvers.distributed.network import Network


@dataclass(frozen=True)
class Cut:
    """A group of agents that hears nobody outside it over the steps ``first .. last`` (inclusive, 0-based).

    Attributes
    ----------
    agents : tuple of int
    first, last : int
        After `last` the partition is healed.
    """

    agents: tuple[int, ...]
    first: int
    last: int


@dataclass(frozen=True)
class Faults:
    """Faults of a network. Everything random follows the seed of the run.

    Parameters
    ----------
    loss : float
        Probability, below 1, that a packet is lost.
    delay : int
        A packet arrives up to this many rounds late, every number of rounds equally likely.
    dead : mapping of int to int
        Agents that are dead, each with the step from which it neither hears, sends nor moves.
    cuts : tuple of Cut
        Partitions.

    Raises
    ------
    ValueError
        If a value is out of range.
    """

    loss: float = 0.0
    delay: int = 0
    dead: Mapping[int, int] = field(default_factory=dict)
    cuts: tuple[Cut, ...] = ()

    def __post_init__(self) -> None:
        if not 0.0 <= self.loss < 1.0:
            raise ValueError(
                f"loss must be a probability below 1, got {self.loss!r}; use a Cut for links that are down"
            )
        if isinstance(self.delay, bool) or int(self.delay) != self.delay or self.delay < 0:
            raise ValueError(f"delay must be a whole number of rounds, at least 0, got {self.delay!r}")
        object.__setattr__(self, "cuts", tuple(self.cuts))

    @property
    def splits(self) -> bool:
        """Whether agents may be cut off."""
        return bool(self.dead or self.cuts)

    @property
    def disturbs(self) -> bool:
        """Whether packets may be lost or late."""
        return self.loss > 0 or self.delay > 0

    def check(self, n: int) -> None:
        """Raise a ValueError if an agent does not exist."""
        named: set[Any] = set(self.dead) | {agent for cut in self.cuts for agent in cut.agents}
        wrong = sorted(agent for agent in named if not 0 <= agent < n)
        if wrong:
            raise ValueError(f"faults: there is no agent {wrong[0]}; agents are 0..{n - 1}")

    def dead_at(self, step: int, n: int) -> np.ndarray:
        """Which agents are dead at a step, shape ``(n,)``."""
        out = np.zeros(n, dtype=bool)
        out[[agent for agent, since in self.dead.items() if since <= step]] = True
        return out

    def at(self, step: int, network: Network) -> Network:
        """What is left of a step's network."""
        if not self.splits:
            return network
        groups = []
        for cut in self.cuts:
            if cut.first <= step <= cut.last:
                members = np.zeros(network.n, dtype=bool)
                members[list(cut.agents)] = True
                groups.append(members)
        return network.without(self.dead_at(step, network.n), groups)
