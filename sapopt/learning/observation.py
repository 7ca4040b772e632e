"""What an agent sees, for all agents at once: the observation of the thesis, and that of its published code.

Both list the M tasks that are best for the agent, by their benefit summed over the next L steps, and look at N other
agents, its neighbours. Layouts, with the numbers for M = N = 10 and L = 3:

`ThesisObservation`, section 6.2.2 of Holder (2024): 451 numbers with charges. The neighbours have the largest sum for
one of the M tasks.

=====================  =========  ==============================================================================
block                  numbers    content
=====================  =========  ==============================================================================
own benefits           M L        benefit of the M best tasks at each of the next L steps
neighbours' benefits   N M L      benefit of the N neighbours for those same tasks
previous tasks         (1 + N) M  1 where the task is the one that the agent, or the neighbour, held before
charges                1 + N      charge of the agent and of the neighbours; only where the state has one
=====================  =========  ==============================================================================

`ObservationSpec`, the published code's: 501 numbers with charges. The neighbours have the largest total of their sums
for the M tasks.

=====================  =========  ==============================================================================
block                  numbers    content
=====================  =========  ==============================================================================
own benefits           M L        as above
neighbours' benefits   N M L      as above
their other tasks      N (M/2) L  benefit of each neighbour for its M/2 best other tasks
previous task          M          1 where the task is the one that the agent held before
charges                1 + N      as above
=====================  =========  ==============================================================================

Absent tasks, neighbours and steps beyond the horizon are zeros; an agent that held none of the M tasks has zeros for
its previous task.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sapopt.data.benefits import Benefits, Flat
from sapopt.data.matrices import GainMatrix
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Model
from sapopt.solvers.base import check_lookahead


@dataclass(frozen=True)
class ObservationSpec:
    """Sizes of the published code's observation.

    Parameters
    ----------
    tasks : int
        M, the tasks an agent distinguishes; even.
    neighbours : int
        N.
    steps : int
        L, the steps it looks ahead.
    charge : bool
        Whether the observation ends with the charges.

    Raises
    ------
    ValueError
        If a size is not a whole number of at least 1, or `tasks` is odd.
    """

    tasks: int = 10
    neighbours: int = 10
    steps: int = 3
    charge: bool = True

    def __post_init__(self) -> None:
        for name in ("tasks", "neighbours", "steps"):
            check_lookahead(getattr(self, name), name)
        if self.tasks % 2:
            raise ValueError(
                f"tasks must be even, got {self.tasks}: half as many are shown of each neighbour"
            )

    @property
    def size(self) -> int:
        """Numbers in one observation."""
        M, N, L = self.tasks, self.neighbours, self.steps
        return M * L + N * M * L + N * (M // 2) * L + M + (N + 1 if self.charge else 0)

    @property
    def actions(self) -> int:
        """Outputs of a network: the M tasks, and any other task."""
        return self.tasks + 1

    def look(
        self, benefits: Benefits, k: int, model: Model, state: Any, step: int
    ) -> tuple[NDArray[np.float32], IntArray]:
        """Observations of all agents, see `Spec.look`.

        Raises
        ------
        ValueError
            If charges are to be observed and the dynamics has none, or the other way round.
        """
        return _look(benefits, k, model, state, self)


@dataclass(frozen=True)
class ThesisObservation:
    """Sizes of the observation of section 6.2.2 of Holder (2024).

    Parameters
    ----------
    tasks, neighbours : int
        M and N, 10 in the thesis.
    steps : int
        L; the thesis does not give it for chapter 6.
    charge : bool
        Whether the observation ends with the charges (section 6.4.1).

    Raises
    ------
    ValueError
        If a size is not a whole number of at least 1.

    Notes
    -----
    By the letter of the thesis an agent can be its own neighbour; here it never is, for its own numbers come first in
    any case.
    """

    tasks: int = 10
    neighbours: int = 10
    steps: int = 3
    charge: bool = True

    def __post_init__(self) -> None:
        for name in ("tasks", "neighbours", "steps"):
            check_lookahead(getattr(self, name), name)

    @property
    def size(self) -> int:
        """Numbers in one observation."""
        M, N, L = self.tasks, self.neighbours, self.steps
        return M * L + N * M * L + (1 + N) * M + (N + 1 if self.charge else 0)

    @property
    def actions(self) -> int:
        """Outputs of a network: the M tasks, and any other task."""
        return self.tasks + 1

    def look(
        self, benefits: Benefits, k: int, model: Any, state: Any, step: int
    ) -> tuple[NDArray[np.float32], IntArray]:
        """Observations of all agents, see `Spec.look`.

        Raises
        ------
        ValueError
            If charges are to be observed and the dynamics has none, or the other way round.
        """
        return _look(benefits, k, model, state, self)


def _look(
    benefits: Benefits, k: int, model: Any, state: Any, spec: ObservationSpec | ThesisObservation
) -> tuple[NDArray[np.float32], IntArray]:
    charge = charge_of(model, state)
    if spec.charge != (charge is not None):
        need = "needs a dynamics with charges" if spec.charge else "was made for problems without charges"
        raise ValueError(f"this observation {need}, not for {type(model).__name__}")
    return observe(benefits.flat(), benefits.shape, k, held_by(state), charge, spec)


@runtime_checkable
class Spec(Protocol):
    """What agents observe."""

    @property
    def size(self) -> int:
        """Numbers in one observation."""

    @property
    def tasks(self) -> int:
        """M, the most tasks that an agent can choose from."""

    @property
    def steps(self) -> int:
        """L, the steps that are looked at, the present one among them."""

    @property
    def actions(self) -> int:
        """M + 1: those tasks, and any other."""

    def look(
        self, benefits: Benefits, k: int, model: Model, state: Any, step: int
    ) -> tuple[NDArray[np.float32], IntArray]:
        """Observations of all agents.

        Parameters
        ----------
        benefits : Benefits
            What is known of the benefits; their step `k` is the present one.
        k : int
        model, state : object
            The dynamics and its present state.
        step : int
            Number of the present step in the problem.

        Returns
        -------
        observations : ndarray of float32, shape (n, size)
        listed : ndarray of int64, shape (n, M)
            Tasks that the first M outputs stand for; -1 for none.
        """


def charge_of(model: Model, state: Any) -> FloatArray | None:
    """Charges (n,) in a state, in parts of the capacity; None where the model knows no charge."""
    charge = model.charge_of(state)
    return None if charge is None else np.asarray(charge / model.capacity)


@runtime_checkable
class Holding(Protocol):
    """A state that shows the previous assignment."""

    @property
    def held(self) -> IntArray | None:
        """Tasks (n,); None before a first free step."""


def shows_assignment(state: Any) -> bool:
    """Whether a state shows the previous assignment, as the two observations of this module need."""
    return state is None or isinstance(state, (np.ndarray, Holding))


def held_by(state: Any) -> IntArray | None:
    """Previous assignment (n,) in a state of one of the library's dynamics; None before a first free step.

    Raises
    ------
    ValueError
        If the state does not show it.
    """
    if state is None or isinstance(state, np.ndarray):
        return state
    if not isinstance(state, Holding):
        raise ValueError(
            f"dynamics: a state of type {type(state).__name__} shows no previous assignment; this observation needs "
            "an array of tasks, or an attribute `held`. StateObservation.of(problem) needs neither"
        )
    return state.held


def observe(
    flat: Flat, shape: tuple[int, int, int], k: int, held: IntArray | None, charge: FloatArray | None,
    spec: ObservationSpec | ThesisObservation,
) -> tuple[NDArray[np.float32], IntArray]:  # fmt: skip
    """Observations of all agents at step k of `flat`.

    Parameters
    ----------
    flat : Flat
        Benefits of all steps that may be seen.
    shape : (T, n, m)
        Their shape.
    k : int
        Step, 0-based.
    held : ndarray of int64, shape (n,), or None
        Previous assignment.
    charge : ndarray of float64, shape (n,), or None
        Charges, in parts of the capacity; only if ``spec.charge``.
    spec : ObservationSpec or ThesisObservation

    Returns
    -------
    observations : ndarray of float32, shape (n, spec.size)
    tasks : ndarray of int64, shape (n, M)
        The tasks that the network's first M outputs stand for, -1 where there is none.
    """
    from sapopt.learning import observation_kernels as kernels

    T, n, m = shape
    out = np.zeros((n, spec.size), dtype=np.float32)
    tasks = kernels.observe(
        flat.indptr, flat.indices, flat.data, k, min(k + spec.steps, T), m,
        kernels.Layout(spec.tasks, spec.neighbours, spec.steps, isinstance(spec, ThesisObservation)),
        np.full(n, -1) if held is None else held,
        np.empty(0) if not spec.charge or charge is None else charge,
        out,
    )  # fmt: skip
    return out, tasks


def dense_values(q: Any, tasks: IntArray, m: int) -> FloatArray:
    """The matrix of Q-values (n, m) that `gain_matrix` stands for: ``q[i, M]`` for every task that is not listed."""
    n, M = tasks.shape
    values = np.repeat(np.asarray(q, dtype=np.float64)[:, M:], m, axis=1)
    agent, slot = np.nonzero(tasks >= 0)
    values[agent, tasks[agent, slot]] = np.asarray(q)[agent, slot]
    return values


def gain_matrix(q: Any, tasks: IntArray, m: int) -> GainMatrix:
    """The matrix of Q-values that alpha assigns, in sparse form.

    Parameters
    ----------
    q : ndarray, shape (n, M + 1)
        Values of the listed tasks, and of any other task.
    tasks : ndarray of int64, shape (n, M)
    m : int
        Number of tasks.

    Returns
    -------
    GainMatrix
        Entry (i, j) is ``q[i, s]`` if ``tasks[i, s] == j``, else ``q[i, M]``, up to a constant for every agent, which
        changes no assignment: each agent holds exactly one task.
    """
    from sapopt.learning.observation_kernels import alpha_rows

    values = np.asarray(q, dtype=np.float64)
    row_start, listed, gains, negative = alpha_rows(values, tasks)
    n = len(values)
    return GainMatrix(row_start, listed, gains, np.full(n, -1), np.zeros(n), 0.0, m, bool(negative))
