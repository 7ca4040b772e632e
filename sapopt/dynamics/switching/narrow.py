"""Which entries a near-optimal path may use: the reduced cost of every (step, agent, task) at given prices.

The reduced cost of an entry is what the agent's best path loses when it must hold that task at that step. Under
log-sum-exp smoothing an entry of reduced cost r has weight exp(-r / temperature) at most. So once the prices are good
and the temperature is low, far fewer entries matter than are seen.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray
from sapopt.dynamics.switching.layout import Window
from sapopt.kernels.blocks import work_array
from sapopt.kernels.jit import njit


class NarrowScratch(NamedTuple):
    """Work arrays of `near_entries`, for at most S slots.

    Attributes
    ----------
    after : (T, S) float64
        Value of the steps after k for an agent that holds slot s at step k.
    enter : (T,) float64
        Value of the best way up to a step, less the cost of the move that begins the step.
    leave : (T + 1,) float64
        Value of the steps from b on, less the cost of the move that begins them; 0 at the end.
    now : (S,) float64
        The current step's row, of either recursion.
    """

    after: FloatArray
    enter: FloatArray
    leave: FloatArray
    now: FloatArray


def narrow_scratch(T: int, slots: int) -> tuple[NarrowScratch]:
    """Work arrays of one thread."""
    return (NarrowScratch(work_array((T, slots)), work_array(T), work_array(T + 1), work_array(slots)),)


@njit(cache=True, borrows=True, nogil=True)
def near_entries(begin, end, window, slots, prices, waiting, regret, near, scratch):
    """Mark in `near` (entries,) those of reduced cost at most `regret` under the strict rule, and the negative ones.

    The best path through slot s at step k is worth the best way there plus the best way on, ``now[s] + after[k, s]``:
    the first from the recursion of `strict_paths`, the second from its mirror image backwards in time.
    """
    n, indptr, data, cost = window.n, window.indptr, window.data, window.cost
    entry = slots.entry
    after, enter, leave, now = scratch.after, scratch.enter, scratch.leave, scratch.now
    T = prices.shape[0]
    for i in range(begin, end):
        tasks = slots.task[slots.ptr[i] : slots.ptr[i + 1]]
        S = tasks.size
        held = window.held[i]
        leave[T] = 0.0
        for s in range(S):
            now[s] = 0.0
        for k in range(T - 1, -1, -1):
            row = prices[k]
            for s in range(S):
                after[k, s] = now[s]
                now[s] -= row[tasks[s]]
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                now[entry[e]] += data[e]
            best = -np.inf
            for s in range(S):
                best = max(best, now[s])
            if waiting.shared:
                for b in range(k + 1, T + 1):
                    best = max(best, leave[b] - waiting.price[k, b])
            leave[k] = best - cost
            for s in range(S):
                now[s] = max(now[s], best - cost)
        first = -cost if held >= 0 else 0.0
        value = leave[0] + cost + first  # of the best path
        for s in range(S):
            now[s] = -np.inf
            if tasks[s] == held:
                now[s] = 0.0
                stay = after[0, s] - prices[0, held]
                for e in range(indptr[i], indptr[i + 1]):
                    if entry[e] == s:
                        stay += data[e]
                value = max(value, stay)
        best = 0.0
        for k in range(T):
            enter[k] = best - cost if k > 0 else first
            row = prices[k]
            for s in range(S):
                now[s] = max(now[s], enter[k]) - row[tasks[s]]
            r = k * n + i
            for e in range(indptr[r], indptr[r + 1]):
                now[entry[e]] += data[e]
            best = -np.inf
            for s in range(S):
                best = max(best, now[s])
            if waiting.shared:
                for a in range(k + 1):
                    best = max(best, enter[a] - waiting.price[a, k + 1])
            for e in range(indptr[r], indptr[r + 1]):
                s = entry[e]
                near[e] = data[e] < 0.0 or now[s] + after[k, s] >= value - regret


def kept_window(window: Window, near: NDArray[np.bool_]) -> Window:
    """The window with the marked entries alone."""
    before = np.concatenate([[0], np.cumsum(near, dtype=np.int64)])
    return window._replace(indptr=before[window.indptr], indices=window.indices[near], data=window.data[near])
