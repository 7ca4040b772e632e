"""Plain per-agent versions of HAAL-D and CBBA: one object per agent, whole tables in every packet, Python loops.

The baseline of the speed comparison and an independent check: the library's kernels must give the same rounds and the
same tables.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations, pairwise

import networkx as nx
import numpy as np

GOLDEN = 0.6180339887498949


def diameter(graph: nx.Graph) -> int:
    """Diameter of a connected graph."""
    return nx.diameter(graph) if graph.number_of_nodes() > 1 else 0


# --- the distributed auction ------------------------------------------------------------------------------------------


@dataclass
class Bidder:
    """One agent of one auction: what it values and what it knows."""

    number: int
    options: list[int]  # tasks in the order in which ties are broken
    values: np.ndarray  # (m,)
    epsilon: float
    price: np.ndarray = field(init=False)
    owner: np.ndarray = field(init=False)
    task: int = -1
    stamp: int = -1

    def __post_init__(self) -> None:
        self.price = np.zeros(len(self.values))
        self.owner = np.full(len(self.values), -1)

    def hear(self, packets: list[tuple[np.ndarray, np.ndarray, int]]) -> None:
        """Merge whole tables."""
        for price, owner, stamp in packets:
            better = (price > self.price) | ((price == self.price) & (owner > self.owner))
            self.price = np.where(better, price, self.price)
            self.owner = np.where(better, owner, self.owner)
            self.stamp = max(self.stamp, stamp)

    def bid(self, now: int) -> None:
        """Bid if outbid."""
        if self.task >= 0 and self.owner[self.task] == self.number:
            return
        net = self.values - self.price
        best = max(self.options, key=lambda j: net[j])  # the first of equals
        others = [net[j] for j in self.options if j != best]
        raised = net[best] - max(others) if others else np.ptp(np.append(self.values, 0.0)) + 1.0
        self.task = best
        self.price[best] = self.price[best] + raised + self.epsilon
        self.owner[best] = self.number
        self.stamp = now


def plain_auction(
    gains: np.ndarray, graph: nx.Graph, epsilon: float, held: np.ndarray | None = None
) -> tuple[np.ndarray, list[Bidder], int]:
    """Tasks, agents and rounds of one auction; `gains` (n, m), unwanted tasks have gain exactly zero."""
    n, m = gains.shape
    agents = []
    for i in range(n):
        first = [int(held[i])] if held is not None else []
        listed = sorted(
            (j for j in range(m) if gains[i, j] != 0 and j not in first), key=lambda j: (-gains[i, j], j)
        )
        start = int((i + 1) * GOLDEN % 1.0 * m) % m
        rest = [j for j in [*range(start, m), *range(start)] if j not in first and gains[i, j] == 0]
        agents.append(Bidder(i, [*first, *listed, *rest], gains[i], epsilon))
    for agent in agents:
        agent.bid(0)
    wait, now = 2 * diameter(graph), 0
    while now < max(agent.stamp for agent in agents) + wait:
        now += 1
        packets = [(agent.price.copy(), agent.owner.copy(), agent.stamp) for agent in agents]
        for agent in agents:
            agent.hear([packets[k] for k in sorted(graph[agent.number]) if k != agent.number])
            agent.bid(now)
    return np.array([agent.task for agent in agents]), agents, now


def plain_haald(
    benefits: np.ndarray, cost: float, held: np.ndarray | None, graph: nx.Graph, epsilon: float
) -> tuple[np.ndarray, int]:
    """First assignment and auction rounds of HAAL-D on a window of benefits (L, n, m)."""
    steps, n, m = benefits.shape
    everyone = np.arange(n)
    solved, rounds = {}, 0
    for a in range(steps):
        for b in range(a + 1, steps + 1):
            gains = benefits[a:b].sum(axis=0)
            if held is not None:
                gains = gains.copy()
                gains[everyone, held] += cost  # staying, over what every other task costs
            solved[a, b], _, took = plain_auction(gains, graph, epsilon, held)
            rounds = max(rounds, took)
    best, first = -np.inf, None
    for count in range(steps):
        for cuts in combinations(range(1, steps), count):
            edges = [0, *cuts, steps]
            value, at = 0.0, held
            for a, b in pairwise(edges):
                tasks = solved[a, b]
                value += benefits[a:b, everyone, tasks].sum()
                value -= 0.0 if at is None else cost * (tasks != at).sum()
                at = tasks
            if value > best + 1e-9:
                best, first = value, solved[0, edges[1]]
    return first, rounds


# --- CBBA -------------------------------------------------------------------------------------------------------------


def table(i: int, k: int, yi: float, zi: int, yk: float, zk: int, si: np.ndarray, sk: np.ndarray) -> str:
    """Table I of Choi, Brunet and How (2009), row by row: sender k, receiver i; -1 is nobody."""

    def higher() -> bool:
        return yk > yi or (yk == yi and zk < zi)

    def newer(agent: int) -> bool:
        return bool(sk[agent] > si[agent])

    sender = {k: "k", i: "i", -1: "none"}.get(zk, "m")
    receiver = {i: "i", k: "k", -1: "none"}.get(zi, "m" if zi == zk or sender != "m" else "n")
    m, n = (zk if sender == "m" else zi), zi
    rules = {
        ("k", "i"): lambda: "update" if higher() else "leave",
        ("k", "k"): lambda: "update",
        ("k", "m"): lambda: "update" if newer(m) or higher() else "leave",
        ("k", "none"): lambda: "update",
        ("i", "i"): lambda: "leave",
        ("i", "k"): lambda: "reset",
        ("i", "m"): lambda: "reset" if newer(m) else "leave",
        ("i", "none"): lambda: "leave",
        ("m", "i"): lambda: "update" if newer(m) and higher() else "leave",
        ("m", "k"): lambda: "update" if newer(m) else "reset",
        ("m", "m"): lambda: "update" if newer(m) else "leave",
        ("m", "n"): lambda: (
            "update" if newer(m) and newer(n) else
            "update" if newer(m) and higher() else
            "reset" if newer(n) and si[m] > sk[m] else "leave"
        ),
        ("m", "none"): lambda: "update" if newer(m) else "leave",
        ("none", "i"): lambda: "leave",
        ("none", "k"): lambda: "update",
        ("none", "m"): lambda: "update" if newer(m) else "leave",
        ("none", "none"): lambda: "leave",
    }  # fmt: skip
    return rules[sender, receiver]()


@dataclass
class Bundler:
    """One agent of CBBA: bundle, path, and what it knows of all slots (step, task)."""

    number: int
    n: int
    benefits: np.ndarray  # (L, m) of its own
    held: int
    cost: float
    y: np.ndarray = field(init=False)
    z: np.ndarray = field(init=False)
    s: np.ndarray = field(init=False)
    bundle: list[tuple[int, int, float]] = field(default_factory=list)  # step, task, announced bid

    def __post_init__(self) -> None:
        self.y = np.zeros(self.benefits.shape)
        self.z = np.full(self.benefits.shape, -1)
        self.s = np.zeros(self.n, dtype=int)

    def moves(self, path: dict[int, int]) -> float:
        """Handover cost of a path."""
        tasks = [self.held, *(path[t] for t in sorted(path))]
        return self.cost * sum(a >= 0 and a != b for a, b in pairwise(tasks))

    def build(self) -> bool:
        """Release what was lost, add what is won; whether anything changed."""
        changed = False
        for q, (t, j, _) in enumerate(self.bundle):
            if self.z[t, j] != self.number:
                for later, task, _ in self.bundle[q + 1 :]:
                    if self.z[later, task] == self.number:
                        self.z[later, task], self.y[later, task] = -1, 0.0
                self.bundle = self.bundle[:q]
                changed = True
                break
        while True:
            path = {t: j for t, j, _ in self.bundle}
            best = (0.0, -1, -1, 0.0)
            for t in range(len(self.benefits)):
                if t in path:
                    continue
                for j in np.flatnonzero(self.benefits[t] > 0):
                    gain = self.benefits[t, j] - self.moves(path | {t: int(j)}) + self.moves(path)
                    bid = min(gain, self.bundle[-1][2]) if self.bundle else gain
                    wins = self.z[t, j] < 0 or (bid, -self.number) > (self.y[t, j], -self.z[t, j])
                    if gain > best[0] + 1e-12 and wins:
                        best = (gain, t, int(j), bid)
            if best[1] < 0:
                return changed
            _, t, j, bid = best
            self.bundle.append((t, j, bid))
            self.y[t, j], self.z[t, j] = bid, self.number
            changed = True

    def hear(self, k: int, y: np.ndarray, z: np.ndarray, s: np.ndarray, now: int) -> bool:
        """Merge a neighbour's tables by the rules."""
        changed = False
        for t, j in np.argwhere((y != self.y) | (z != self.z)):
            action = table(self.number, k, self.y[t, j], int(self.z[t, j]), y[t, j], int(z[t, j]), self.s, s)
            if action == "update":
                self.y[t, j], self.z[t, j] = y[t, j], z[t, j]
            elif action == "reset":
                self.y[t, j], self.z[t, j] = 0.0, -1
            changed |= action != "leave"
        self.s = np.maximum(self.s, s)
        self.s[k] = now
        return changed


def plain_cbba(
    benefits: np.ndarray, cost: float, held: np.ndarray | None, graph: nx.Graph, max_rounds: int = 2000
) -> tuple[list[Bundler], int]:
    """Agents after the consensus on a window of benefits (L, n, m), and the rounds it took."""
    n = benefits.shape[1]
    agents = [Bundler(i, n, benefits[:, i], -1 if held is None else int(held[i]), cost) for i in range(n)]
    for agent in agents:
        agent.build()
    last, now, wait = 0, 0, 2 * diameter(graph)
    while now < max_rounds and now < last + wait:
        now += 1
        packets = [(agent.y.copy(), agent.z.copy(), agent.s.copy()) for agent in agents]
        changed = False
        for agent in agents:
            for k in sorted(graph[agent.number]):
                changed |= agent.hear(k, *packets[k], now)
            agent.s[agent.number] = now
        for agent in agents:
            changed |= agent.build()
        last = now if changed else last
    return agents, now
