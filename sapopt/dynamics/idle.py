"""A dynamics with one place more, for agents that hold nothing."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import numpy as np

from sapopt.data.matrices import GainMatrix, Matrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.data.windows import WindowSums
from sapopt.dynamics.base import AgentColumns, Disturbed, Model, Setting
from sapopt.dynamics.paths.oracles import LocalModel


class IdlePlace(Model):
    """A model whose last task is idleness: going there is free, whatever the rule would charge.

    Taking up a task from there is what the rule says of taking it up from a task of no benefit: for a switching cost,
    a handover.

    Parameters
    ----------
    inner : Model
        Bound to benefits with a last task of zero benefit.
    place : int
        That task.
    """

    def __init__(self, inner: Model, place: int) -> None:
        self.inner = inner
        self.place = place
        self.handover_limit = None if inner.handover_limit is None else max(0.0, inner.handover_limit)
        self.handover_floor = inner.handover_floor

    def __repr__(self) -> str:
        return repr(self.inner)

    @property
    def called(self) -> str:
        """Of the rule itself."""
        return self.inner.called

    @property
    def interacts(self) -> bool:
        """As the rule."""
        return self.inner.interacts

    @property
    def is_agent_local(self) -> bool:
        """Whether the rule has a local model to widen."""
        return self.inner.is_agent_local

    def initial_state(self, problem: Setting) -> Any:
        """That of the rule."""
        return self.inner.initial_state(problem)

    def handover(self, k: int, state: Any) -> FloatArray:
        """The rule's, with a last column of zeros."""
        eta = np.array(self.inner.handover(k, state), dtype=np.float64)
        eta[:, -1] = 0.0
        return eta

    def handover_at(self, k: int, state: Any, assignment: IntArray) -> FloatArray:
        """The rule's, nothing for going idle."""
        if self.interacts:
            return super().handover_at(k, state, assignment)
        eta = np.asarray(self.inner.handover_at(k, state, assignment), dtype=np.float64)
        return np.where(assignment == self.place, 0.0, eta)

    def interval(self, windows: WindowSums, start: int, stop: int, state: Any) -> Matrix:
        """The window sum plus the handover at `start`; in sparse form where the rule has one and one cost."""
        rule = self.inner.switching()
        if rule is not None and rule.uniform_cost is not None and windows.is_sparse:
            found = self.inner.interval(windows, start, stop, state)
            if isinstance(found, GainMatrix):
                return self._resting(found)
        return super().interval(windows, start, stop, state)

    def _resting(self, matrix: GainMatrix) -> GainMatrix:
        """A matrix in which idleness is worth 0."""
        n = len(matrix.held)
        rests = np.flatnonzero(matrix.held != self.place)
        row = np.concatenate([np.repeat(np.arange(n), np.diff(matrix.row_start)), rests])
        task = np.concatenate([matrix.tasks, np.full(len(rests), self.place, dtype=matrix.tasks.dtype)])
        gain = np.concatenate([matrix.gains, np.full(len(rests), -matrix.rest)])
        order = np.lexsort((task, -gain, row))
        row_start = np.zeros(n + 1, dtype=np.int64)
        np.cumsum(np.bincount(row, minlength=n), out=row_start[1:])
        held_gain = np.where(matrix.held == self.place, -matrix.rest, matrix.held_gain)
        return replace(
            matrix, row_start=row_start, tasks=task[order], gains=gain[order], held_gain=held_gain,
            has_negative=bool(gain.min(initial=0.0) < 0),
        )  # fmt: skip

    def transition(self, k: int, state: Any, assignment: IntArray) -> Any:
        """That of the rule."""
        return self.inner.transition(k, state, assignment)

    def interaction(self, k: int, state: Any, assignments: IntArray) -> FloatArray:
        """That of the rule."""
        return self.inner.interaction(k, state, assignments)

    def disturbed(self) -> Disturbed | None:
        """The rule's; without the losses, idleness is a place of its own as well."""
        found = self.inner.disturbed()
        return None if found is None else found._replace(alone=IdlePlace(found.alone, self.place))

    def marginal(self, k: int, state: Any, activity: FloatArray) -> FloatArray:
        """That of the rule."""
        return self.inner.marginal(k, state, activity)

    def serves(self, k: int, state: Any, assignment: IntArray) -> np.ndarray:
        """That of the rule."""
        return self.inner.serves(k, state, assignment)

    def key(self, state: Any) -> Hashable:
        """That of the rule."""
        return self.inner.key(state)

    def agent_columns(self, state: Any) -> AgentColumns | None:
        """That of the rule."""
        return self.inner.agent_columns(state)

    def of_columns(self, columns: AgentColumns) -> Any:
        """That of the rule."""
        return self.inner.of_columns(columns)

    def local_model(self, benefits: Any, state: Any) -> LocalModel | None:
        """The rule's, with a last column of zeros."""
        states = self.inner.local_model(benefits, state)
        return None if states is None else _IdleStates(states)


class _IdleStates:
    """Local states whose last task costs nothing to go to."""

    def __init__(self, inner: LocalModel) -> None:
        self._inner = inner

    def state_count(self) -> int:
        """As many as before."""
        return self._inner.state_count()

    def start(self, agent: int) -> int:
        """The same."""
        return self._inner.start(agent)

    def step(self, k: int, agent: int, benefit: FloatArray) -> tuple[IntArray, FloatArray]:
        """The same, with a last column of zeros."""
        successor, handover = self._inner.step(k, agent, benefit)
        eta = np.array(np.broadcast_to(handover, np.shape(handover)), dtype=np.float64)
        eta[:, -1] = 0.0
        return successor, eta
