"""HAAL's search tree of one step, compiled, for sparse benefits and one switching cost.

A node is a state (an assignment) at the start of an interval. Solving an interval from a node gives an assignment,
which is the state of a node at the interval's end; equal states of one step are one node. The nodes stay until their
step is past, with what was solved from them, so that the next search only has to solve what is new.

An interval that ends the window leads nowhere, only its value counts, and it is not solved while an upper bound says
that no sequence through it can be the best; neither is one that ends a step earlier, so that just one way is left. The
bound is that of linear programming duality: with any prices p >= 0, an assignment gains at most
``sum p + sum_i max(0, max_j gain[i, j] - p[j])``. The prices are those of another state over the same window, which are
close to optimal, for few agents have other tasks.

Steps are stored in rings: the nodes of step a at ``a % (L + 1)``, window [a, b) in slot ``(a % L) * L + b - a - 1``.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from sapopt.kernels.jit import njit
from sapopt.kernels.matching import solve_rows
from sapopt.kernels.windows import listed_gain, longer_window

FOUND, STUCK, UNFINISHED = 1, -1, -2
OPEN = -1  # instead of a child: not solved
_UNPRICED = 1e300  # bound of what has no prices yet
_TIE = 1e-12  # relative difference below which two sequences are equal
_SMALL = 30_000  # more than elsewhere: most of the room in the arrays is never used
_MARGIN = 1e-9  # relative; a bound must be lower than a known value by more, far above ties and rounding

Windows = namedtuple("Windows", "row_start tasks gains negative")
"""Window sums as rows sorted by decreasing gain, one window a slot: ``row_start`` of shape (L * L, n + 1), ``tasks``
and ``gains`` of shape (L * L, capacity), ``negative`` of shape (L * L,): whether a gain is negative."""

Prices = namedtuple("Prices", "known price top total rough")
"""Prices for the bound, one window a slot: whether they are ``known``; ``price`` of shape (L * L, m), their ``total``,
``top`` of shape (L * L, n): what an agent gains at most at these prices from tasks that it does not hold, and the sum
``rough`` of all these and the prices."""

Nodes = namedtuple("Nodes", "size state key child value")
"""Nodes of every step: their number ``size``; ``state`` of shape (L + 1, capacity, n), all -1 before a first step
without handover, and its hash ``key``; ``child`` and ``value`` of shape (L + 1, capacity, L): the node at the end of
the interval of length l + 1, or OPEN, and the value of that interval."""

Problem = namedtuple("Problem", "plain charged prices cost idle_is_free order")
"""What the intervals of a search have in common, as the arguments of `search` say."""


@njit(cache=True, nogil=True, small=_SMALL)
def add_step(windows, prices, indptr, indices, data, m, first, last, entry_cost):
    """Make the windows ``[a, last + 1)`` for a from `first` to `last`.

    Parameters
    ----------
    windows : Windows
    prices : Prices
        Those of the new windows are forgotten.
    indptr, indices, data : arrays
        CSR rows of step `last`.
    m : int
        Number of tasks.
    first, last : int
    entry_cost : float
        See `sapopt.kernels.windows.window_gains`.
    """
    lookahead = int(np.sqrt(len(windows.negative)))
    total = np.empty(m)
    for a in range(first, last + 1):
        slot = (a % lookahead) * lookahead + last - a
        prices.known[slot] = False
        before = np.zeros(len(indptr), np.int64) if a == last else windows.row_start[slot - 1]
        windows.negative[slot] = longer_window(
            before, windows.tasks[slot - 1], windows.gains[slot - 1], indptr, indices, data,
            total, np.zeros(m, np.int64), entry_cost if a == last else 0.0,
            windows.row_start[slot], windows.tasks[slot], windows.gains[slot],
        )  # fmt: skip


@njit(cache=True, nogil=True, small=_SMALL)
def search(nodes, plain, charged, prices, root, k, stop, cost, idle_is_free, order, budget):
    """Find the first assignment of the best sequence of intervals over ``k .. stop - 1``.

    Parameters
    ----------
    nodes : Nodes
    plain, charged : Windows
        Sums of the benefits; the same with the cost of entering a task charged where idling is free, else `plain`.
    prices : Prices
        Changed in place, as `nodes`.
    root : ndarray of int64, shape (n,)
        State at step k.
    k, stop : int
    cost : float
    idle_is_free : bool
    order : ndarray of int64, shape (m,)
        Parking order.
    budget : int
        Most intervals to solve in this call. What was solved stays in `nodes`, so another call goes on from there.

    Returns
    -------
    outcome : int
        FOUND; STUCK if idle agents found no task in an interval: then idling is not free there, and another way must be
        taken; UNFINISHED if the budget was too small.
    first : ndarray of int64, shape (n,)
    solved : int
        Intervals that had to be solved.
    """
    ring, capacity, n = nodes.state.shape
    problem = Problem(plain, charged, prices, cost, idle_is_free, order)
    before = np.full((ring, capacity), -np.inf)  # value of the best way to a node; -inf if it is not reached
    root_node = _node(nodes, k, root, _hash(root))
    before[k % ring, root_node] = 0.0
    solved = 0
    for start in range(k, stop - 1):
        here = start % ring
        for node in range(nodes.size[here]):
            if before[here, node] == -np.inf:
                continue
            for cut in range(start + 1, stop):
                length = cut - start
                if nodes.child[here, node, length - 1] == OPEN:
                    if cut == stop - 1:
                        continue
                    if solved == budget:
                        return UNFINISHED, root, solved
                    solved += 1
                    if not _solve(nodes, start, node, length, problem):
                        return STUCK, root, solved
                child = nodes.child[here, node, length - 1]
                value = before[here, node] + nodes.value[here, node, length - 1]
                before[cut % ring, child] = max(before[cut % ring, child], value)
    outcome, count = _last_intervals(nodes, before, k, stop, problem, budget - solved)
    solved += count
    if outcome != FOUND:
        return outcome, root, solved
    first = _best_cut(nodes, before, k, stop, root_node)
    child = nodes.child[k % ring, root_node, first - 1]
    return FOUND, nodes.state[(k + first) % ring, child].astype(np.int64), solved


# Part of `search` for the compiler: it would optimise all that is called here once more for a function of its own.
@njit(cache=True, nogil=True, no_cpython_wrapper=True, inline="always")
def _last_intervals(nodes, before, k, stop, problem, budget):
    """Solve the intervals that end at `stop` or one step before it, as long as one may be part of the best sequence.

    The most promising one comes first. It is solved when its bound is sharp, and otherwise gets a sharper one; as long
    as its window has no prices, there is none. Returns the outcome as `search` does, and the number solved.
    """
    ring, capacity = before.shape
    start = np.empty(2 * capacity, np.int64)
    node = np.empty(2 * capacity, np.int64)
    length = np.empty(2 * capacity, np.int64)
    bound = np.empty(2 * capacity)
    sharp = np.zeros(2 * capacity, np.bool_)
    pair_top = np.empty((ring - 1, nodes.state.shape[2]))
    pair_known = np.zeros(ring - 1, np.bool_)
    size = 0
    top = -np.inf  # value of the best sequence so far
    for end in (stop, stop - 1):
        for a in range(k, end):
            rest = _rough_bound(a, end, stop, ring - 1, problem)
            for v in range(nodes.size[a % ring]):
                if before[a % ring, v] == -np.inf:
                    continue
                if nodes.child[a % ring, v, end - a - 1] == OPEN:
                    start[size], node[size], length[size] = a, v, end - a
                    bound[size] = before[a % ring, v] + rest
                    size += 1
                elif end == stop:
                    top = max(top, before[a % ring, v] + nodes.value[a % ring, v, end - a - 1])
    solved = 0
    while size > 0:
        q = 0
        for other in range(size):
            if bound[other] > bound[q]:
                q = other
        if bound[q] < top - _MARGIN * abs(top):
            break
        a, v, end = start[q], node[q], start[q] + length[q]
        here = before[a % ring, v]
        if not sharp[q]:
            sharp[q] = True
            if end == stop:
                bound[q] = here + _bound(nodes, a, v, stop, problem)
            else:
                bound[q] = here + _pair_bound(nodes, a, v, stop, problem, pair_top, pair_known)
            if bound[q] < _UNPRICED:
                continue
        size -= 1
        start[q], node[q], length[q] = start[size], node[size], length[size]
        bound[q], sharp[q] = bound[size], sharp[size]
        if nodes.child[a % ring, v, end - a - 1] == OPEN:
            if solved == budget:
                return UNFINISHED, solved
            solved += 1
            if not _solve(nodes, a, v, end - a, problem):
                return STUCK, solved
        value = here + nodes.value[a % ring, v, end - a - 1]
        child = nodes.child[a % ring, v, end - a - 1]
        if end == stop:
            top = max(top, value)
        elif value > before[end % ring, child]:
            before[end % ring, child] = value
            start[size], node[size], length[size] = end, child, 1
            bound[size] = value + _rough_bound(end, stop, stop, ring - 1, problem)
            sharp[size] = False
            size += 1
    return FOUND, solved


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _best_cut(nodes, before, k, stop, root_node):
    """Length of the first interval of the best sequence; of equal ones the shortest."""
    ring, capacity = before.shape
    best = np.zeros((ring, capacity))  # value of the best sequence from a node on; zero at `stop`
    first = 0
    for start in range(stop - 1, k - 1, -1):
        here = start % ring
        for node in range(nodes.size[here]):
            if before[here, node] == -np.inf:
                continue
            top = -np.inf
            for length in range(1, stop - start + 1):
                child = nodes.child[here, node, length - 1]
                if child == OPEN:
                    continue
                total = nodes.value[here, node, length - 1] + best[(start + length) % ring, child]
                if total > -np.inf and (top == -np.inf or total > top + _TIE * abs(top)):
                    top = total
                    first = length
            best[here, node] = top
    return first


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _entry(nodes, start, node, length, problem):
    """Slot, rows, held tasks and their gains, and the common value of all other tasks, for an interval from a node."""
    plain, cost = problem.plain, problem.cost
    ring = len(nodes.size)
    slot = (start % (ring - 1)) * (ring - 1) + length - 1
    held = nodes.state[start % ring, node].astype(np.int64)
    windows, rest, bonus = plain, 0.0, 0.0
    if held[0] >= 0:
        if problem.idle_is_free:
            windows = problem.charged
        else:
            rest, bonus = -cost, cost
    held_gain = listed_gain(plain.row_start[slot], plain.tasks[slot], plain.gains[slot], held, bonus)
    return slot, windows, held, held_gain, rest


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _solve(nodes, start, node, length, problem):
    """Solve an interval; False if idle agents found no task."""
    slot, windows, held, held_gain, rest = _entry(nodes, start, node, length, problem)
    prices = problem.prices
    row_start, tasks, gains = windows.row_start[slot], windows.tasks[slot], windows.gains[slot]
    careful = windows.negative[slot]
    chosen, gain, parked, p = solve_rows(row_start, tasks, gains, held, held_gain, problem.order, careful)
    if not parked:
        return False
    here = start % len(nodes.size)
    child = _node(nodes, start + length, chosen, _hash(chosen))
    nodes.child[here, node, length - 1] = child
    nodes.value[here, node, length - 1] = gain + len(held) * rest
    if not prices.known[slot]:
        prices.known[slot] = True
        prices.total[slot] = 0.0
        for j in range(len(p)):
            prices.price[slot, j] = p[j]
            prices.total[slot] += p[j]
        for i in range(len(held)):
            top = 0.0
            for e in range(row_start[i], row_start[i + 1]):
                if gains[e] <= top:
                    break
                top = max(top, gains[e] - p[tasks[e]])
            prices.top[slot, i] = top
        rough = prices.total[slot]
        for i in range(len(held)):
            rough += prices.top[slot, i]
        prices.rough[slot] = rough
    return True


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _rough_bound(start, end, stop, lookahead, problem):
    """What `_bound` or, if the interval ends before `stop`, `_pair_bound` is at most for any state."""
    prices, cost, idle_is_free = problem.prices, problem.cost, problem.idle_is_free
    slot = (start % lookahead) * lookahead + end - start - 1
    last = ((stop - 1) % lookahead) * lookahead
    saved = 2.0 * prices.top.shape[1] * cost if idle_is_free else 0.0
    if end == stop:
        return saved + prices.rough[slot] if prices.known[slot] else np.inf
    return (
        saved + prices.rough[slot] + prices.rough[last]
        if prices.known[slot] and prices.known[last]
        else _UNPRICED
    )


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _bound(nodes, start, node, stop, problem):
    """Upper bound of the value of the interval from a node to `stop`; infinite as long as its window has no prices."""
    prices = problem.prices
    lookahead = len(nodes.size) - 1
    if not prices.known[(start % lookahead) * lookahead + stop - start - 1]:
        return np.inf
    slot, windows, held, held_gain, rest = _entry(nodes, start, node, stop - start, problem)
    price, top = prices.price[slot], prices.top[slot]
    total = prices.total[slot] + len(held) * rest
    for i in range(len(held)):
        total += max(top[i], held_gain[i] - price[held[i]]) if held[i] >= 0 else top[i]
    return total


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _pair_bound(nodes, start, node, stop, problem, pair_top, pair_known):
    """Upper bound of the value of two intervals from a node, to ``stop - 1`` and from there to `stop`.

    An agent either has a task x in the first and an unrelated one in the second, or x in both; the gains of x over both
    are those of the window of both. What an agent gets from tasks that it does not hold is the same for all nodes of
    step `start` and kept in `pair_top`.
    """
    prices, cost, idle_is_free = problem.prices, problem.cost, problem.idle_is_free
    lookahead = len(nodes.size) - 1
    both = (start % lookahead) * lookahead + stop - start - 1
    last = ((stop - 1) % lookahead) * lookahead
    if not prices.known[both - 1] or not prices.known[last]:
        return _UNPRICED
    slot, windows, held, held_gain, rest = _entry(nodes, start, node, stop - 1 - start, problem)
    p, q = prices.price[slot], prices.price[last]
    stay = 0.0 if idle_is_free else cost  # saved in the second interval by an agent that keeps its task
    if not pair_known[start % lookahead]:
        pair_known[start % lookahead] = True
        row_start, tasks, gains = windows.row_start[both], windows.tasks[both], windows.gains[both]
        for i in range(len(held)):
            top = 0.0
            for e in range(row_start[i], row_start[i + 1]):
                if gains[e] <= top:
                    break
                top = max(top, gains[e] - p[tasks[e]] - q[tasks[e]])
            apart = prices.top[slot, i] + prices.top[last, i]
            pair_top[start % lookahead, i] = max(apart, top + stay)
    plain = problem.plain
    bonus = -rest  # saved in the first interval by an agent that keeps the task it holds
    both_gain = listed_gain(plain.row_start[both], plain.tasks[both], plain.gains[both], held, bonus + stay)
    total = prices.total[slot] + prices.total[last] + len(held) * (rest - stay)
    top = pair_top[start % lookahead]
    for i in range(len(held)):
        gain = top[i]
        j = held[i]
        if j >= 0:
            apart = held_gain[i] - p[j] + prices.top[last, i]
            gain = max(gain, max(apart, both_gain[i] - p[j] - q[j]))
        total += gain
    return total


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _hash(tasks):
    """Polynomial hash of an assignment, below 2^31, so that no product overflows."""
    key = np.int64(0)
    for j in tasks:
        key = (key * np.int64(1_103_515_245) + np.int64(j) + 1) & np.int64(0x7FFFFFFF)
    return key


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def _node(nodes, step, tasks, key):
    """Number of the node of a state at a step, a new one if there is none."""
    here = step % len(nodes.size)
    for node in range(nodes.size[here]):
        if nodes.key[here, node] != key:
            continue
        same = True
        for i in range(len(tasks)):
            same &= nodes.state[here, node, i] == tasks[i]
        if same:
            return node
    node = nodes.size[here]
    nodes.size[here] += 1
    nodes.key[here, node] = key
    for i in range(len(tasks)):
        nodes.state[here, node, i] = tasks[i]
    for length in range(nodes.child.shape[2]):
        nodes.child[here, node, length] = OPEN
    return node
