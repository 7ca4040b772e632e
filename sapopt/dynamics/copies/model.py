"""Switching costs for copies: of agents that do several tasks at once, and of tasks that take several agents."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Benefits, StepMatrix, dense_step
from sapopt.data.types import FloatArray, IntArray, index_array, real_array
from sapopt.dynamics.base import AgentColumns, Entering, Model, Setting

if TYPE_CHECKING:
    from sapopt.data.matrices import Matrix
    from sapopt.data.windows import WindowSums
    from sapopt.dynamics.copies.groups import GroupPaths
    from sapopt.dynamics.copies.paths import SyntheticPaths

Held = IntArray | None
"""State: the real task that every agent held, -1 for none that counts; None before a first step that pays nothing."""


@dataclass(frozen=True, eq=False)
class SyntheticSwitching(Model):
    """Charge an agent for a task unless its real agent held the same real task at the step before.

    Agent i is a copy of the real agent ``agent_of[i]``, task j one of the real task ``task_of[j]``. A pair pays
    nothing if some copy of the real agent held some copy of the real task; else it pays
    ``cost + forfeit * max(beta, 0)``. With neither copies nor `forfeit` this is `SwitchingCost`.

    Parameters
    ----------
    cost : float
        Cost of a handover; not negative.
    forfeit : float
        Share of the benefit that is lost at the step of the move, 0 to 1. With 1 a task earns only where it was held
        before (thesis, eq. 4.3: an object is tracked from the second step on).
    agent_of : array_like of int, shape (n,), optional
        Real agent of every agent (thesis, section 4.4: the beams of a satellite); each its own if omitted.
    task_of : array_like of int, shape (m,), optional
        Real task of every task (section 4.3: the observers of a region); each its own if omitted.
    idle_is_free : bool
        Charge only pairs of positive benefit.
    needs_sight : bool
        A task counts as held only while its benefit is positive: what an agent cannot see it cannot acquire. Whether a
        benefit is positive must then be known ahead (visibility, not demand).

    Raises
    ------
    ValueError
        If an argument is out of range or of a wrong shape.

    Notes
    -----
    Without copies of agents the state is local to the agents, and the model has a `path_oracle` and a `local_model`.
    With copies of agents it is local to the real agents only. The paths of `sapopt.dynamics.copies.groups` bound what
    such a group is worth, and there is no `local_model`.
    """

    handover_limit = 0.0
    """Largest entry that the handover matrix can have."""

    cost: float = 0.0
    forfeit: float = 0.0
    agent_of: IntArray | None = None
    task_of: IntArray | None = None
    idle_is_free: bool = False
    needs_sight: bool = False
    benefits: Benefits | None = field(default=None, repr=False, kw_only=True)

    def __post_init__(self) -> None:
        for name, most in (("cost", np.inf), ("forfeit", 1.0)):
            number = real_array(getattr(self, name), name)
            if number.ndim or not np.isfinite(number) or not 0 <= number <= most:
                limit = "finite and not negative" if most == np.inf else f"between 0 and {most:g}"
                raise ValueError(f"{name} must be a number, {limit}; got {getattr(self, name)!r}")
            object.__setattr__(self, name, float(number))
        for name in ("agent_of", "task_of"):
            if getattr(self, name) is not None:
                labels = index_array(getattr(self, name), name)
                if labels.ndim != 1 or not len(labels) or labels.min() < 0:
                    raise ValueError(f"{name} must be a list of numbers from 0 on, got shape {labels.shape}")
                object.__setattr__(self, name, labels)
        for name in ("idle_is_free", "needs_sight"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise ValueError(f"{name} must be True or False, got {getattr(self, name)!r}")

    def __repr__(self) -> str:
        said = [f"cost={self.cost}"] + [f"forfeit={self.forfeit}"] * bool(self.forfeit)
        if self.agent_of is not None:
            said.append(f"{len(np.unique(self.agent_of))} real agents")
        if self.task_of is not None:
            said.append(f"{len(np.unique(self.task_of))} real tasks")
        said += [f"{name}=True" for name in ("idle_is_free", "needs_sight") if getattr(self, name)]
        return f"SyntheticSwitching({', '.join(said)})"

    def validate(self, problem: Setting) -> None:
        """Check that the labels fit the numbers of agents and tasks."""
        for name, count, what in (("agent_of", problem.n, "agents"), ("task_of", problem.m, "tasks")):
            labels = getattr(self, name)
            if labels is not None and len(labels) != count:
                raise ValueError(f"{name} has {len(labels)} labels, but the benefits have {count} {what}")

    def bind(self, benefits: Benefits) -> SyntheticSwitching:
        """A copy that knows the benefits."""
        return replace(self, benefits=benefits)

    def initial_state(self, problem: Setting) -> Held:
        """Real tasks of the initial assignment, or None."""
        start = problem.initial_assignment
        return None if start is None else np.where(start >= 0, self.real_tasks(problem.m)[start], -1)

    def transition(self, k: int, state: Held, assignment: IntArray) -> Held:
        """Real tasks of the assignment, -1 where `needs_sight` and nothing is seen."""
        return self.held_after(self._bound().slice(k, k + 1), assignment)

    def held_after(self, first: Benefits, assignment: IntArray) -> IntArray:
        """The same for the step that `first` begins with."""
        held = self.real_tasks(first.shape[2])[assignment]
        if self.needs_sight:
            held = np.where(first.slice(0, 1).at(assignment[None])[0] > 0, held, -1)
        return held

    def key(self, state: Held) -> bytes:
        """Fingerprint of a state: it does not matter which copy of an agent held what."""
        if state is None:
            return b""
        if self.agent_of is None:
            return state.tobytes()
        return state[np.lexsort((state, self.agent_of))].tobytes()

    def agent_columns(self, state: Held) -> AgentColumns | None:
        """What every agent held; real tasks keep their numbers where the user gives these."""
        if state is None:
            return None
        held = {"held": state}
        return AgentColumns(held, {}) if self.task_of is None else AgentColumns({}, held)

    def of_columns(self, columns: AgentColumns) -> Held:
        """What every agent held."""
        return np.asarray((columns.tasks | columns.values)["held"])

    def handover(self, k: int, state: Held) -> FloatArray:
        """Handover matrix, shape ``(n, m)``; zero if `state` is None."""
        return self.charges(self._bound().step(k), state)

    def handover_at(self, k: int, state: Held, assignment: IntArray) -> FloatArray:
        """Handover of every agent under an assignment, shape ``(n,)``."""
        if state is None:
            return np.zeros(len(assignment))
        n, m = self._bound().shape[1:]
        group, task = self.real_agents(n), self.real_tasks(m)
        width = int(task.max()) + 1
        free = np.isin(group * width + task[assignment], (group * width + state)[state >= 0])
        charge = self._charge(self._bound().slice(k, k + 1).at(assignment[None])[0])
        return np.where(free, 0.0, -charge) + 0.0

    def interval(self, windows: WindowSums, start: int, stop: int, state: Held) -> Matrix:
        """Benefit of holding one assignment over ``start .. stop - 1``: window sum plus the handover at `start`."""
        if windows.is_sparse:
            total = sp.csr_array(windows.slice(start, stop).window(0, stop - start))
            if not np.isneginf(total.data).any():
                return self._sparse_interval(
                    total, sp.csr_array(windows.slice(start, start + 1).step(0)), state
                )
        first = windows.slice(start, start + 1).step(0)
        return windows.dense(start, stop) + self.charges(first, state)

    @property
    def is_agent_local(self) -> bool:
        """Whether no agent has copies: each one's state is its own."""
        return self.agent_of is None or len(np.unique(self.agent_of)) == len(self.agent_of)

    @property
    def has_places(self) -> bool:
        """Whether agents have copies, whose places then have prices, too (`sapopt.dynamics.copies.groups`)."""
        return not self.is_agent_local

    def path_oracle(self, benefits: Benefits, state: Held) -> SyntheticPaths | GroupPaths:
        """Longest priced paths of the agents (`sapopt.dynamics.paths.oracles.PathOracle`)."""
        if not self.is_agent_local:
            from sapopt.dynamics.copies.groups import GroupPaths

            return GroupPaths.of(benefits, self, state)
        from sapopt.dynamics.copies.paths import SyntheticPaths

        return SyntheticPaths(benefits, self, state)

    def local_model(self, benefits: Benefits, state: Held) -> SyntheticStates | None:
        """The same in plain words (`sapopt.dynamics.paths.oracles.LocalModel`)."""
        return SyntheticStates(self, int(benefits.shape[2]), state) if self.is_agent_local else None

    def entering(self) -> Entering | None:
        """The parameters, if there are no copies."""
        if self.agent_of is not None or self.task_of is not None:
            return None
        return Entering(self.cost, self.forfeit, self.idle_is_free, self.needs_sight)

    def copies(self) -> SyntheticSwitching | None:
        """Itself, if there are copies of agents."""
        return self if self.has_places else None

    def real_agents(self, n: int) -> IntArray:
        """Real agent of every one of n agents."""
        return np.arange(n) if self.agent_of is None else self.agent_of

    def real_tasks(self, m: int) -> IntArray:
        """Real task of every one of m tasks."""
        return np.arange(m) if self.task_of is None else self.task_of

    def _charge(self, benefit: FloatArray) -> FloatArray:
        """What entering pairs of these benefits costs."""
        charge = self.cost + self.forfeit * np.maximum(benefit, 0.0)
        return np.where(benefit > 0, charge, 0.0) if self.idle_is_free else charge

    def _free_pairs(self, n: int, m: int, state: IntArray) -> sp.csr_array:
        """Ones (n, m) where the real agent held the real task, sparse."""
        group, task = self.real_agents(n), self.real_tasks(m)
        groups, width = int(group.max()) + 1, int(task.max()) + 1
        pairs = np.unique(group[state >= 0] * width + state[state >= 0])
        holds = sp.csr_array(
            (np.ones(len(pairs)), (pairs // width, pairs % width)), shape=(groups, width)
        )  # real agents, real tasks
        copies = sp.csr_array((np.ones(m), (task, np.arange(m))), shape=(width, m))
        return sp.csr_array((holds @ copies)[group])

    def charges(self, step: StepMatrix, state: Held) -> FloatArray:
        """Handover matrix, shape ``(n, m)``, of a step with these benefits."""
        n, m = step.shape
        if state is None:
            return np.zeros((n, m))
        free = self._free_pairs(n, m, state).toarray() > 0
        return np.where(free, 0.0, -self._charge(dense_step(step))) + 0.0

    def _sparse_interval(self, total: sp.csr_array, first: sp.csr_array, state: Held) -> Matrix:
        from sapopt.data.matrices import GainMatrix

        if state is None:
            return GainMatrix.from_matrix(total)
        rest = 0.0 if self.idle_is_free else -self.cost  # of a pair that is worth nothing and was not held
        charge = first.copy()
        charge.data = self._charge(first.data) + rest
        free = self._free_pairs(total.shape[0], total.shape[1], state)
        gain = sp.csr_array(total - charge + charge * free - rest * free)
        gain.eliminate_zeros()
        found = GainMatrix.from_matrix(gain)
        return replace(found, rest=rest)

    def _bound(self) -> Benefits:
        if self.benefits is None:
            raise ValueError(
                "this SyntheticSwitching belongs to no problem yet; ask problem.handover(k, state)"
            )
        return self.benefits


@dataclass(frozen=True, eq=False)
class SyntheticStates:
    """The local state of an agent is the real task it held, R for none, R + 1 before a free first step."""

    dynamics: SyntheticSwitching
    m: int
    held: Held

    @property
    def _real(self) -> int:
        return int(self.dynamics.real_tasks(self.m).max()) + 1

    def state_count(self) -> int:
        """Every real task, none, and the free start."""
        return self._real + 2

    def start(self, agent: int) -> int:
        """Local state before the first step."""
        if self.held is None:
            return self._real + 1
        return int(self.held[agent]) if self.held[agent] >= 0 else self._real

    def step(self, k: int, agent: int, benefit: FloatArray) -> tuple[IntArray, FloatArray]:
        """Successor and handover, both (R + 2, m)."""
        task = self.dynamics.real_tasks(self.m)
        counts = benefit > 0 if self.dynamics.needs_sight else np.ones(self.m, dtype=bool)
        successor = np.where(counts, task, self._real)
        states = np.arange(self.state_count())[:, None]
        free = (states == task) | (states == self._real + 1)
        eta = np.where(free, 0.0, -self.dynamics._charge(np.where(np.isfinite(benefit), benefit, 0.0)))
        return np.broadcast_to(successor, eta.shape), eta
