"""Benefits that depend on the other assignments: tasks that disturb each other when served together (section 7.2)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray, index_array, real_array
from sapopt.dynamics.base import AgentColumns, Disturbed, Model, Setting
from sapopt.dynamics.switching.model import Held, SwitchingCost

if TYPE_CHECKING:
    from sapopt.data.matrices import Matrix
    from sapopt.data.windows import WindowSums


@dataclass(frozen=True, eq=False)
class Interference(Model):
    """Pairs of tasks cost a loss when both are served at the same step, on top of a switching cost.

    A task is served where an agent of positive benefit holds it. The value of a step is
    ``sum of beta_hat - sum over pairs (a, b) of loss[a, b] [a is served] [b is served]``, a quadratic function of the
    assignment.

    Parameters
    ----------
    pairs : array_like of int, shape (P, 2)
        Neighbouring tasks; each pair once.
    loss : float or array_like of shape (P,)
        Loss of every pair, not negative.
    cost : float
        Cost of a handover, see `SwitchingCost`.
    idle_is_free : bool
        See `SwitchingCost`.

    Raises
    ------
    ValueError
        If an argument is out of range or a pair is listed twice.

    Notes
    -----
    Who knows of the interference: `SAP.evaluate`, `bound`, certificates, `Exact` (network and dp), `DualDecomposition`
    and `IteratedAssignment`. HAA, HAAL, Greedy and the distributed methods assign by beta_hat, which cannot hold it:
    their plans are valid and truly scored, and made blind, though HAAL knows of it where it compares its sequences by
    playing them. `DualLookahead` refuses. For prices every pair and step is a limit whose penalty is the loss
    (`sapopt.formulations.limited.disturbed`).
    """

    handover_limit = 0.0
    """Largest entry that the handover matrix can have."""

    pairs: IntArray
    loss: Any
    cost: float = 0.0
    idle_is_free: bool = False
    benefits: Benefits | None = field(default=None, repr=False, kw_only=True)

    def __post_init__(self) -> None:
        pairs = index_array(self.pairs, "pairs")
        if pairs.size == 0:
            pairs = pairs.reshape(0, 2)
        if pairs.ndim != 2 or pairs.shape[1] != 2 or (pairs < 0).any() or (pairs[:, 0] == pairs[:, 1]).any():
            raise ValueError("pairs must be a list of two different tasks each, shape (P, 2)")
        if len(np.unique(np.sort(pairs, axis=1), axis=0)) < len(pairs):
            raise ValueError("pairs: a pair is listed twice; add up its losses")
        loss = real_array(self.loss, "loss")
        if loss.ndim > 1 or (loss.ndim == 1 and len(loss) != len(pairs)):
            raise ValueError(f"loss must be a number or one for each of the {len(pairs)} pairs")
        if not np.isfinite(loss).all() or (loss < 0).any():
            raise ValueError("loss must be finite and not negative (it is subtracted)")
        if np.ndim(self.cost) != 0:
            raise ValueError("cost must be one number for all handovers")
        SwitchingCost(self.cost, self.idle_is_free)  # checks them
        object.__setattr__(self, "pairs", pairs)
        object.__setattr__(self, "loss", np.broadcast_to(loss, (len(pairs),)).copy())
        object.__setattr__(self, "cost", float(self.cost))

    def __repr__(self) -> str:
        return f"Interference({len(self.pairs)} pairs, cost={self.cost}, idle_is_free={self.idle_is_free})"

    def validate(self, problem: Setting) -> None:
        """Check that the pairs are pairs of the problem's tasks."""
        if len(self.pairs) and self.pairs.max() >= problem.m:
            raise ValueError(f"pairs hold task {self.pairs.max()}, but the benefits have {problem.m} tasks")

    def bind(self, benefits: Benefits) -> Interference:
        """A copy that knows the benefits."""
        return replace(self, benefits=benefits)

    def initial_state(self, problem: Setting) -> Held:
        """The initial assignment, or None."""
        return problem.initial_assignment

    def transition(self, k: int, state: Held, assignment: IntArray) -> Held:
        """The assignment itself."""
        return assignment

    def agent_columns(self, state: Held) -> AgentColumns | None:
        """As the switching rule."""
        return self._switching.agent_columns(state)

    def of_columns(self, columns: AgentColumns) -> Held:
        """As the switching rule."""
        return self._switching.of_columns(columns)

    def key(self, state: Held) -> bytes:
        """Fingerprint of a state."""
        return self._switching.key(state)

    def handover(self, k: int, state: Held) -> FloatArray:
        """Handover matrix, shape ``(n, m)``: the switching cost alone."""
        return self._switching.handover(k, state)

    def handover_at(self, k: int, state: Held, assignment: IntArray) -> FloatArray:
        """Switching cost and half the losses of its pairs for every agent under an assignment, shape ``(n,)``."""
        return self._switching.handover_at(k, state, assignment) + self.interaction(k, state, assignment)

    def interval(self, windows: WindowSums, start: int, stop: int, state: Held) -> Matrix:
        """Interval matrix of the switching cost, without the interference."""
        return self._switching.interval(windows, start, stop, state)

    @property
    def interacts(self) -> bool:
        """Always."""
        return True

    def interaction(self, k: int, state: Held, assignments: IntArray) -> FloatArray:
        """Minus half the losses of every agent's task, shape of `assignments` (..., n)."""
        rows = np.asarray(assignments).reshape(-1, np.shape(assignments)[-1])
        out = np.empty(rows.shape)
        agents, useful = np.arange(rows.shape[1]), self._useful(k)
        m = useful.shape[1]
        size = max(1, 4_000_000 // m)
        for first in range(0, len(rows), size):
            block = rows[first : first + size]
            serves = useful[agents, block]
            active = np.zeros((len(block), m))
            np.put_along_axis(active, block, serves.astype(np.float64), axis=1)
            disturbed = np.asarray((self._losses(m) @ active.T).T)
            share = np.take_along_axis(disturbed, block, axis=1)
            out[first : first + size] = -0.5 * np.where(serves, share, 0.0)
        return out.reshape(np.shape(assignments)) + 0.0

    def marginal(self, k: int, state: Held, activity: FloatArray) -> FloatArray:
        """Minus the losses (n, m) that a pair meets if the others serve the tasks with `activity` (n, m)."""
        useful = self._useful(k)
        disturbed = np.asarray((self._losses(useful.shape[1]) @ activity.T).T)
        return np.where(useful, -disturbed, 0.0)

    def serves(self, k: int, state: Held, assignment: IntArray) -> np.ndarray:
        """Whether every agent serves the task it holds at step k, shape ``(n,)``."""
        return np.asarray(self._useful(k)[np.arange(len(assignment)), assignment])

    def disturbed(self) -> Disturbed:
        """The pairs, their losses, and the switching cost."""
        return Disturbed(self.pairs, self.loss, self._switching)

    @cached_property
    def _switching(self) -> SwitchingCost:
        return SwitchingCost(self.cost, self.idle_is_free, benefits=self.benefits)

    def _useful(self, k: int) -> np.ndarray:
        if self.benefits is None:
            raise ValueError("this Interference belongs to no problem yet; ask problem.handover(k, state)")
        step = self.benefits.step(k)
        return np.asarray((step > 0) if isinstance(step, np.ndarray) else (step > 0).toarray())

    def _losses(self, m: int) -> sp.csr_array:
        """Symmetric matrix of the losses (m, m)."""
        a, b = self.pairs.T
        rows, columns = np.concatenate([a, b]), np.concatenate([b, a])
        return sp.csr_array((np.concatenate([self.loss, self.loss]), (rows, columns)), shape=(m, m))
