"""What a problem refuses: labels, initial assignments and plans that do not fit, steps without any assignment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.benefits import dense_step
from sapopt.data.feasibility import explain_infeasible
from sapopt.data.types import IntArray, index_array
from sapopt.problem.capacity import overfull

if TYPE_CHECKING:
    from sapopt.problem.sap import SAP


def check_tasks(problem: SAP, tasks: IntArray, first: int) -> None:
    """Check the tasks (steps, n) of the steps from `first` on."""
    lowest = -1 if problem.idle else 0
    if tasks.min() < lowest or tasks.max() >= problem.m:
        k, i = (int(x) for x in np.argwhere((tasks < lowest) | (tasks >= problem.m))[0])
        hint = "; -1, for holding nothing, needs a problem with idle=True" if tasks[k, i] == -1 else ""
        raise ValueError(
            f"plan: task {tasks[k, i]} of {problem.naming.agent(i)} at {problem.naming.step(first + k)} is outside "
            f"{lowest}..{problem.m - 1}{hint}"
        )
    if problem.capacity is not None or problem.idle:
        _check_capacity(problem, tasks, first)
        return
    ordered = np.sort(tasks, axis=1)
    twice = np.argwhere(ordered[:, 1:] == ordered[:, :-1])
    if len(twice):
        k = int(twice[0, 0])
        task = int(ordered[k, twice[0, 1]])
        raise ValueError(f"plan: {_given(problem, task, tasks[k], first + k)}")


def _check_capacity(problem: SAP, tasks: IntArray, first: int) -> None:
    room = problem.capacity
    if room is None:
        room = np.ones((problem.T, problem.m), dtype=np.int64)
    over = overfull(tasks, room[first : first + len(tasks)])
    if over is not None:
        k, j = over
        most = room[first + k, j]
        more = "" if most == 1 else f"; its capacity is {most}"
        raise ValueError(f"plan: {_given(problem, j, tasks[k], first + k)}{more}")


def _given(problem: SAP, task: int, held: IntArray, k: int) -> str:
    """Who holds a task at a step, in words."""
    who = problem.naming.several(np.flatnonzero(held == task))
    return f"{problem.naming.task(task)} is given to {who} at {problem.naming.step(k)}"


def checked_initial(problem: SAP, initial: Any) -> IntArray | None:
    """The initial assignment as an int64 array (n,), None where there is none."""
    if initial is None:
        return None
    tasks = index_array(initial, "initial_assignment")
    if tasks.shape != (problem.n,):
        raise ValueError(f"initial_assignment must have shape (n,) = ({problem.n},), got {tasks.shape}")
    if tasks.min() < (-1 if problem.idle else 0) or tasks.max() >= problem.m:
        raise ValueError(
            f"initial_assignment holds a task outside {-1 if problem.idle else 0}..{problem.m - 1}"
        )
    values, counts = np.unique(tasks[tasks >= 0], return_counts=True)
    room = np.ones(problem.m, dtype=np.int64) if problem.capacity is None else problem.capacity.max(axis=0)
    over = np.flatnonzero(counts > room[values])
    if len(over):
        task_name, most = problem.naming.task(values[over[0]]), room[values[over[0]]]
        raise ValueError(
            f"initial_assignment gives {task_name} to two agents" if most == 1 else
            f"initial_assignment gives {task_name} to {counts[over[0]]} agents, its capacity is {most}"
        )  # fmt: skip
    return tasks


def check_forbidden(problem: SAP) -> None:
    """Refuse a step at which forbidden pairs leave no full assignment."""
    if problem.benefits.forbids():
        for k in range(problem.T):
            allowed = ~np.isneginf(dense_step(problem.benefits.step(k)))
            if problem.capacity is not None:
                allowed = np.repeat(allowed, np.minimum(problem.capacity[k], problem.n), axis=1)
            reason = explain_infeasible(allowed, problem.naming)
            if reason:
                raise ValueError(
                    f"benefits at {problem.naming.step(k)}: {reason}; allow more pairs or append idle tasks"
                )


def checked_labels(labels: Sequence[str] | None, count: int, name: str) -> tuple[str, ...] | None:
    """Labels as texts that every file can hold, None where there are none."""
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
