"""CBBA, the consensus-based bundle algorithm (Choi, Brunet and How, 2009), as the thesis uses it (section 4.1).

An agent's bundle holds at most one task for every step of the window, L in all. The score of a task at a step is its
benefit less the handovers that it adds to the agent's path, from the task before it and to the task after it; steps
without a task change nothing, the agent waits where it is.

**Diminishing marginal gain.** CBBA converges if a slot is never worth more to an agent because of what its bundle
already holds. The handover score breaks that: once task j at step t + 1 is in the bundle and its handover is paid, the
same task at step t costs no handover more, so it gains the whole benefit instead of the benefit less the cost. Agents
therefore choose by the true gain but announce ``min(gain, bid announced before)`` (Johnson, Choi, Ponda and How, 2012),
so that the announced bids behave as if the gain were diminishing.

**Free of conflicts, always.** After the consensus the agents tell each other, in a diameter of rounds, which task they
claim for the current step, with the bid, and which task they hold. All then apply the same rule to the same claims: the
highest bid has the task, equal bids the lower number; who has no task keeps the one it holds if nobody has it, and
else, in ascending order, takes the lowest free one. So no task is given twice even if the consensus was stopped early.

**Capacities, idleness, limits.** Every place of a task is a slot of its own (`sapopt.solvers.distributed.seats`). The
rule for the claims then is: as many claims as capacities and limits allow, the dearest ones first; who claims nothing
waits on the task it holds, or holds nothing (`sapopt.solvers.limited.greedy.kept_choices`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.limited.useful import switching_rule
from sapopt.kernels.blocks import in_blocks
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.base import EXTRAS, check_lookahead
from sapopt.solvers.distributed import common
from sapopt.solvers.distributed.common import Memory, Scene, Talks, check_options
from sapopt.solvers.distributed.faults import Faults
from sapopt.solvers.distributed.seats import Seats, seated_cost, seated_offers, seats_of
from sapopt.solvers.distributed.simulator import ENTRY_BYTES, HEADER_BYTES
from sapopt.solvers.limited.greedy import kept_choices

_STAMP_BYTES = 4
CLAIM_BYTES = 16


@dataclass(frozen=True, eq=False)
class CBBA(Talks):
    """Consensus-based bundle algorithm, replanned at every step.

    Parameters
    ----------
    lookahead : int
        L >= 1, the length of the bundles; the window at step k is ``k .. min(k + L, T) - 1``.
    graph : networkx graph, sequence of T of them, or None
        Which agents hear each other, nodes ``0 .. n - 1``; None: all of them do.
    allow_disconnected : bool
        Let the parts of a disconnected graph assign the tasks they keep, see `sapopt.solvers.distributed.common`.
    faults : Faults, optional
    max_rounds : int
        Rounds of the consensus; claims are settled after that in any case.

    Raises
    ------
    ValueError
        If an option is out of range; at the start of a run if the graph does not fit the problem, its dynamics is not a
        `SwitchingCost`, or pairs are forbidden.

    References
    ----------
    H.-L. Choi, L. Brunet and J. How, Consensus-based decentralized auctions for robust task allocation, IEEE
    Transactions on Robotics 25(4), 2009.
    """

    lookahead: int = 1
    graph: Any = None
    allow_disconnected: bool = False
    faults: Faults | None = None
    max_rounds: int = 2000

    takes: ClassVar[frozenset[str]] = EXTRAS

    def __post_init__(self) -> None:
        check_lookahead(self.lookahead)
        check_options(None, self.max_rounds, self.faults)

    @property
    def name(self) -> str:
        """Name with options."""
        return f"CBBA(L={self.lookahead})"

    def begin(self, problem: SAP, rng: np.random.Generator) -> Memory:
        """Check the problem and the graphs."""
        if switching_rule(problem) is None:
            raise ValueError(
                f"dynamics: CBBA scores the handovers of a SwitchingCost, not of {problem.model.called}; "
                "use HAALD"
            )
        if problem.is_plain and problem.benefits.forbids():
            raise ValueError(
                "benefits: CBBA parks idle agents on any free task, but pairs are forbidden; use HAALD"
            )
        seed = int(rng.integers(2**62))
        return common.begin(problem, self.graph, self.allow_disconnected, self.faults, seed)

    def act(self, outlook: Outlook, memory: Memory) -> tuple[IntArray, Memory]:
        """Build bundles, agree on the winners, execute the current step."""
        scene = common.open_step(outlook, memory, self.allow_disconnected, self.faults)
        seats = None
        if outlook.rules is not None:
            seats = seats_of(outlook, min(outlook.k + self.lookahead, outlook.end), private=False)
        claimed, bids = self._consensus(outlook, scene, seats)
        scene.simulator.flood(np.full(outlook.problem.n, CLAIM_BYTES))
        if seats is not None:
            assert outlook.rules is not None
            claimed = np.where(claimed < 0, -1, seats.task[np.maximum(claimed, 0)])
            scene.simulator.flood(np.full(outlook.problem.n, -(-outlook.problem.m // 8)))  # a bit a pair
            tasks = kept_choices(outlook, claimed, bids, outlook.rules.ledger.previous)
            return tasks, common.close_step(scene, memory, tasks, np.ones(len(tasks), dtype=bool))
        tasks = settle(claimed, bids, memory.held, scene.component, scene.open_tasks)
        tasks[scene.dead] = memory.held[scene.dead]
        return tasks, common.close_step(scene, memory, tasks, np.ones(len(tasks), dtype=bool))

    def _consensus(self, outlook: Outlook, scene: Scene, seats: Seats | None) -> tuple[IntArray, FloatArray]:
        """Claimed task of every agent at the current step (-1: none) and its bid; of seats, where tasks have some."""
        from sapopt.solvers.distributed import cbba_kernels as kernels

        window = outlook.benefits(self.lookahead)
        rule = switching_rule(outlook.problem)
        assert rule is not None
        cost: Any = rule.cost
        held = np.full(outlook.problem.n, -1) if outlook.state is None else outlook.state
        open_tasks = scene.open_tasks
        if seats is not None:
            window, cost = seated_offers(outlook, window, seats), seated_cost(rule.cost, seats)
            held = np.where(held < 0, -1, np.searchsorted(seats.task, held))
            open_tasks = np.ones((1, len(seats.task)), dtype=bool)
        steps, n, m = window.shape
        flat = window.flat()
        offers = kernels.Offers(
            steps, n, m, flat.indptr, flat.indices, flat.data,
            cost=np.atleast_2d(np.asarray(cost, dtype=np.float64)),
            held=held,
            open_task=open_tasks[scene.component],
        )  # fmt: skip
        tables = kernels.Tables(
            np.zeros((n, steps * m)),
            np.full((n, steps * m), -1, dtype=np.int32),
            np.zeros((n, n), dtype=np.int32),
        )
        bundles = kernels.Bundles(
            np.full((n, steps), -1),
            np.full((n, steps), -1),
            np.zeros((n, steps)),
            np.zeros(n, dtype=np.int64),
        )
        network = scene.network

        def bundle() -> np.ndarray:
            changed = np.zeros(n, dtype=bool)
            turns = 2.0 * steps * flat.data.size
            in_blocks(kernels.bundle_phase, n, offers, tables, bundles, changed, turns=turns)
            return changed

        def play_round(r: int) -> tuple[IntArray, np.ndarray]:
            # Slots without a winner need not be sent: what is missing has none.
            sizes = HEADER_BYTES + _STAMP_BYTES * n + ENTRY_BYTES * (tables.winner >= 0).sum(axis=1)
            changed = np.zeros(n, dtype=bool)
            differs = np.zeros(steps * m, dtype=bool)
            kernels.mark_disputed(tables, differs)
            slots = np.flatnonzero(differs)
            if len(slots) == 0:  # all know the same, so no rule changes anything: only the wait is left
                return sizes, changed
            sent = kernels.Tables(tables.bid.copy(), tables.winner.copy(), tables.stamp.copy())
            in_blocks(
                kernels.consensus_phase, n, network.link_start, network.links, r, slots, tables, sent, changed,
                turns=float(len(network.links)) * (len(slots) + n),
            )  # fmt: skip
            return sizes, changed | bundle()

        bundle()
        scene.simulator.run(play_round, self.max_rounds)
        claimed = bundles.path[:, 0]
        worth = np.where(claimed >= 0, tables.bid[np.arange(n), np.maximum(claimed, 0)], 0.0)
        return claimed, worth


def settle(
    claimed: IntArray, bids: FloatArray, held: IntArray, component: IntArray, open_tasks: np.ndarray
) -> IntArray:
    """Turn claims into an assignment by the rule that all agents apply to the same claims.

    Parameters
    ----------
    claimed : ndarray of int64, shape (n,)
        Task that every agent claims, -1 for none.
    bids : ndarray of float64, shape (n,)
    held : ndarray of int64, shape (n,)
        Task that every agent holds, no two the same.
    component : ndarray of int64, shape (n,)
    open_tasks : ndarray of bool, shape (components, m)
        Tasks that a component may assign; those its agents hold are among them.

    Returns
    -------
    ndarray of int64, shape (n,)
        A task for every agent, no two the same.
    """
    tasks = np.full(len(claimed), -1)
    taken = np.zeros(open_tasks.shape[1], dtype=bool)
    claimants = np.flatnonzero(claimed >= 0)
    for i in claimants[np.lexsort((claimants, -bids[claimants]))]:
        if not taken[claimed[i]]:
            tasks[i] = claimed[i]
            taken[claimed[i]] = True
    for i in np.flatnonzero(tasks < 0):
        if not taken[held[i]]:
            tasks[i] = held[i]
            taken[held[i]] = True
    for part in np.unique(component[tasks < 0]):
        idle = np.flatnonzero((tasks < 0) & (component == part))
        tasks[idle] = np.flatnonzero(open_tasks[part] & ~taken)[: len(idle)]
        taken[tasks[idle]] = True
    return tasks
