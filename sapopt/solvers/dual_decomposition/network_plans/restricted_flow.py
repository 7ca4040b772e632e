"""The part of the time-expanded network that near-optimal plans use, solved exactly.

With good prices one knows for every agent how much is lost, at least, if its path runs through a cell or along an arc:
its *reduced cost*, the best path minus the best path through it. Few cells have a small reduced cost. The network of
these cells, together with those of the incumbent, is a multi-commodity flow (`flow_programme` solves it). Since the
Lagrangian bound and the relaxation of this flow agree, it is nearly integral.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.jit import njit
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays, lookup, move_cost


@njit(cache=True, borrows=True, nogil=True)
def _candidates(rows, i, plan, first, last, parking, local, tasks):  # type: ignore[no-untyped-def]
    """Collect in ``tasks`` what agent i may use, the seen, the held and ``parking``; return how many.

    ``local`` (m,) maps a task to its place in ``tasks`` (-1: absent) and must come in as -1 everywhere.
    """
    indptr, indices, n = rows.indptr, rows.indices, rows.agents
    count = 0
    if first > 0:
        j = plan[first - 1, i]
        local[j], tasks[count] = count, j
        count += 1
    for k in range(first, last):
        j = plan[k, i]
        if local[j] < 0:
            local[j], tasks[count] = count, j
            count += 1
        for q in range(indptr[k * n + i], indptr[k * n + i + 1]):
            j = indices[q]
            if local[j] < 0:
                local[j], tasks[count] = count, j
                count += 1
    for j in parking:
        if local[j] < 0:
            local[j], tasks[count] = count, j
            count += 1
    return count


@njit(cache=True, borrows=True, nogil=True)
def marginals(rows, i, prices, first, last, before, after, local, tasks, benefit, forward, backward):  # type: ignore[no-untyped-def]
    """Fill forward[k - first, c] with the best priced path that ends on tasks[c] at step k, backward with what follows.

    ``benefit`` (length, len(tasks)) is filled with the agent's benefits. All work on the candidate ``tasks`` alone.
    """
    indptr, indices, data, n = rows.indptr, rows.indices, rows.data, rows.agents
    cost, idle_is_free = rows.cost, rows.idle_is_free
    m = len(tasks)
    by_pair = rows.matrix.shape[0] > 0
    for k in range(first, last):
        row = benefit[k - first]
        for c in range(m):
            row[c] = 0.0
        for q in range(indptr[k * n + i], indptr[k * n + i + 1]):
            if local[indices[q]] >= 0:
                row[local[indices[q]]] = data[q]
        now = forward[k - first]
        if k == first:
            for c in range(m):
                now[c] = row[c] - prices[k, tasks[c]] - move_cost(rows, before, tasks[c], row[c])
            continue
        old = forward[k - first - 1]
        best = -np.inf
        for c in range(m):
            best = max(best, old[c])
        for c in range(m):
            if by_pair:
                now[c] = -np.inf
                for a in range(m):
                    now[c] = max(now[c], old[a] - move_cost(rows, tasks[a], tasks[c], row[c]))
            else:
                now[c] = max(old[c], best - cost if row[c] > 0.0 or not idle_is_free else best)
            now[c] += row[c] - prices[k, tasks[c]]
    end = lookup(rows, last, i, after) if after >= 0 else 0.0
    for c in range(m):
        backward[last - 1 - first, c] = -move_cost(rows, tasks[c], after, end) if after >= 0 else 0.0
    for k in range(last - 2, first - 1, -1):
        row, now, later = benefit[k + 1 - first], backward[k - first], backward[k + 1 - first]
        best = -np.inf
        for c in range(m):
            now[c] = later[c] + row[c] - prices[k + 1, tasks[c]]
            best = max(best, now[c] - cost if row[c] > 0.0 or not idle_is_free else now[c])
        if by_pair:
            for a in range(m):
                now[a] = -np.inf
                for c in range(m):
                    gain = later[c] + row[c] - prices[k + 1, tasks[c]]
                    now[a] = max(now[a], gain - move_cost(rows, tasks[a], tasks[c], row[c]))
        else:
            for c in range(m):
                now[c] = max(now[c], best)


@njit(cache=True, nogil=True)
def _grown(array):  # type: ignore[no-untyped-def]
    bigger = np.empty(2 * len(array), array.dtype)
    for e in range(len(array)):  # for an array in a slice numba compiles seconds of error messages
        bigger[e] = array[e]
    return bigger


@njit(cache=True, nogil=True)
def near_optimal(rows, agents, plan, prices, initial, first, last, until, regret, parking, limit):  # type: ignore[no-untyped-def]
    """Return the cells and arcs of reduced cost at most ``regret`` and those of ``plan``.

    Cells are listed agent by agent and step by step: (agent, step, task); arcs: (tail, head, value), where a tail of -1
    is the start of an agent's path. ``parking`` (len(agents), r) lists tasks that an agent may use without seeing them.
    A price of +inf closes a cell. The lists end early once there are more than ``limit`` arcs. The paths whose values
    count end at ``until`` >= ``last``: where the plan is met again, or at the end of the horizon.
    """
    steps, m = prices.shape
    length = until - first
    forward, backward, benefit = np.empty((length, m)), np.empty((length, m)), np.empty((length, m))
    local, tasks = np.empty(m, np.int64), np.empty(m, np.int64)
    for j in range(m):  # one loop compiles in a fraction of the time of an expression of arrays
        local[j] = -1
    c_agent, c_step, c_task = np.empty(1024, np.int64), np.empty(1024, np.int64), np.empty(1024, np.int64)
    a_tail, a_head, a_value = np.empty(1024, np.int64), np.empty(1024, np.int64), np.empty(1024)
    cells = arcs = 0
    for order in range(len(agents)):
        if arcs > limit:
            break
        i = agents[order]
        before = initial[i] if first == 0 else plan[first - 1, i]
        after = plan[until, i] if until < steps else -1
        count = _candidates(rows, i, plan, first, until, parking[order], local, tasks)
        own = tasks[:count]
        marginals(rows, i, prices, first, until, before, after, local, own, benefit, forward, backward)
        best = -np.inf
        for c in range(count):
            best = max(best, forward[0, c] + backward[0, c])
        floor = max(best - regret, -1e300)  # never a forbidden cell
        old_from = old_to = cells
        for k in range(first, last):
            new_from = cells
            held = local[plan[k, i]]
            held_before = local[plan[k - 1, i]] if k > first else -1
            for c in range(count):
                if not forward[k - first, c] + backward[k - first, c] >= floor and held != c:
                    continue
                if cells == len(c_agent):
                    c_agent, c_step, c_task = _grown(c_agent), _grown(c_step), _grown(c_task)
                c_agent[cells], c_step[cells], c_task[cells] = i, k, c
                value = benefit[k - first, c]
                enter = value - prices[k, own[c]] + backward[k - first, c]
                end = backward[k - first, c] if k == last - 1 else 0.0
                for u in range(old_from, max(old_to, old_from + 1)):
                    if arcs == len(a_tail):
                        a_tail, a_head, a_value = _grown(a_tail), _grown(a_head), _grown(a_value)
                    if k == first:
                        a_tail[arcs] = -1
                        step = move_cost(rows, before, own[c], value)
                    else:
                        a = c_task[u]
                        step = move_cost(rows, own[a], own[c], value)
                        planned = held_before == a and held == c
                        if not forward[k - first - 1, a] - step + enter >= floor and not planned:
                            continue
                        a_tail[arcs] = u
                    a_head[arcs] = cells
                    a_value[arcs] = value - step + end
                    arcs += 1
                cells += 1
            for u in range(old_from, old_to):
                c_task[u] = own[c_task[u]]
            old_from, old_to = new_from, cells
        for u in range(old_from, old_to):
            c_task[u] = own[c_task[u]]
        for c in range(count):
            local[own[c]] = -1
    return (c_agent[:cells], c_step[:cells], c_task[:cells], a_tail[:arcs], a_head[:arcs], a_value[:arcs])


@dataclass(frozen=True)
class RestrictedFlow:
    """Cells and arcs of a window as a packing of agents' paths (see `near_optimal`)."""

    agent: IntArray
    step: IntArray
    task: IntArray
    tail: IntArray
    head: IntArray
    value: FloatArray


