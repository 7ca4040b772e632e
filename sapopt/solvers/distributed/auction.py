"""The distributed auction (Zavlanos, Spesivtsev and Pappas, 2008): alpha without a central node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from sapopt.data.feasibility import InfeasibleError, explain_infeasible
from sapopt.data.matrices import GainMatrix, Matrix
from sapopt.data.types import FloatArray, IntArray, real_array, real_csr
from sapopt.kernels.blocks import thread_count
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.base import EXTRAS
from sapopt.solvers.distributed import common
from sapopt.solvers.distributed.common import MAX_ROUNDS, Memory, Scene, Talks, check_options
from sapopt.solvers.distributed.faults import Faults
from sapopt.solvers.distributed.network import Network
from sapopt.solvers.distributed.simulator import ENTRY_BYTES, HEADER_BYTES, Simulator, Traffic

_GOLDEN = 0.6180339887498949
_LOOK_SECONDS = 0.05
"""Time between two looks at the clock while auctions are held."""


@dataclass(frozen=True, eq=False)
class Auctions:
    """Several auctions held side by side in shared packets.

    Attributes
    ----------
    tasks : ndarray of int64, shape (auctions, n)
        Task of every agent; -1 if its part did not come to rest.
    agreed : ndarray of bool, shape (n,)
        Whether all auctions of the agent's component ended within the round limit.
    prices, bidders : ndarray, shape (auctions, n, m)
        What every agent knows of every task in the end.
    """

    tasks: IntArray
    agreed: np.ndarray
    prices: FloatArray
    bidders: np.ndarray


def gain_rows(matrix: Matrix) -> GainMatrix:
    """A benefit matrix as sorted rows of gains over a common value.

    With a handover cost the common value of an array is not zero but minus the cost. It must be found, since only tasks
    of the common value are tried in an order of each agent's own; else all idle agents would bid for the same ones.
    """
    if isinstance(matrix, GainMatrix):
        return matrix
    if matrix.min() >= 0:
        return GainMatrix.from_matrix(matrix)
    values, counts = np.unique(matrix[np.isfinite(matrix)], return_counts=True)
    if counts.max() <= 1:
        return GainMatrix.from_matrix(matrix)
    rest = float(values[counts.argmax()])
    return replace(GainMatrix.from_matrix(matrix - rest), rest=rest)


def spread_over(count: int, m: int) -> IntArray:
    """Places at which the bidders start to look for a free task, evenly spread however many bidders there are."""
    spread: IntArray = (np.arange(1, count + 1) * _GOLDEN % 1.0 * m).astype(np.int64) % m
    return spread


def infeasible(matrix: Matrix, scene: Scene) -> str:
    """Why some component has no full assignment among its tasks; empty if all have."""
    if isinstance(matrix, GainMatrix) and not (matrix.has_negative and np.isneginf(matrix.gains).any()):
        return ""
    dense = matrix.toarray() if isinstance(matrix, GainMatrix) else matrix
    if not np.isneginf(dense).any():
        return ""
    reason = explain_infeasible(np.isfinite(dense) & scene.open_tasks[scene.component])
    if reason and len(scene.open_tasks) > 1:
        return f"{reason} (of the tasks that its part of the network keeps)"
    return reason


def run_auctions(
    matrices: Sequence[Matrix],
    scene: Scene,
    epsilon: float,
    max_rounds: int,
    *,
    scaling: float | None = None,
) -> Auctions:
    """Hold auctions side by side: every packet carries the news of all of them.

    An agent bids for its best task at the prices it knows, raised to where its second best would be as good, plus
    `epsilon`. When nobody has been outbid, every component's assignment is within ``epsilon`` times its size of its
    best. See `Simulator.run` for how the agents know that.
    """
    from concurrent.futures import ThreadPoolExecutor, wait

    from sapopt.solvers.distributed.auction_kernels import Wishes, auction

    network = scene.network
    n, m = network.n, scene.open_tasks.shape[1]
    rows = [gain_rows(matrix) for matrix in matrices]
    bidders = n if scaling is None else m
    prices = scene.closed_prices(len(rows))
    owners = np.full(prices.shape, -1, dtype=np.int32)  # (auctions, m, n), as the prices
    spread = spread_over(bidders, m)
    mine = np.empty((len(rows), bidders), dtype=np.int64)
    agreed = np.ones(n, dtype=bool)

    scene.simulator.check()
    stop = np.zeros(1, dtype=np.bool_)  # the auctions look at it, this thread at the clock

    def play(a: int, eps: float) -> tuple[np.ndarray, np.ndarray]:
        row = rows[a]
        owners[a] = -1
        wishes = Wishes(row.row_start, row.tasks, row.gains, row.held, row.held_gain, spread)
        mine[a], entries, bids, stuck = auction(
            *network.rings, wishes, prices[a], owners[a], eps, _range(row), max_rounds, stop
        )
        if stuck >= 0:
            raise InfeasibleError(f"agent {stuck} has no task that it may take")
        return entries, bids

    for eps in _phases(rows, epsilon, scaling, n, m):
        threads = min(len(rows), thread_count())
        with ThreadPoolExecutor(threads) as pool:
            auctions = [pool.submit(play, a, eps) for a in range(len(rows))]
            try:
                while wait(auctions, timeout=_LOOK_SECONDS).not_done:
                    scene.simulator.check()
            except BaseException:
                stop[0] = True
                raise
        played = [one.result() for one in auctions]
        agreed &= _account(scene.simulator, network, played, max_rounds)
    tasks = np.where(agreed, mine[:, :n], -1)
    return Auctions(tasks, agreed, prices.transpose(0, 2, 1), owners.transpose(0, 2, 1))


def _range(row: GainMatrix) -> float:
    gains = np.concatenate([row.gains, row.held_gain, [0.0]])
    gains = gains[np.isfinite(gains)]
    return float(gains.max() - gains.min()) + 1.0


def _phases(rows: Sequence[GainMatrix], epsilon: float, scaling: float | None, n: int, m: int) -> list[float]:
    """Epsilon of every phase; one phase without scaling.

    With scaling, prices outlive a phase, so that tasks nobody wants any more may keep a price. Virtual bidders make the
    problem m by m and take those; the last phase is the finer for it, so that n epsilon still holds.
    """
    if scaling is None:
        return [epsilon]
    last = epsilon * n / m
    phases = [last]
    while phases[-1] * scaling < max(_range(row) for row in rows) / 4:
        phases.append(phases[-1] * scaling)
    return phases[::-1]


def _account(
    simulator: Simulator, network: Network, played: list[tuple[np.ndarray, np.ndarray]], max_rounds: int
) -> np.ndarray:
    """Put the packets of one phase on the simulator; returns whose component came to rest in time, shape ``(n,)``."""
    from sapopt.solvers.distributed.auction_kernels import stamp_news

    n = network.n
    length = max(len(bids) for _, bids in played)
    all_bids = np.zeros((length, n), dtype=np.int64)
    for _, bids in played:
        all_bids[: len(bids)] += bids
    last = np.zeros(len(network.diameters), dtype=np.int64)
    made, agent = np.nonzero(all_bids)
    np.maximum.at(last, network.components[agent], made)
    ends = last + 2 * network.diameters
    rounds = int(min(ends.max(), max_rounds))
    entries = np.zeros((rounds, n), dtype=np.int64)
    for changed, _ in played:
        entries[: len(changed)] += changed[:rounds]
    stamps = stamp_news(network.link_start, network.links, all_bids, rounds)
    simulator.deliver(ENTRY_BYTES * entries + HEADER_BYTES * ((entries > 0) | stamps))
    agreed: np.ndarray = (ends <= max_rounds)[network.components]
    return agreed


@dataclass(frozen=True, eq=False)
class AuctionResult:
    """A distributed assignment.

    Attributes
    ----------
    tasks : ndarray of int64, shape (n,)
    value : float
        Total benefit.
    prices, bidders : ndarray, shape (n, m)
        What every agent knows in the end; all rows are equal.
    traffic : Traffic
    """

    tasks: IntArray
    value: float
    prices: FloatArray
    bidders: np.ndarray
    traffic: Traffic


@dataclass(frozen=True, eq=False)
class DistributedAuction(Talks):
    """Assign by a distributed auction: `assign` for one matrix, or as a policy that plays alpha(beta_hat).

    Agents know their own benefits and exchange prices and bidders with their neighbours. The assignment is within
    ``n * epsilon`` of the best; with integer benefits and ``epsilon < 1 / n`` it is the best.

    Parameters
    ----------
    epsilon : float
        Least raise of a bid. Smaller is better and takes more rounds.
    graph : networkx graph, sequence of T of them, or None
        Which agents hear each other, nodes ``0 .. n - 1``; None: all of them do.
    scaling : float, optional
        Hold the auction for a coarse epsilon first and divide it by this factor (above 1; 4 is usual) until `epsilon`
        is reached. Pays where `epsilon` is small against the benefits. Needs connected graphs.
    allow_disconnected : bool
        Let the parts of a disconnected graph assign the tasks they keep, see `sapopt.solvers.distributed.common`.
    faults : Faults, optional
    max_rounds : int
        Rounds of one auction after which a part gives up and keeps its tasks.

    Raises
    ------
    ValueError
        If an option is out of range; at the start of a run if the graph does not fit the problem.

    References
    ----------
    M. Zavlanos, L. Spesivtsev and G. Pappas, A distributed auction algorithm for the assignment problem, CDC 2008.
    """

    epsilon: float = 0.01
    graph: Any = None
    scaling: float | None = None
    allow_disconnected: bool = False
    faults: Faults | None = None
    max_rounds: int = MAX_ROUNDS

    takes: ClassVar[frozenset[str]] = EXTRAS

    def __post_init__(self) -> None:
        check_options(self.epsilon, self.max_rounds, self.faults)
        if self.scaling is not None:
            if not (np.isfinite(self.scaling) and self.scaling > 1):
                raise ValueError(f"scaling must be a factor above 1, got {self.scaling!r}")
            if self.allow_disconnected or (self.faults is not None and self.faults.splits):
                raise ValueError(
                    "scaling needs a network that stays connected; leave it out where parts may split off"
                )

    @property
    def name(self) -> str:
        """Name with options."""
        return f"DistributedAuction(epsilon={self.epsilon:g})"

    def assign(self, matrix: Any, seed: int = 0) -> AuctionResult:
        """Distributed alpha of one benefit matrix.

        Parameters
        ----------
        matrix : ndarray or sparse matrix of shape (n, m), or GainMatrix
            n <= m; ``-inf`` forbids a pair.
        seed : int
            Of the faults.

        Raises
        ------
        InfeasibleError
            If forbidden pairs leave no full assignment.
        ValueError
            If the matrix or the graph has a wrong shape, the graph is not connected, or the round limit was reached.
        """
        rows = matrix if isinstance(matrix, GainMatrix) else _one_step(matrix)
        n, m = rows.shape
        problem = SAP(np.zeros((1, n, m)))
        memory = common.begin(problem, self.graph, False, self.faults, seed)
        network = memory.networks.at(0)
        rng = np.random.default_rng([seed, 0])
        scene = Scene(
            network, Simulator(network, self.faults, rng), network.components, np.ones((1, m), dtype=bool),
            np.zeros(n, dtype=bool),
        )  # fmt: skip
        reason = infeasible(rows, scene)
        if reason:
            raise InfeasibleError(reason)
        done = run_auctions([rows], scene, self.epsilon, self.max_rounds, scaling=self.scaling)
        if not done.agreed.all():
            raise ValueError(
                f"max_rounds = {self.max_rounds} rounds are too few; raise it, epsilon, or use scaling"
            )
        tasks = done.tasks[0]
        return AuctionResult(
            tasks, rows.value(tasks), done.prices[0], done.bidders[0], scene.simulator.traffic()
        )

    def begin(self, problem: SAP, rng: np.random.Generator) -> Memory:
        """Check the graphs."""
        if self.scaling is not None and not problem.is_plain:
            raise ValueError(
                "scaling: problems with capacities, idleness, limits or teams are auctioned at one epsilon"
            )
        seed = int(rng.integers(2**62))
        return common.begin(problem, self.graph, self.allow_disconnected, self.faults, seed)

    def act(self, outlook: Outlook, memory: Memory) -> tuple[IntArray, Memory]:
        """Assign beta_hat of the current step."""
        scene = common.open_step(outlook, memory, self.allow_disconnected, self.faults)
        matrix = outlook.beta_hat()
        if outlook.rules is not None:
            from sapopt.solvers.distributed.seats import auctioned  # which holds its auctions by this module

            now = (outlook.k, outlook.k + 1)
            tasks = auctioned(outlook, {now: matrix}, scene, self.epsilon, self.max_rounds)[now]
            return tasks, common.close_step(scene, memory, tasks, np.ones(len(tasks), dtype=bool))
        reason = infeasible(matrix, scene)
        if reason:
            raise InfeasibleError(f"step {outlook.k}: {reason}")
        done = run_auctions([matrix], scene, self.epsilon, self.max_rounds, scaling=self.scaling)
        tasks = np.where(done.agreed, done.tasks[0], common.fallback(outlook, memory, done.agreed))
        return tasks, common.close_step(scene, memory, tasks, done.agreed)


def _one_step(matrix: Any) -> GainMatrix:
    import scipy.sparse as sp

    values = real_csr(matrix, "matrix") if sp.issparse(matrix) else real_array(matrix, "matrix")
    if len(values.shape) != 2 or 0 in values.shape:
        raise ValueError(f"matrix must have shape (n, m), got {values.shape}")
    if values.shape[0] > values.shape[1]:
        raise ValueError(
            f"{values.shape[0]} agents cannot each have one of {values.shape[1]} tasks; add idle tasks"
        )
    data = np.asarray(values.data if sp.issparse(values) else values)
    if np.isnan(data).any() or np.isposinf(data).any():
        raise ValueError("matrix contains NaN or +inf; use -inf for a forbidden pair")
    return GainMatrix.from_matrix(values) if sp.issparse(values) else gain_rows(values)
