"""HAAL's search tree of one step, compiled, for sparse benefits and one switching cost.

A node is a state (an assignment) at the start of an interval. Solving an interval from a node gives an assignment, which
is the state of a node at the interval's end; equal states of one step are one node. The nodes stay until their step is
past, with what was solved from them, so that the next search only has to solve what is new.

Steps are stored in rings: the nodes of step a at ``a % (L + 1)``, window [a, b) in slot ``(a % L) * L + b - a - 1``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from sapopt.kernels.matching import assign_and_park
from sapopt.kernels.windows import listed_gain, longer_window

OPEN = -1  # instead of a child: not solved yet
_TIE = 1e-12


class Windows(NamedTuple):
    """Window sums as rows sorted by decreasing gain, one window a slot."""

    row_start: np.ndarray  # (L * L, n + 1)
    tasks: np.ndarray  # (L * L, capacity)
    gains: np.ndarray  # (L * L, capacity)
    negative: np.ndarray  # (L * L,) whether a gain is negative


class Nodes(NamedTuple):
    """States at every step, and the intervals solved from them."""

    count: np.ndarray  # (L + 1,)
    state: np.ndarray  # (L + 1, capacity, n), all -1 for the state before a first step without handover
    key: np.ndarray  # (L + 1, capacity), hash of the state
    child: np.ndarray  # (L + 1, capacity, L): node at the end of the interval of length l + 1, or OPEN
    value: np.ndarray  # (L + 1, capacity, L): value of that interval


@njit(cache=True, nogil=True)
def add_step(windows, indptr, indices, data, m, first, last, entry_cost):
    """Make the windows ``[a, last + 1)`` for a from `first` to `last`.

    Parameters
    ----------
    windows : Windows
    indptr, indices, data : arrays
        CSR rows of step `last`.
    m : int
        Number of tasks.
    first, last : int
    entry_cost : float
        See `sapopt.kernels.windows.window_gains`.
    """
    lookahead = int(np.sqrt(len(windows.negative)))
    for a in prange(first, last + 1):
        slot = (a % lookahead) * lookahead + last - a
        before = np.zeros_like(indptr) if a == last else windows.row_start[slot - 1]
        windows.negative[slot] = longer_window(
            before, windows.tasks[slot - 1], windows.gains[slot - 1], indptr, indices, data,
            np.empty(m), np.zeros(m, np.int64), entry_cost if a == last else 0.0,
            windows.row_start[slot], windows.tasks[slot], windows.gains[slot],
        )  # fmt: skip


@njit(cache=True, nogil=True)
def search(nodes, plain, charged, root, k, stop, cost, idle_is_free, order, threads):
    """Find the first assignment of the best sequence of intervals over ``k .. stop - 1``.

    Parameters
    ----------
    nodes : Nodes
        Changed in place.
    plain, charged : Windows
        Sums of the benefits; the same with the cost of entering a task charged where idling is free, else `plain`.
    root : ndarray of int64, shape (n,)
        State at step k.
    k, stop : int
    cost : float
    idle_is_free : bool
    order : ndarray of int64, shape (m,)
        Parking order.
    threads : int

    Returns
    -------
    found : bool
        False if no sequence is feasible, or if idle agents found no task in an interval: then idling is not free there,
        and another way must be taken.
    first : ndarray of int64, shape (n,)
    solved : int
        Intervals that had to be solved.
    """
    ring, capacity, n = nodes.state.shape
    lookahead = ring - 1
    reached = np.zeros((ring, capacity), np.bool_)
    root_node = _node(nodes, k, root.astype(np.int32), _hash(root))
    reached[k % ring, root_node] = True
    solved = 0

    # Intervals that end before `stop` lead to new nodes, so their steps come one after another; the many that end at
    # `stop` depend on no other and are solved together.
    for start in range(k, stop + 1):
        jobs = _open_jobs(nodes, reached, k, start, stop)
        if len(jobs) > 0:
            tasks, values, keys = _solve(nodes, plain, charged, jobs, cost, idle_is_free, order, threads)
            solved += len(jobs)
            for q in range(len(jobs)):
                a, node, length = jobs[q]
                if values[q] == np.inf:
                    return False, root, solved
                nodes.child[a % ring, node, length - 1] = _node(nodes, a + length, tasks[q], keys[q])
                nodes.value[a % ring, node, length - 1] = values[q]
        if start < stop:
            for node in range(nodes.count[start % ring]):
                if reached[start % ring, node]:
                    for cut in range(start + 1, stop):
                        reached[cut % ring, nodes.child[start % ring, node, cut - start - 1]] = True

    best = np.zeros((ring, capacity))  # value of the best sequence from a node on; zero at `stop`
    first = 0
    for start in range(stop - 1, k - 1, -1):
        here = start % ring
        for node in range(nodes.count[here]):
            if not reached[here, node]:
                continue
            top = -np.inf
            for cut in range(start + 1, stop + 1):
                total = nodes.value[here, node, cut - start - 1]
                total += best[cut % ring, nodes.child[here, node, cut - start - 1]]
                if cut == start + 1 or total > top + _TIE * abs(top):
                    top = total
                    first = cut - start
            best[here, node] = top
    child = nodes.child[k % ring, root_node, first - 1]
    return True, nodes.state[(k + first) % ring, child].astype(np.int64), solved


@njit(cache=True, nogil=True)
def _open_jobs(nodes, reached, k, start, stop):
    """Unsolved intervals as rows (start, node, length): from `start` to before `stop`, or all to `stop` if they meet."""
    ring, capacity = reached.shape
    jobs = np.empty((capacity, 3), np.int64)
    size = 0
    for a in range(k if start == stop else start, min(start + 1, stop)):
        for node in range(nodes.count[a % ring]):
            if not reached[a % ring, node]:
                continue
            for b in range(stop if start == stop else a + 1, stop + 1 if start == stop else stop):
                if nodes.child[a % ring, node, b - a - 1] == OPEN:
                    jobs[size] = a, node, b - a
                    size += 1
    return jobs[:size]


@njit(cache=True, nogil=True)
def _solve(nodes, plain, charged, jobs, cost, idle_is_free, order, threads):
    """Solve intervals side by side: assignments, values (inf where parking failed), hashes of the assignments."""
    tasks = np.empty((len(jobs), nodes.state.shape[2]), np.int32)
    values = np.empty(len(jobs))
    keys = np.empty(len(jobs), np.int64)
    for t in prange(threads):
        for q in range(t, len(jobs), threads):  # long windows come first, so every thread gets its share of them
            chosen, values[q] = _interval(nodes, plain, charged, jobs[q], cost, idle_is_free, order)
            tasks[q] = chosen
            keys[q] = _hash(chosen)
    return tasks, values, keys


@njit(cache=True, nogil=True)
def _interval(nodes, plain, charged, job, cost, idle_is_free, order):
    """Best single assignment of an interval and its value; inf if idle agents found no task."""
    ring = len(nodes.count)
    start, node, length = job
    slot = (start % (ring - 1)) * (ring - 1) + length - 1
    held = nodes.state[start % ring, node].astype(np.int64)
    windows = plain
    rest, bonus = 0.0, 0.0
    if held[0] >= 0:
        if idle_is_free:
            windows = charged
        else:
            rest, bonus = -cost, cost
    held_gain = listed_gain(plain.row_start[slot], plain.tasks[slot], plain.gains[slot], held, bonus)
    chosen, gain, parked = assign_and_park(
        windows.row_start[slot], windows.tasks[slot], windows.gains[slot],
        held, held_gain, order, windows.negative[slot],
    )  # fmt: skip
    return chosen, gain + len(held) * rest if parked else np.inf


@njit(cache=True, nogil=True)
def _hash(tasks):
    """Polynomial hash of an assignment."""
    key = np.int64(0)
    for j in tasks:
        key = key * np.int64(6364136223846793005) + np.int64(j) + 1
    return key


@njit(cache=True, nogil=True)
def _node(nodes, step, tasks, key):
    """Number of the node of a state at a step, a new one if there is none."""
    here = step % len(nodes.count)
    for node in range(nodes.count[here]):
        if nodes.key[here, node] == key and (nodes.state[here, node] == tasks).all():
            return node
    node = nodes.count[here]
    nodes.count[here] += 1
    nodes.state[here, node] = tasks
    nodes.key[here, node] = key
    nodes.child[here, node] = OPEN
    return node

