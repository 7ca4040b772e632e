"""Dynamics given by one rule: what a task costs an agent in its own state, and which state follows.

`AgentLocal` derives everything else from the rule: handover matrices, transitions, sparse intervals for HAAL, the plain
local model that bounds are verified with, and the compiled path oracle for bounds and dual methods.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Self

import numpy as np

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import AgentColumns, Model, Setting
from sapopt.dynamics.paths.oracles import IDLE

if TYPE_CHECKING:
    from sapopt.data.matrices import Matrix
    from sapopt.data.windows import WindowSums
    from sapopt.dynamics.paths.arcs import ArcPaths


class LocalStates(NamedTuple):
    """State of all agents before a step.

    Attributes
    ----------
    step : int
        The step, 0-based, so that rules may depend on time.
    local : ndarray of int64, shape (n,)
        State of every agent, a number that only the rule reads.
    """

    step: int
    local: IntArray


@dataclass(frozen=True, eq=False)
class AgentLocal(Model):
    """Base of dynamics whose state splits into one whole number per agent; a subclass writes `start` and `rule`.

    Attributes
    ----------
    benefits : Benefits or None
        Those of the problem, put in by the problem itself.
    agents_alike : bool
        Class attribute: the rule does not look at `agent`. If all agents also have equal benefits, they share their
        path recursions, and a bound costs hardly more than that of a single agent. It counts for the `rule` of the
        class that says so, and no longer where a subclass has another.
    """

    benefits: Benefits | None = field(default=None, repr=False, kw_only=True)
    agents_alike = False
    idles_freely: ClassVar[bool] = True
    extended_by: ClassVar[frozenset[str]] = frozenset({"start", "rule", "agents_alike"})
    """All that is said here is derived by calling these."""

    @abstractmethod
    def start(self, problem: Setting) -> IntArray:
        """Local states (n,) before the first step."""

    @abstractmethod
    def rule(
        self, k: int, agent: IntArray, local: IntArray, task: IntArray, benefit: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """What happens when agents in local states take tasks at step k.

        Parameters
        ----------
        k : int
        agent, local, task, benefit : ndarray
            Equal shapes, one entry for every move. Where `benefit` is 0 the answer must be the same for all tasks (the
            agent idles), and `task` may be `IDLE`.

        Returns
        -------
        handover : ndarray
            Added to the benefit; -inf forbids the move. Idling may cost, but should never be forbidden.
        after : ndarray of int
            Local states that follow.
        """

    def by_rule(self) -> Self:
        """Itself."""
        return self

    def bind(self, benefits: Benefits) -> Self:
        """A copy that knows the benefits."""
        return replace(self, benefits=benefits)

    def initial_state(self, problem: Setting) -> LocalStates:
        """Step 0 and the agents' local states there."""
        return LocalStates(0, np.asarray(self.start(problem), dtype=np.int64))

    def handover(self, k: int, state: LocalStates) -> FloatArray:
        """Handover matrix, shape ``(n, m)``."""
        benefit = dense_step(self._bound().step(k))
        n, m = benefit.shape
        agent, task = (a.ravel() for a in np.indices((n, m)))
        eta, _ = self.rule(k, agent, state.local[agent], task, benefit.ravel())
        return np.asarray(eta, dtype=np.float64).reshape(n, m) + 0.0  # no negative zeros

    def handover_at(self, k: int, state: LocalStates, assignment: IntArray) -> FloatArray:
        """Handover of every agent under an assignment, shape ``(n,)``."""
        return self._move(k, state, assignment)[0]

    def transition(self, k: int, state: LocalStates, assignment: IntArray) -> LocalStates:
        """Local states after an assignment."""
        return LocalStates(k + 1, self._move(k, state, assignment)[1])

    def agent_columns(self, state: LocalStates) -> AgentColumns | None:
        """The agents' numbers, as they are: a rule whose numbers hold tasks or times has to take them apart.

        In a `sapopt.Session` steps count from the window's first one on, for `rule` as well.
        """
        return AgentColumns({}, {"local": state.local})

    def of_columns(self, columns: AgentColumns) -> LocalStates:
        """The agents' numbers before the first step of the benefits."""
        return LocalStates(0, columns.values["local"])

    def key(self, state: LocalStates) -> tuple[int, bytes]:
        """Fingerprint of a state."""
        return state.step, state.local.tobytes()

    def interval(self, windows: WindowSums, start: int, stop: int, state: LocalStates) -> Matrix:
        """Value of holding one assignment over ``start .. stop - 1``, every handover on the way counted."""
        from sapopt.data.matrices import GainMatrix

        n, m = windows.n, windows.m
        steps = [windows.slice(k, k + 1).flat() for k in range(start, stop)]
        keys = [np.repeat(np.arange(n), np.diff(flat.indptr)) * m + flat.indices for flat in steps]
        listed = np.unique(np.concatenate(keys))
        agent = np.concatenate([listed // m, np.arange(n)])  # every listed pair, then every agent idling
        task = np.concatenate([listed % m, np.full(n, IDLE)])
        local = state.local[agent]
        total = np.zeros(len(agent))
        for k, key, flat in zip(range(start, stop), keys, steps, strict=True):
            benefit = np.zeros(len(agent))
            benefit[np.searchsorted(listed, key)] = flat.data
            eta, local = self.rule(k, agent, local, task, benefit)
            total += benefit + eta
        idle = total[len(listed) :]
        if not np.isfinite(total).all():
            matrix = np.repeat(idle[:, None], m, axis=1)
            matrix[agent[: len(listed)], task[: len(listed)]] = total[: len(listed)]
            return matrix
        # What an agent gets for idling changes no assignment: gains count from there, and `rest` is the mean of it.
        gains = total[: len(listed)] - idle[agent[: len(listed)]]
        order = np.lexsort((task[: len(listed)], -gains, agent[: len(listed)]))
        row_start = np.concatenate([[0], np.cumsum(np.bincount(agent[: len(listed)], minlength=n))])
        return GainMatrix(
            row_start.astype(np.int64), task[order].astype(np.int32), gains[order], np.full(n, -1), np.zeros(n),
            float(idle.mean()), m, bool(len(gains) and gains.min() < 0),
        )  # fmt: skip

    def local_model(self, benefits: Benefits, state: LocalStates) -> ReachableStates:
        """The agents' finite states in plain form (a `sapopt.dynamics.paths.oracles.LocalModel`)."""
        return ReachableStates(self, benefits, state)

    def path_oracle(self, benefits: Benefits, state: LocalStates) -> ArcPaths:
        """Longest priced paths of the agents, compiled."""
        from sapopt.dynamics.capabilities import offers
        from sapopt.dynamics.paths.arcs import ArcPaths  # compiled code: imported when it is needed
        from sapopt.dynamics.rules.arcs_build import arc_graph

        return ArcPaths(arc_graph(self, benefits, state, self.agents_alike and offers(self, "agents_alike")))

    def _move(self, k: int, state: LocalStates, assignment: IntArray) -> tuple[FloatArray, IntArray]:
        benefit = self._bound().slice(k, k + 1).at(assignment[None])[0]
        eta, after = self.rule(k, np.arange(len(assignment)), state.local, assignment, benefit)
        return np.asarray(eta, dtype=np.float64), np.asarray(after, dtype=np.int64)

    def _bound(self) -> Benefits:
        if self.benefits is None:
            raise ValueError(
                f"this {type(self).__name__} belongs to no problem yet; ask problem.handover(k, state)"
            )
        return self.benefits


@dataclass(frozen=True, eq=False)
class ReachableStates:
    """The rule as a `LocalModel`: before every step, an agent's states are numbered in the order of their values.

    Only the states that the agent can be in at that step have a number, so it means another state at another step.
    Independent of the compiled graph, so that this can be tested and bounds be verified against it.
    """

    dynamics: AgentLocal
    window: Benefits
    state: LocalStates

    @cached_property
    def _states(self) -> list[list[IntArray]]:
        """For every agent the states before every step, ascending."""
        T, n, _ = self.window.shape
        out = []
        for i in range(n):
            layers = [self.state.local[i : i + 1]]
            for k in range(T):
                _, after, _ = self._moves(k, i, layers[k])
                layers.append(np.unique(after))
            out.append(layers)
        return out

    @cached_property
    def _count(self) -> int:
        return max(len(layer) for layers in self._states for layer in layers)

    def state_count(self) -> int:
        """The largest number of states that an agent can be in before a step."""
        return self._count

    def start(self, agent: int) -> int:
        """The only state there is before the first step."""
        return 0

    def step(self, k: int, agent: int, benefit: FloatArray) -> tuple[IntArray, FloatArray]:
        """Successor and handover, both (S, m); rows of states that cannot occur hold zeros."""
        here, onward = self._states[agent][k], self._states[agent][k + 1]
        eta, after, listed = self._moves(k, agent, here)
        S, m = self._count, self.window.shape[2]
        successor = np.zeros((S, m), dtype=np.int64)
        handover = np.zeros((S, m))
        places = np.searchsorted(onward, after)
        successor[: len(here)] = places[:, -1:]
        handover[: len(here)] = eta[:, -1:]
        successor[: len(here), listed] = places[:, :-1]
        handover[: len(here), listed] = eta[:, :-1]
        return successor, handover

    def _moves(self, k: int, i: int, states: IntArray) -> tuple[FloatArray, IntArray, IntArray]:
        """Handover and state after every listed task and after idling (states, listed + 1), and the listed tasks."""
        step = self.window.step(k)
        if isinstance(step, np.ndarray):
            listed = np.flatnonzero(step[i])
            benefit = step[i, listed]
        else:
            span = slice(step.indptr[i], step.indptr[i + 1])
            listed, benefit = step.indices[span].astype(np.int64), step.data[span]
        shape = (len(states), len(listed) + 1)
        tasks = np.broadcast_to(np.append(listed, IDLE), shape)
        local = np.broadcast_to(states[:, None], shape)
        gain = np.broadcast_to(np.append(benefit, 0.0), shape)
        eta, after = self.dynamics.rule(
            self.state.step + k, np.full(shape, i).ravel(), local.ravel(), tasks.ravel(), gain.ravel()
        )
        return np.asarray(eta, dtype=np.float64).reshape(shape), np.asarray(after).reshape(shape), listed