def restricted_flow(
    arrays: Arrays,
    plan: IntArray,
    prices: FloatArray,
    agents: IntArray,
    first: int,
    last: int,
    regret: float,
    parking: IntArray,
    limit: int = 2**62,
    until: int | None = None,
) -> RestrictedFlow:
    """Return the network of the cells of small reduced cost for ``agents`` in the window; the others keep their cells.

    Parameters
    ----------
    plan : (T, n)
        The incumbent; its cells and arcs are always part of the network.
    prices : (T, m)
        Prices of the cells.
    regret : float
        Loss against the best priced path up to which a cell or an arc is kept.
    parking : (len(agents), r)
        Tasks that an agent may use although it neither sees nor holds them.
    limit : int
        The network is left incomplete once it has more arcs than this.
    until : int
        Step at which the agents are back on the plan: the window's end, unless told otherwise. What follows the window
        until then is worth its priced best path, to which the prices alone keep the capacities.
    """
    return RestrictedFlow(
        *near_optimal(
            arrays.rows,
            agents,
            plan,
            open_prices(arrays, plan, prices, agents, first, last if until is None else until),
            arrays.initial,
            first,
            last,
            last if until is None else until,
            regret,
            parking,
            limit,
        )
    )


def open_prices(
    arrays: Arrays, plan: IntArray, prices: FloatArray, agents: IntArray, first: int, last: int
) -> FloatArray:
    """``prices`` (T, m), with +inf at the cells of the window that ``plan`` gives to others than ``agents``."""
    if len(agents) == arrays.agents:
        return prices
    prices = prices.copy()
    others = np.setdiff1d(np.arange(arrays.agents), agents)
    window = np.arange(first, last)
    prices[window[:, None], plan[window[:, None], others]] = np.inf
    return prices
