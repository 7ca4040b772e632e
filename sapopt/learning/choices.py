"""From the outputs that agents choose for themselves to tasks: the joint choice need not be an assignment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import IntArray
from sapopt.learning.observation_kernels import place_idle


def legal(listed: IntArray, m: int | None = None) -> NDArray[np.bool_]:
    """Mask (n, M + 1) of the outputs an agent may choose: the tasks it lists, and any other task.

    Given the number of tasks `m`, an agent that lists all of them has no other, and must choose one of its list.
    """
    others = np.ones((len(listed), 1), bool)
    if m is not None:
        others = (listed >= 0).sum(axis=1, keepdims=True) < m
    return np.concatenate([listed >= 0, others], axis=1)


def tasks_of(choices: IntArray, listed: IntArray, m: int) -> IntArray:
    """Task of every agent under a joint choice.

    Parameters
    ----------
    choices : ndarray of int64, shape (n,)
        Slot of a listed task, or M to idle.
    listed : ndarray of int64, shape (n, M)
    m : int

    Returns
    -------
    ndarray of int64, shape (n,)
        Listed tasks may have several holders. Idle agents take, in ascending index, the first task that nobody holds
        and that they do not list; where there is none, the first that nobody holds.

    Raises
    ------
    ValueError
        If a choice is out of range, or is a slot without a task.
    """
    n, M = listed.shape
    choices = np.asarray(choices, np.int64)
    if choices.shape != (n,) or choices.min() < 0 or choices.max() > M:
        raise ValueError(f"choices must be {n} whole numbers between 0 and {M}")
    chosen = np.where(choices < M, listed[np.arange(n), np.minimum(choices, M - 1)], -1)
    if (chosen[choices < M] < 0).any():
        agent = int(np.flatnonzero((choices < M) & (chosen < 0))[0])
        raise ValueError(
            f"choices: agent {agent} has no task in slot {choices[agent]}; mind the action mask, or idle ({M})"
        )
    return place_idle(chosen, listed, m)
