"""The arrays of the compiled recursions of `SwitchingCost`, by name."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray


class Window(NamedTuple):
    """Benefits and rule of n agents over T steps and m tasks; row ``k * n + i`` is agent i at step k.

    Attributes
    ----------
    n : int
    indptr : (T * n + 1,) int64
    indices : (entries,) int32
        Tasks, ascending inside a row.
    data : (entries,) float64
        Benefits; -inf forbids a pair.
    cost : float, or (m, m) float64
        Of a move; of the move from a task to another.
    held : (n,) int64
        Task before the first step, -1 if the first step is free.
    """

    n: int
    indptr: IntArray
    indices: NDArray[np.int32]
    data: FloatArray
    cost: Any
    held: IntArray


class Slots(NamedTuple):
    """The tasks for which an agent needs a place of its own under the strict rule: those it ever sees, or holds.

    Attributes
    ----------
    ptr : (n + 1,) int64
        Agent i has the slots ``ptr[i] .. ptr[i + 1] - 1``.
    task : (slots,) int32
        Ascending for each agent.
    entry : (entries,) int32
        Slot of every entry of the window, counted from its agent's first.
    """

    ptr: IntArray
    task: NDArray[np.int32]
    entry: NDArray[np.int32]


class Waiting(NamedTuple):
    """What waiting costs an agent on a task that it has no slot for, the same for all agents.

    Attributes
    ----------
    shared : bool
        Whether there are such tasks; else every task is a slot and the arrays have size 1.
    price : (T, T + 1) float64
        Least price of one task over the steps a .. b - 1.
    task : (T, T + 1) int32
        A task of that price.
    excluded : (m,) bool
        Tasks that may not be waited on, because somebody's benefit there is negative.
    """

    shared: bool
    price: FloatArray
    task: NDArray[np.int32]
    excluded: NDArray[np.bool_]
