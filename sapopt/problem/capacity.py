"""How many agents may hold a task at a step."""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt.data.types import IntArray, index_array


def checked_capacity(capacity: Any, T: int, m: int) -> IntArray | None:
    """The capacities (T, m), or None where every task takes one agent at every step.

    Raises
    ------
    ValueError
        If they are no whole numbers of at least 0, or of a wrong shape.
    """
    if isinstance(capacity, (bool, np.bool_)):
        raise ValueError(f"capacity must be whole numbers, got {capacity!r}")
    try:
        counts = index_array(capacity, "capacity")
    except ValueError as error:
        raise ValueError(f"{str(error).replace(' (indices of tasks)', '')}; 0 closes a task") from None
    if counts.ndim == 0 and counts == 1:
        return None
    if counts.shape not in ((), (m,), (T, m)):
        raise ValueError(
            f"capacity must be a number, or have shape (m,) = ({m},) or (T, m) = {(T, m)}, got {counts.shape}"
        )
    if (counts < 0).any():
        raise ValueError(f"capacity must not be negative, got {counts.min()}; 0 closes a task")
    if (counts == 1).all():
        return None
    return np.broadcast_to(counts, (T, m)).copy()


def check_room(capacity: IntArray | None, T: int, n: int, m: int) -> None:
    """Refuse a step at which the tasks have no room for all agents, where all must hold one.

    Raises
    ------
    ValueError
        If there is such a step.
    """
    if capacity is None:
        if n > m:
            raise ValueError(
                f"benefits: {n} agents cannot each have one of {m} tasks; pass idle=True, raise capacity=, or let "
                "SAP.with_idle_tasks(benefits, ...) append a zero-benefit task per agent"
            )
        return
    room = np.minimum(capacity, n).sum(axis=1)
    short = np.flatnonzero(room < n)
    if len(short):
        k = int(short[0])
        raise ValueError(
            f"capacity: at step {k} the tasks have room for {room[k]} of {n} agents; raise it or pass idle=True"
        )


def overfull(tasks: IntArray, capacity: IntArray) -> tuple[int, int] | None:
    """The first step (of the rows) and task that more agents hold than may, or None.

    Parameters
    ----------
    tasks : ndarray of int64, shape (steps, n)
        -1 holds nothing.
    capacity : ndarray of int64, shape (steps, m)
    """
    steps, m = capacity.shape
    flat = (np.arange(steps)[:, None] * (m + 1) + np.where(tasks < 0, m, tasks)).ravel()
    held = np.bincount(flat, minlength=steps * (m + 1)).reshape(steps, m + 1)[:, :m]
    over = np.argwhere(held > capacity)
    return (int(over[0, 0]), int(over[0, 1])) if len(over) else None
