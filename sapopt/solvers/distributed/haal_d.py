"""HAAL-D: handover-aware assignment with lookahead without a central node, and its centralised twin."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.matrices import Matrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.base import EXTRAS, check_lookahead
from sapopt.solvers.distributed import common
from sapopt.solvers.distributed.auction import infeasible, run_auctions
from sapopt.solvers.distributed.common import MAX_ROUNDS, Memory, Scene, Talks, check_options
from sapopt.solvers.distributed.faults import Faults
from sapopt.solvers.distributed.seats import Interval, auctioned

Knowledge = Literal["own", "all"]
_TIE = 1e-12


def interval_problems(
    outlook: Outlook, lookahead: int, exact_intervals: bool = False
) -> dict[Interval, Matrix]:
    """The L (L + 1) / 2 interval problems of the window, all of them entered from the current state.

    Algorithm 2 enters an interval from the state that the intervals before it lead to; here the agents solve all
    intervals at once and know only the current state.
    """
    stop = min(outlook.k + lookahead, outlook.end)
    matrix = outlook.interval if exact_intervals else outlook.entered
    return {
        (a, b): matrix(a, b, outlook.state) for a in range(outlook.k, stop) for b in range(a + 1, stop + 1)
    }


def reach(solved: Iterable[Interval], start: int) -> int:
    """The last step that a sequence of these intervals can end with, which is less than the window's where forbidden
    pairs leave some of them without an assignment."""
    ends = {start}
    for a, b in sorted(solved):
        if a in ends:
            ends.add(b)
    return max(ends)


def best_sequence(
    outlook: Outlook, stop: int, solved: dict[Interval, IntArray], component: IntArray
) -> tuple[IntArray, FloatArray]:
    """The best sequence of intervals of each component, played from the current state with the true handovers.

    Returns
    -------
    cut : ndarray of int64, shape (components,)
        End of the first interval; -1 if no sequence is feasible.
    value : ndarray, shape (components,)
    """
    parts = int(component.max()) + 1
    known: dict[tuple[int, Any], tuple[IntArray, FloatArray]] = {}

    def best(start: int, state: Any) -> tuple[IntArray, FloatArray]:
        if start == stop:
            return np.full(parts, stop), np.zeros(parts)
        key = (start, outlook.model.key(state))
        if key in known:
            return known[key]
        cut, top = np.full(parts, -1), np.full(parts, -np.inf)
        for end in range(start + 1, stop + 1):
            tasks = solved.get((start, end))
            if tasks is None:
                continue
            gains, after = outlook.played(start, end, state, tasks)
            added = np.bincount(component, gains, parts)
            total = added + best(end, after)[1]
            # Equal sequences: the shortest first interval, as in HAAL.
            better = (total > -np.inf) & (
                (cut < 0) | (total > top + _TIE * np.abs(np.where(cut < 0, 0.0, top)))
            )
            cut, top = np.where(better, end, cut), np.where(better, total, top)
        known[key] = cut, top
        return cut, top

    return best(outlook.k, outlook.state)


@dataclass(frozen=True, eq=False)
class HAALD(Talks):
    """Handover-aware assignment with lookahead, distributed (thesis, Algorithm 3).

    At every step the agents hold one auction for each of the L (L + 1) / 2 intervals of the window, side by side in
    shared packets, all entered from the current assignment. Then they agree on the value of every sequence of intervals
    and execute the first assignment of the best one.

    Parameters
    ----------
    lookahead : int
        L >= 1; the window at step k is ``k .. min(k + L, T) - 1``.
    epsilon : float
        Least raise of a bid; every interval's assignment is within ``n * epsilon`` of its best.
    graph : networkx graph, sequence of T of them, or None
        Which agents hear each other, nodes ``0 .. n - 1``; None: all of them do.
    knowledge : {"own", "all"}
        What agents know of benefits and handovers (thesis, section 3.5). "own": their own; the values of the sequences
        are exchanged, which takes a diameter of rounds. "all": everything, so that each evaluates the sequences itself.
        The plans are the same.
    allow_disconnected : bool
        Let the parts of a disconnected graph assign the tasks they keep, see `sapopt.solvers.distributed.common`.
    faults : Faults, optional
    max_rounds : int
        Rounds of a step after which a part gives up and keeps its tasks.
    exact_intervals : bool
        See `sapopt.solvers.HAAL`.

    Raises
    ------
    ValueError
        If an option is out of range; at the start of a run if the graph does not fit the problem.

    References
    ----------
    J. Holder, MSc thesis, University of Washington, 2024, section 3.4.

    Notes
    -----
    Capacities, idleness and limits: `sapopt.solvers.distributed.seats`.
    """

    lookahead: int = 3
    epsilon: float = 0.01
    graph: Any = None
    knowledge: Knowledge = "own"
    allow_disconnected: bool = False
    faults: Faults | None = None
    max_rounds: int = MAX_ROUNDS
    exact_intervals: bool = False

    takes: ClassVar[frozenset[str]] = EXTRAS

    def __post_init__(self) -> None:
        check_lookahead(self.lookahead)
        if not isinstance(self.exact_intervals, bool):
            raise ValueError(f"exact_intervals must be True or False, got {self.exact_intervals!r}")
        check_options(self.epsilon, self.max_rounds, self.faults)
        if self.knowledge not in ("own", "all"):
            raise ValueError(f"knowledge must be 'own' or 'all', got {self.knowledge!r}")

    @property
    def name(self) -> str:
        """Name with options."""
        return f"HAALD(L={self.lookahead}, epsilon={self.epsilon:g})"

    def begin(self, problem: SAP, rng: np.random.Generator) -> Memory:
        """Check the graphs."""
        seed = int(rng.integers(2**62))
        return common.begin(problem, self.graph, self.allow_disconnected, self.faults, seed)

    def act(self, outlook: Outlook, memory: Memory) -> tuple[IntArray, Memory]:
        """Execute the first assignment of the best sequence of intervals."""
        scene = common.open_step(outlook, memory, self.allow_disconnected, self.faults)
        solved, agreed = self.solve_intervals(outlook, scene)
        stop = reach(solved, outlook.k)
        tasks = common.fallback(outlook, memory, agreed)
        if agreed.any():
            cut, _ = best_sequence(outlook, stop, _whole(solved, memory.held), scene.component)
            if self.knowledge == "own":
                scene.simulator.flood(np.full(len(tasks), 8 * 2 ** (stop - outlook.k - 1)))
            for end in np.unique(cut[scene.component[agreed]]):
                executes = agreed & (cut[scene.component] == end)
                tasks[executes] = solved[outlook.k, int(end)][executes]
        return tasks, common.close_step(scene, memory, tasks, agreed)

    def solve_intervals(self, outlook: Outlook, scene: Scene) -> tuple[dict[Interval, IntArray], np.ndarray]:
        """Hold all auctions of a step.

        Returns
        -------
        solved : dict
            Interval -> task of every agent, -1 where its part did not agree. Intervals that forbidden pairs leave
            without a full assignment are missing; which these are is taken to be known to the agents.
        agreed : ndarray of bool, shape (n,)
        """
        problems = interval_problems(outlook, self.lookahead, self.exact_intervals)
        if outlook.rules is not None:
            within = auctioned(outlook, problems, scene, self.epsilon, self.max_rounds)
            return within, np.ones(outlook.problem.n, dtype=bool)
        for interval in list(problems):
            reason = infeasible(problems[interval], scene)
            if reason:
                if interval == (outlook.k, outlook.k + 1):
                    raise InfeasibleError(f"step {outlook.k}: {reason}")
                del problems[interval]
        done = run_auctions(list(problems.values()), scene, self.epsilon, self.max_rounds)
        return dict(zip(problems, done.tasks, strict=True)), done.agreed


def _whole(solved: dict[Interval, IntArray], held: IntArray) -> dict[Interval, IntArray]:
    """Assignments of all agents: those whose part did not agree stay where they are."""
    return {interval: np.where(tasks < 0, held, tasks) for interval, tasks in solved.items()}


@dataclass(frozen=True)
class CentralHAALD:
    """The centralised twin of `HAALD`: the same interval problems and sequences, every interval solved exactly.

    Parameters
    ----------
    lookahead : int
    exact_intervals : bool
        See `sapopt.solvers.HAAL`.
    """

    lookahead: int = 3
    exact_intervals: bool = False

    takes: ClassVar[frozenset[str]] = EXTRAS

    def __post_init__(self) -> None:
        check_lookahead(self.lookahead)

    @property
    def name(self) -> str:
        """Name with options."""
        return f"CentralHAALD(L={self.lookahead})"

    def begin(self, problem: SAP, rng: np.random.Generator) -> None:
        """Nothing to remember."""
        return None

    def act(self, outlook: Outlook, memory: None) -> tuple[IntArray, None]:
        """Execute the first assignment of the best sequence of intervals."""
        solved = {}
        problems = interval_problems(outlook, self.lookahead, self.exact_intervals)
        for interval, matrix in problems.items():
            try:
                solved[interval] = outlook.alpha(matrix, *interval)
            except InfeasibleError:
                if interval == (outlook.k, outlook.k + 1):
                    raise
        cut, _ = best_sequence(
            outlook, reach(solved, outlook.k), solved, np.zeros(outlook.problem.n, dtype=np.int64)
        )
        return solved[outlook.k, int(cut[0])], None
