"""The sequential assignment problem."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.feasibility import explain_infeasible
from sapopt.data.files import Entry, read_npz, write_npz
from sapopt.data.types import FloatArray, IntArray, index_array
from sapopt.dynamics.base import Dynamics, Model, checked_handover
from sapopt.dynamics.capabilities import adapt
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.problem.description import described, fingerprint, rebuilt
from sapopt.problem.result import Evaluation

_FORMAT = "sapopt-problem-1"
_ENTRIES = {
    "dense": Entry("f", (None, None, None), optional=True),
    "indptr": Entry("iu", (None,), optional=True),
    "indices": Entry("iu", (None,), optional=True),
    "data": Entry("f", (None,), optional=True),
    "initial_assignment": Entry("iu", (None,), optional=True),
}
_MOST_BYTES = 64 * 2**30  # of the arrays of a file


class SAP:
    """A sequential assignment problem: n agents, m tasks, T steps, benefits that depend on the state.

    At each step every agent takes exactly one task and no task is taken twice; the value of a plan is the sum of the
    benefits and of the handover terms eta(s_k) of its pairs (thesis, eq. 1.3 and 3.4). Problems are immutable.

    Parameters
    ----------
    benefits : array_like of shape (T, n, m), list of T sparse matrices, or Benefits
        Static benefits, n <= m. ``-inf`` forbids a pair. Held sparse if at most half of the pairs are not zero,
        whatever form they come in (`Benefits.settled`).
    dynamics : Dynamics or float
        State model, for example ``SwitchingCost(0.5)``; a number is the cost of a `SwitchingCost`.
    initial_assignment : array_like of shape (n,), optional
        Task that every agent holds before the first step. None: the first step pays no handover.
    agents, tasks : sequence of str, optional
        Labels for plots and reports.

    Attributes
    ----------
    dynamics : Dynamics
        As it was passed.
    model : Model
        The same, bound to the benefits, with an answer to every question (`sapopt.dynamics.base.Model`).

    Raises
    ------
    ValueError
        If an argument has a wrong shape or value, or forbidden pairs leave a step without a full assignment.

    Examples
    --------
    >>> import numpy as np
    >>> problem = SAP(np.random.default_rng(0).random((6, 3, 4)), SwitchingCost(0.2))
    >>> problem
    SAP(T=6, n=3, m=4, SwitchingCost(cost=0.2, idle_is_free=False))
    """

    def __init__(
        self,
        benefits: Any,
        dynamics: Dynamics | float = 0.0,
        initial_assignment: Any = None,
        *,
        agents: Sequence[str] | None = None,
        tasks: Sequence[str] | None = None,
    ) -> None:
        self.benefits = Benefits(benefits).settled()
        self.T, self.n, self.m = self.benefits.shape
        if self.n > self.m:
            raise ValueError(
                f"benefits: {self.n} agents cannot each have one of {self.m} tasks; "
                "SAP.with_idle_tasks(benefits, ...) appends a zero-benefit task per agent"
            )
        if isinstance(dynamics, numbers.Real):
            dynamics = SwitchingCost(float(dynamics))
        self.dynamics = cast(Dynamics, dynamics)  # `adapt` checks that it is one
        self.initial_assignment = self._checked_initial(initial_assignment)
        self.agents = _labels(agents, self.n, "agents")
        self.tasks = _labels(tasks, self.m, "tasks")
        self.model: Model = adapt(dynamics, self)
        self._check_forbidden()

    @classmethod
    def with_idle_tasks(
        cls, benefits: Any, dynamics: Dynamics | float = 0.0, *args: Any, **kwargs: Any
    ) -> SAP:
        """Build a problem with one more task of zero benefit per agent, so that agents can idle (and n > m is allowed).

        The appended tasks have the indices ``m .. m + n - 1``; other arguments are those of `SAP`.
        """
        wide = Benefits(benefits).with_idle_tasks()
        labels = kwargs.get("tasks")
        if labels is not None:
            kwargs["tasks"] = [*labels, *(f"idle {i}" for i in range(wide.shape[1]))]
        return cls(wide, dynamics, *args, **kwargs)

    def __repr__(self) -> str:
        return f"SAP(T={self.T}, n={self.n}, m={self.m}, {self.dynamics!r})"

    def initial_state(self) -> Any:
        """State before the first step."""
        return self.model.initial_state(self)

    def handover(self, k: int, state: Any) -> FloatArray:
        """Handover matrix eta(s_k), shape ``(n, m)``."""
        return checked_handover(self.model.handover(k, state), k, self.n, self.m)

    def transition(self, k: int, state: Any, assignment: IntArray) -> Any:
        """State after `assignment` was held at step k."""
        return self.model.transition(k, state, assignment)

    def beta_hat(self, k: int, state: Any) -> FloatArray:
        """State-dependent benefits of step k, shape ``(n, m)``: benefits plus handover matrix (thesis, section 3.1)."""
        return dense_step(self.benefits.step(k)) + self.handover(k, state)

    def evaluate(self, plan: Any) -> Evaluation:
        """Score a plan.

        Parameters
        ----------
        plan : array_like of int, shape (T, n)
            Task of every agent at every step.

        Returns
        -------
        Evaluation

        Raises
        ------
        ValueError
            If the plan has a wrong shape, a task out of range, a task given to two agents, or a forbidden pair.
        """
        tasks = self.check_plan(plan)
        held = self.benefits.at(tasks)
        eta = np.empty((self.T, self.n))
        state = self.initial_state()
        for k in range(self.T):
            eta[k] = self.model.handover_at(k, state, tasks[k])
            state = self.transition(k, state, tasks[k])
        forbidden = np.argwhere(~(np.isfinite(held) & np.isfinite(eta)))
        if len(forbidden):
            k, i = (int(x) for x in forbidden[0])
            raise ValueError(
                f"plan: agent {i} may not take task {tasks[k, i]} at step {k} (the pair is forbidden)"
            )
        previous = (
            tasks[:-1]
            if self.initial_assignment is None
            else np.vstack([self.initial_assignment, tasks[:-1]])
        )
        handovers = int((tasks[len(tasks) - len(previous) :] != previous).sum())
        try:
            value = math.fsum(held.ravel()) + math.fsum(eta.ravel())
        except OverflowError:
            raise ValueError("benefits and handovers are so large that their sum overflows") from None
        return Evaluation(value, held.sum(axis=1), eta.sum(axis=1), handovers)

    def check_plan(self, plan: Any) -> IntArray:
        """The plan as an int64 array, or a ValueError that says what is wrong with it."""
        tasks = index_array(plan, "plan")
        if tasks.shape != (self.T, self.n):
            raise ValueError(f"plan must have shape (T, n) = {(self.T, self.n)}, got {tasks.shape}")
        self._check_tasks(tasks, 0)
        return tasks

    def check_assignment(self, assignment: Any, k: int) -> IntArray:
        """The assignment of step k as an int64 array, or a ValueError that says what is wrong with it."""
        tasks = index_array(assignment, f"assignment at step {k}")
        if tasks.shape != (self.n,):
            raise ValueError(f"assignment at step {k} must have shape (n,) = ({self.n},), got {tasks.shape}")
        self._check_tasks(tasks[None], k)
        return tasks

    def _check_tasks(self, tasks: IntArray, first: int) -> None:
        """Check the tasks (steps, n) of the steps from `first` on."""
        if tasks.min() < 0 or tasks.max() >= self.m:
            k, i = (int(x) for x in np.argwhere((tasks < 0) | (tasks >= self.m))[0])
            raise ValueError(
                f"plan: task {tasks[k, i]} of agent {i} at step {first + k} is outside 0..{self.m - 1}"
            )
        ordered = np.sort(tasks, axis=1)
        twice = np.argwhere(ordered[:, 1:] == ordered[:, :-1])
        if len(twice):
            k = int(twice[0, 0])
            task = int(ordered[k, twice[0, 1]])
            agents = ", ".join(map(str, np.flatnonzero(tasks[k] == task)))
            raise ValueError(f"plan: task {task} is given to agents {agents} at step {first + k}")

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of everything that decides the value of a plan; equal for dense and sparse forms of one problem.

        A user-defined dynamics tells what decides it by a method ``fingerprint()``: `sapopt.dynamics.base.Dynamics`.

        Raises
        ------
        ValueError
            If the dynamics is user-defined and does not tell.
        """
        shape = (self.T, self.n, self.m)
        return fingerprint(shape, self.benefits.flat(), self.initial_assignment, self.dynamics)

    def save(self, path: str | Path) -> None:
        """Write the problem to an ``.npz`` file (sparse or dense, as it is).

        Raises
        ------
        ValueError
            If the dynamics is user-defined: files hold data, never code.
        """
        meta, arrays = described(self.dynamics)
        meta |= {
            "format": _FORMAT,
            "agents": self.agents,
            "tasks": self.tasks,
            "shape": [self.T, self.n, self.m],
        }
        if self.benefits.is_sparse:
            flat = self.benefits.flat()
            arrays |= {"indptr": flat.indptr, "indices": flat.indices, "data": flat.data}
        else:
            arrays["dense"] = self.benefits.dense() + 0.0  # no negative zeros: equal problems, equal files
        if self.initial_assignment is not None:
            arrays["initial_assignment"] = self.initial_assignment
        write_npz(path, meta, arrays)

    @classmethod
    def load(cls, path: str | Path) -> SAP:
        """Read a problem written by `save`.

        Raises
        ------
        ValueError
            If the file is damaged or holds something else.
        """
        meta, arrays = read_npz(path, _FORMAT, _ENTRIES, _MOST_BYTES, prefix="dynamics.")
        try:
            if "dense" in arrays:
                benefits = Benefits(arrays["dense"])
            else:
                benefits = Benefits.from_flat(
                    arrays["indptr"], arrays["indices"], arrays["data"], meta["shape"]
                )
            return cls(
                benefits, rebuilt(meta, arrays), arrays.get("initial_assignment"),
                agents=meta["agents"], tasks=meta["tasks"],
            )  # fmt: skip
        except (KeyError, TypeError, OverflowError, MemoryError) as error:
            raise ValueError(f"{path}: damaged problem file ({error})") from None

    def _checked_initial(self, initial: Any) -> IntArray | None:
        if initial is None:
            return None
        tasks = index_array(initial, "initial_assignment")
        if tasks.shape != (self.n,):
            raise ValueError(f"initial_assignment must have shape (n,) = ({self.n},), got {tasks.shape}")
        if tasks.min() < 0 or tasks.max() >= self.m:
            raise ValueError(f"initial_assignment holds a task outside 0..{self.m - 1}")
        values, counts = np.unique(tasks, return_counts=True)
        if (counts > 1).any():
            raise ValueError(f"initial_assignment gives task {values[counts > 1][0]} to two agents")
        return tasks

    def _check_forbidden(self) -> None:
        if self.benefits.forbids():
            for k in range(self.T):
                reason = explain_infeasible(~np.isneginf(dense_step(self.benefits.step(k))))
                if reason:
                    raise ValueError(f"benefits at step {k}: {reason}; allow more pairs or append idle tasks")


def _labels(labels: Sequence[str] | None, count: int, name: str) -> tuple[str, ...] | None:
    if labels is None:
        return None
    if isinstance(labels, str) or not isinstance(labels, Iterable):
        raise ValueError(f"{name} must be a list of {count} labels, got {labels!r}")
    out = tuple(str(x) for x in labels)
    if len(out) != count:
        raise ValueError(f"{name}: {len(out)} labels for {count} {name}")
    for i, label in enumerate(out):
        try:
            label.encode()
        except UnicodeEncodeError:
            raise ValueError(
                f"{name}: label {i}, {label!r}, holds half a character, which no file can hold"
            ) from None
    return out
