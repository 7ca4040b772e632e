"""Synchronous message passing: rounds, messages and bytes, with packets that are lost or late.

In a round every agent may send one packet to all its neighbours, and hears theirs. Protocols are written for all agents
at once: they say how many bytes every agent sends in every round, and what the agents then know.

Lost and late packets are dealt with below the protocols by a synchroniser (Awerbuch, 1985): an agent goes on to round
r + 1 only when it has heard round r of all its neighbours, and a packet is repeated until its receipt is acknowledged.
So faults of that kind cost time, messages and bytes and never change what is agreed; the rounds of the protocol and the
rounds that pass on the clock are counted apart. An agent that is cut off from the others is a matter of the graph.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sapopt.data.types import IntArray
from sapopt.solvers.distributed.faults import Faults
from sapopt.solvers.distributed.network import Network

HEADER_BYTES = 16
"""Sender, step and round, and the round of the latest change it has heard of."""
ENTRY_BYTES = 16
"""Auction and task, bidder, price."""


@dataclass(frozen=True)
class Traffic:
    """What one step cost.

    Attributes
    ----------
    rounds : int
        Rounds that passed on the clock.
    protocol_rounds : int
        Rounds of the protocol; less than `rounds` where packets were lost or late.
    messages : int
        Packets sent over a link, acknowledgements and repetitions included.
    bytes : int
    components : int
        Parts that the agents were split into.
    held : int
        Agents that kept their task because their part could not agree within the round limit.
    """

    rounds: int = 0
    protocol_rounds: int = 0
    messages: int = 0
    bytes: int = 0
    components: int = 1
    held: int = 0


RoundStep = Callable[[int], tuple[IntArray, np.ndarray]]
"""``step(r)`` plays round r (from 1) for all agents; returns the bytes that every agent sent in it and which agents
changed what they know."""


class Simulator:
    """One step's communication.

    Parameters
    ----------
    network : Network
    faults : Faults, optional
    rng : Generator, optional
        Decides which packets are lost or late; needed if `faults` disturbs packets.
    check : callable
        Called before every round; raises an exception when there is no time for it.
    """

    def __init__(
        self,
        network: Network,
        faults: Faults | None = None,
        rng: np.random.Generator | None = None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self.check = check
        self.network = network
        self.faults = faults or Faults()
        self.rng = rng
        self._profile: list[IntArray] = []
        if self.faults.disturbs and rng is None:
            raise ValueError("rng is needed where packets are lost or late")

    @property
    def rounds(self) -> int:
        """Rounds of the protocol so far."""
        return sum(len(part) for part in self._profile)

    def deliver(self, sizes: IntArray) -> None:
        """Account for packets: bytes per round and agent, shape ``(rounds, n)``; 0 for silence."""
        self._profile.append(np.asarray(sizes, dtype=np.int64).reshape(-1, self.network.n))

    def flood(self, sizes: IntArray) -> None:
        """Every agent tells all agents of its component something of `sizes[i]` bytes; takes a diameter of rounds.

        Each passes on what it has newly heard, so in round r an agent sends what started r - 1 hops away.
        """
        distances = self.network.distances
        rounds = int(self.network.diameters.max())
        if rounds == 0:
            return
        n = self.network.n
        reached = distances >= 0
        row, origin = np.nonzero(reached)
        weight = np.asarray(sizes, dtype=np.float64)[origin]
        key = distances[reached].astype(np.int64) * n + row
        profile = np.bincount(key, weights=weight, minlength=(rounds + 1) * n)[: (rounds + 1) * n].reshape(
            -1, n
        )
        # What is learnt in the last round need not be passed on.
        profile = profile[:rounds].astype(np.int64)
        self.deliver(profile + HEADER_BYTES * (profile > 0))

    def run(self, step: RoundStep, max_rounds: int) -> np.ndarray:
        """Play rounds until nothing has changed for two diameters, or the round limit is reached.

        Every packet carries the round of the latest change that its sender has heard of. After a diameter of rounds
        without a change everyone has heard everything; after two everyone knows that, in the same round. (One diameter,
        the published rule, is too early: an agent may wait that long for the answer to its own last bid.)

        Returns
        -------
        ndarray of bool, shape (n,)
            Whether the agent's component came to rest.
        """
        network = self.network
        component, wait = network.components, 2 * network.diameters
        last = np.zeros(len(wait), dtype=np.int64)
        sizes: list[IntArray] = []
        r = 0
        while r < max_rounds and (r < last + wait).any():
            r += 1
            self.check()
            sent, changed = step(r)
            sizes.append(np.where(r <= (last + wait)[component], sent, 0))
            np.maximum.at(last, component[changed], r)
        if sizes:
            self.deliver(np.array(sizes))
        rested: np.ndarray = (last + wait <= max_rounds)[component]
        return rested

    def traffic(self, held: int = 0) -> Traffic:
        """The cost of everything delivered so far."""
        n = self.network.n
        profile = np.concatenate([*self._profile, np.zeros((0, n), dtype=np.int64)])
        parts = int(self.network.components.max()) + 1
        if self.faults.disturbs and len(profile) and len(self.network.links):
            assert self.rng is not None
            rounds, messages, size = synchronise(self.network, profile, self.faults, self.rng)
        else:
            degrees = self.network.degrees
            rounds = len(profile)
            messages = int(((profile > 0) * degrees).sum())
            size = int((profile * degrees).sum())
        return Traffic(rounds, len(profile), messages, size, parts, held)


def synchronise(
    network: Network, profile: IntArray, faults: Faults, rng: np.random.Generator
) -> tuple[int, int, int]:
    """Play a protocol's packets over links that lose and delay them.

    An agent repeats on each link, round by round, all packets that are not acknowledged yet, and acknowledges what it
    hears. A silent round of the protocol is an empty packet here, since silence could be loss.

    Returns
    -------
    rounds, messages, bytes : int
        Rounds until every agent has heard the last packets of its neighbours, and what was sent until then.
    """
    last = len(profile)
    source, target, back = network.sources, network.links.astype(np.int64), network.reverse
    count = len(source)
    # Bytes of the packets 1..r of an agent; a packet at least fills a header.
    total = np.concatenate(
        [[np.zeros(network.n, np.int64)], np.cumsum(np.maximum(profile, HEADER_BYTES), axis=0)]
    )
    clock = np.zeros(network.n, dtype=np.int64)  # rounds whose packets are all heard
    heard = np.zeros(count, dtype=np.int64)  # by the receiver of a link
    acknowledged = np.zeros(count, dtype=np.int64)  # as its sender knows
    slots = faults.delay + 1
    packet = np.zeros((slots, count), dtype=np.int64)
    receipt = np.zeros((slots, count), dtype=np.int64)
    must_answer = np.zeros(count, dtype=bool)
    linked = network.degrees > 0
    everywhere = np.arange(count)
    rounds = messages = size = 0
    while (clock[linked] < last).any():
        newest = np.minimum(clock + 1, last)[source]
        open_packets = acknowledged < newest
        sends = open_packets | must_answer
        messages += int(sends.sum())
        fresh = np.where(open_packets, total[newest, source] - total[acknowledged, source], 0)
        size += int((fresh + HEADER_BYTES * (sends & ~open_packets)).sum())
        arrives = sends & (rng.random(count) >= faults.loss)
        slot = (rounds + rng.integers(slots, size=count)) % slots
        cells = slot[arrives], everywhere[arrives]
        packet[cells] = np.maximum(packet[cells], np.where(open_packets, newest, 0)[arrives])
        receipt[cells] = np.maximum(receipt[cells], heard[back][arrives] + 1)
        now = rounds % slots
        got = receipt[now] > 0
        np.maximum(heard, packet[now], out=heard)
        news = np.where(got, receipt[now] - 1, 0)
        acknowledged = np.maximum(acknowledged, news[back])
        must_answer = (packet[now] > 0)[back]  # a mere receipt needs no receipt
        packet[now] = receipt[now] = 0
        rounds += 1
        least = np.full(network.n, last, dtype=np.int64)
        np.minimum.at(least, target, heard)
        clock = np.minimum(least, clock + 1)
    return rounds, messages, size
