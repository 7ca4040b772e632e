"""The two greedy rules: the thesis' GA, which serves a task until it is out of view, and the one that chooses anew."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sapopt.data.benefits import StepMatrix, dense_step
from sapopt.data.matrices import GainMatrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook
from sapopt.solvers.base import EXTRAS
from sapopt.solvers.limited.greedy import dearest_first, greedily_chosen, greedily_held


@dataclass(frozen=True)
class Greedy:
    """The greedy algorithm GA (thesis, section 4.1): serve a task until it is out of view, then take the best one.

    A task is in view of an agent while its benefit is positive. An agent that holds a task in view keeps it; the
    others choose, in ascending index, the free task of greatest benefit in their view. An agent that finds none keeps
    what it held if nobody took it, and waits on the lowest-numbered free task otherwise; about these the thesis says
    nothing. Handovers are charged, but the rule does not look at them. Where forbidden pairs leave a waiting agent
    without a task, as many of the choices as possible are kept.

    References
    ----------
    J. Holder, MSc thesis, University of Washington, 2024, section 4.1, "Greedy (GA)".
    """

    takes: ClassVar[frozenset[str]] = EXTRAS

    @property
    def name(self) -> str:
        """Name."""
        return "Greedy"

    def begin(self, problem: SAP, rng: np.random.Generator) -> IntArray | None:
        """The tasks that are held before the first step, or None."""
        return problem.initial_assignment

    def act(self, outlook: Outlook, memory: IntArray | None) -> tuple[IntArray, IntArray]:
        """Keep what is in view, choose the best for the others."""
        if outlook.rules is not None:
            kept = greedily_held(outlook, memory)
            return kept, kept
        step = outlook.benefits(1).step(0)
        allowed = _allowed(outlook)
        n, m = outlook.problem.n, outlook.problem.m
        chosen = np.full(n, -1)
        is_taken = np.zeros(m, dtype=bool)
        if memory is not None:
            in_view = (outlook.benefits(1).at(memory[None])[0] > 0) & (memory >= 0)
            chosen[in_view] = memory[in_view]
            is_taken[memory[in_view]] = True
        for i in np.flatnonzero(chosen < 0):
            tasks, benefit = _view(step, int(i))
            free = ~is_taken[tasks] & (benefit > 0)
            if free.any():
                chosen[i] = tasks[free][np.argmax(benefit[free])]
                is_taken[chosen[i]] = True
        if not _wait(chosen, is_taken, memory, allowed, outlook.parking):
            chosen = _repaired(chosen, allowed, outlook)
        return chosen, chosen


@dataclass(frozen=True)
class MyopicGreedy:
    """Greed without memory: at every step agents choose in ascending index, the best free task of beta_hat each.

    An agent without a free task of positive gain over idling keeps its task if it is free and good, else it waits
    like an idle agent of alpha. The initial assignment counts: its agents pay for leaving their tasks. Unlike
    `Greedy`, an agent leaves a task in its view as soon as another one is worth more than the handover.
    """

    takes: ClassVar[frozenset[str]] = EXTRAS

    @property
    def name(self) -> str:
        """Name."""
        return "MyopicGreedy"

    def begin(self, problem: SAP, rng: np.random.Generator) -> None:
        """Nothing to remember."""
        return None

    def act(self, outlook: Outlook, memory: None) -> tuple[IntArray, None]:
        """Choose agent by agent from beta_hat of the current step."""
        matrix = outlook.beta_hat()
        if outlook.rules is not None:
            return greedily_chosen(outlook, matrix), None
        if isinstance(matrix, GainMatrix):
            return _myopic_sparse(matrix, outlook), None
        return _myopic_dense(matrix, outlook), None


def _view(step: StepMatrix, agent: int) -> tuple[IntArray, FloatArray]:
    """Tasks that may be worth something to an agent, ascending, and their benefits."""
    if isinstance(step, np.ndarray):
        return np.arange(step.shape[1]), step[agent]
    span = slice(step.indptr[agent], step.indptr[agent + 1])
    return step.indices[span].astype(np.int64), step.data[span]


def _allowed(outlook: Outlook) -> np.ndarray | None:
    """Pairs (n, m) that are not forbidden; None where all are allowed."""
    matrix = outlook.beta_hat()
    if isinstance(matrix, GainMatrix):
        return None if np.isfinite(matrix.gains).all() else np.isfinite(matrix.toarray())
    allowed = np.isfinite(matrix)
    return None if allowed.all() else allowed


def _wait(
    chosen: IntArray, is_taken: np.ndarray, held: IntArray | None, allowed: np.ndarray | None, order: IntArray
) -> bool:
    """Give every agent that chose nothing a task to wait on, in place; False where one finds none."""
    waiting = np.flatnonzero(chosen < 0)
    if held is not None:
        for i in waiting:
            if held[i] >= 0 and not is_taken[held[i]] and (allowed is None or allowed[i, held[i]]):
                chosen[i] = held[i]
                is_taken[held[i]] = True
        waiting = np.flatnonzero(chosen < 0)
    free = order[~is_taken[order]]
    if allowed is None:
        chosen[waiting] = free[: len(waiting)]
        return True
    if not allowed[chosen >= 0, chosen[chosen >= 0]].all():
        return False
    for i in waiting:
        open_to = np.flatnonzero(allowed[i, free])
        if not len(open_to):
            return False
        chosen[i] = free[open_to[0]]
        free = np.delete(free, open_to[0])
    return True


def _repaired(chosen: IntArray, allowed: np.ndarray | None, outlook: Outlook) -> IntArray:
    """A full assignment of allowed pairs that keeps as many of the choices as possible, the dearest ones first."""
    benefit = dense_step(outlook.benefits(1).step(0))
    assert allowed is not None
    kept = np.where(allowed, 0.0, -np.inf)
    picked = np.flatnonzero(chosen >= 0)
    picked = picked[allowed[picked, chosen[picked]]]
    kept[picked, chosen[picked]] = 1.0 + dearest_first(benefit[picked, chosen[picked]])
    return outlook.assign(kept)


def _myopic_sparse(matrix: GainMatrix, outlook: Outlook) -> IntArray:
    from sapopt.kernels.matching import greedy, park

    rows = (matrix.row_start, matrix.tasks, matrix.gains, matrix.held, matrix.held_gain)
    chosen, owner = greedy(*rows, matrix.m)
    if park(*rows, chosen, owner, outlook.parking, matrix.has_negative):
        return chosen
    return _myopic_dense(matrix.toarray(), outlook)


def _myopic_dense(matrix: np.ndarray, outlook: Outlook) -> IntArray:
    open_tasks = np.ones(matrix.shape[1], dtype=bool)
    chosen = np.empty(matrix.shape[0], dtype=np.int64)
    for i, row in enumerate(matrix):
        values = np.where(open_tasks, row, -np.inf)
        chosen[i] = int(np.argmax(values))
        if values[chosen[i]] == -np.inf:
            # An earlier agent took the only allowed task of this one: greed alone has no full assignment here.
            return outlook.assign(matrix)
        open_tasks[chosen[i]] = False
    return chosen
