"""Distributed dual lookahead: prices of the window's tasks, found by exchange with neighbours alone.

As in the dual lookahead every task of every step of the window has a price, under which each agent plans its own best
path. Here there is nobody to set the prices. Every agent prices the tasks that it may want itself: it hears the plans
of the agents around it, counts how many want a task at a step, and raises or lowers its own price. Agents that see the
same task hear the same plans, up to a round or two, so their prices move together without ever being compared.

After a fixed number of such rounds each agent knows what every task at the current step is worth to it, the rest of the
window at its prices, and one distributed auction on those worths gives the assignment. Prices that disagree, or rivals
that did not hear each other, therefore cost value, never feasibility. The prices are carried to the next step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sapopt.data.matrices import GainMatrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.base import check_lookahead
from sapopt.solvers.distributed import common
from sapopt.solvers.distributed.auction import run_auctions
from sapopt.solvers.distributed.common import MAX_ROUNDS, Memory, Scene, Talks, check_options
from sapopt.solvers.distributed.faults import Faults
from sapopt.solvers.distributed.network import Network
from sapopt.solvers.distributed.simulator import HEADER_BYTES

_STEP = 0.1
"""First price step, as a share of the mean positive benefit."""
_DECAY = 0.02


@dataclass(frozen=True, eq=False)
class _Prices:
    """Prices of one window; for the slots see `dual_kernels`."""

    k: int
    slot_ptr: IntArray
    place: np.ndarray
    price: FloatArray


@dataclass(frozen=True, eq=False)
class DistributedDualLookahead(Talks):
    """Dual lookahead without a central node.

    Parameters
    ----------
    window : int
        W >= 1 steps are planned at each step.
    epsilon : float
        Least raise of a bid in the auction of the current step.
    graph : networkx graph, sequence of T of them, or None
        Which agents hear each other, nodes ``0 .. n - 1``; None: all of them do.
    iterations : int
        Price rounds at every step.
    hops : int
        How far a plan is passed on. Rivals for a task some steps ahead may be more than one hop away now.
    allow_disconnected : bool
        Let the parts of a disconnected graph assign the tasks they keep, see `sapopt.solvers.distributed.common`.
    faults : Faults, optional
    max_rounds : int
        Rounds of the auction after which a part gives up and keeps its tasks.

    Raises
    ------
    ValueError
        If an option is out of range; at the start of a run if the graph does not fit the problem, its dynamics is not a
        `SwitchingCost` with one cost, or pairs are forbidden.
    """

    window: int = 6
    epsilon: float = 0.01
    graph: Any = None
    iterations: int = 40
    hops: int = 2
    allow_disconnected: bool = False
    faults: Faults | None = None
    max_rounds: int = MAX_ROUNDS

    def __post_init__(self) -> None:
        check_lookahead(self.window, "window")
        check_lookahead(self.iterations, "iterations")
        check_lookahead(self.hops, "hops")
        check_options(self.epsilon, self.max_rounds, self.faults)

    @property
    def name(self) -> str:
        """Name with options."""
        return f"DistributedDualLookahead(W={self.window})"

    def begin(self, problem: SAP, rng: np.random.Generator) -> Memory:
        """Check the problem and the graphs."""
        rule = problem.model.switching()
        if rule is None or rule.uniform_cost is None:
            raise ValueError(
                f"dynamics: DistributedDualLookahead plans paths under a SwitchingCost with one cost, not under "
                f"{problem.dynamics!r}; use HAALD"
            )
        if problem.benefits.forbids():
            raise ValueError("benefits: DistributedDualLookahead knows no forbidden pairs; use HAALD")
        seed = int(rng.integers(2**62))
        return common.begin(problem, self.graph, self.allow_disconnected, self.faults, seed)

    def act(self, outlook: Outlook, memory: Memory) -> tuple[IntArray, Memory]:
        """Find prices, then auction the current step."""
        scene = common.open_step(outlook, memory, self.allow_disconnected, self.faults)
        matrix, prices = self._worths(outlook, scene, memory.extra)
        done = run_auctions([matrix], scene, self.epsilon, self.max_rounds)
        tasks = np.where(done.agreed, done.tasks[0], memory.held)
        return tasks, common.close_step(scene, memory, tasks, done.agreed, prices)

    def _worths(self, outlook: Outlook, scene: Scene, last: _Prices | None) -> tuple[GainMatrix, _Prices]:
        """What every task at the current step is worth to every agent, and the prices behind it."""
        from sapopt.solvers.distributed import dual_kernels as kernels

        n, m = outlook.problem.n, outlook.problem.m
        window = outlook.benefits(self.window)
        steps = window.shape[0]
        flat = window.flat()
        held = np.full(n, -1) if outlook.state is None else outlook.state
        rule = outlook.model.switching()
        assert rule is not None
        assert rule.uniform_cost is not None
        cost, idle_is_free = rule.uniform_cost, bool(rule.idle_is_free)
        slots = kernels.find_slots(flat.indptr, flat.indices, flat.data, held, n, m, steps)
        slot_ptr, slot_task, benefit, place = slots
        price = np.zeros((len(slot_task), steps))
        network = scene.network
        if last is not None:
            kernels.carry_prices(
                network.link_start, network.links, last.price, last.place,
                outlook.k - last.k, slot_ptr, slot_task, price,
            )  # fmt: skip
            scene.simulator.deliver(
                HEADER_BYTES + (4 + 8 * last.price.shape[1]) * np.diff(last.slot_ptr)[None]
            )
        if steps > 1:
            positive = benefit[benefit > 0]
            step = _STEP * float(positive.mean()) if len(positive) else 1.0
            mean = np.zeros_like(price)
            sent = kernels.iterate(
                kernels.Near(*_near(network, self.hops)), kernels.Places(*slots), held, cost, idle_is_free, price, mean,
                kernels.Rounds(self.iterations, step, _DECAY, self.hops),
            )  # fmt: skip
            price = mean
            scene.simulator.deliver(_packets(network, sent, self.hops, 4 * (steps + 1)))
        tasks, gains = kernels.first_gains(slot_ptr, slot_task, benefit, price, held, cost, idle_is_free)
        matrix = GainMatrix(slot_ptr, tasks, gains, np.full(n, -1), np.zeros(n), 0.0, m, True)
        return matrix, _Prices(outlook.k, slot_ptr, place, price)


def _near(network: Network, hops: int) -> tuple[IntArray, IntArray, IntArray]:
    """Agents within `hops` hops of every agent, itself included, as lists with their distance."""
    if hops == 1:
        n = network.n
        agent = np.concatenate([network.sources, np.arange(n)])
        other = np.concatenate([network.links, np.arange(n)])
        away = (agent != other).astype(np.int64)
        order = np.lexsort((other, agent))
        agent, other, away = agent[order], other[order], away[order]
    else:
        distances = network.distances
        agent, other = np.nonzero((distances >= 0) & (distances <= hops))
        away = distances[agent, other].astype(np.int64)
    start = np.concatenate([[0], np.cumsum(np.bincount(agent, minlength=network.n))])
    return start.astype(np.int64), other.astype(np.int64), away


def _packets(network: Network, sent: np.ndarray, hops: int, size: int) -> IntArray:
    """Bytes that every agent sends in every round: its new plan, and those it passes on."""
    plans = sent.astype(np.int64)
    for d in range(1, hops):
        if d < len(sent):
            plans[d:] += sent[:-d].astype(np.int64) @ (network.distances == d).astype(np.int64)
    packets: IntArray = plans * size + HEADER_BYTES * (plans > 0)
    return packets
