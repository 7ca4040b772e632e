"""Compiled recursions over the arcs of agent-local states, see `sapopt.dynamics.paths.arcs` for the arrays.

Rows are agents, or the one row that agents who are alike share. All recursions go backwards from the end, so that one
pass serves every state an agent may start in.
"""

from __future__ import annotations

import numpy as np

from sapopt.kernels.jit import njit


@njit(cache=True, inline="always")
def _is_listed(listed, begin, end, j):
    found = False
    for e in range(begin, end):
        found = found or listed[e] == j
    return found


@njit(cache=True, nogil=True)
def idle_tasks(prices, rows, first_row, last_row, own, listed_ptr, listed):
    """Return the cheapest unlisted task (T, rows) of some rows and its price; a row's own comes first among equals."""
    T, m = prices.shape
    task = np.empty((T, rows), dtype=np.int64)
    price = np.empty((T, rows))
    for k in range(T):
        low = np.int64(0)
        for q in range(1, m):
            if prices[k, q] < prices[k, low]:
                low = np.int64(q)
        for r in range(first_row, last_row):
            begin, end = listed_ptr[k * rows + r], listed_ptr[k * rows + r + 1]
            j = own[r]
            if j < 0 or prices[k, j] > prices[k, low] or _is_listed(listed, begin, end, j):
                j = low
                if _is_listed(listed, begin, end, j):
                    j = np.int64(-1)
                    for q in range(m):
                        if (j < 0 or prices[k, q] < prices[k, j]) and not _is_listed(listed, begin, end, q):
                            j = q
            task[k, r] = max(j, 0)
            price[k, r] = prices[k, j] if j >= 0 else np.inf
    return task, price


@njit(cache=True, nogil=True)
def longest(arcs, node_ptr, rows, first_row, last_row, prices, idle_price):
    """Return the value of the best way from every node (of some rows) to the end, and the arc it begins with."""
    first, head, task, gain = arcs
    T = prices.shape[0]
    value = np.empty(node_ptr[-1])
    choice = np.empty(node_ptr[-1], dtype=np.int64)
    for r in range(first_row, last_row):
        for v in range(node_ptr[T * rows + r], node_ptr[T * rows + r + 1]):
            value[v] = 0.0
    for k in range(T - 1, -1, -1):
        for r in range(first_row, last_row):
            idle = idle_price[k, r]
            for v in range(node_ptr[k * rows + r], node_ptr[k * rows + r + 1]):
                best = -np.inf
                arc = -1
                for a in range(first[v], first[v + 1]):
                    j = task[a]
                    x = gain[a] + value[head[a]] - (idle if j < 0 else prices[k, j])
                    if x > best:
                        best = x
                        arc = a
                value[v] = best
                choice[v] = arc
    return value, choice


@njit(cache=True, nogil=True)
def follow(arcs, source, choice, steps):
    """Return the tasks (steps, agents) on the best ways, -1 for idling and -2 where there is no way."""
    _, head, task, _ = arcs
    plan = np.full((steps, len(source)), -2, dtype=np.int64)
    for i in range(len(source)):
        v = source[i]
        for k in range(steps):
            a = choice[v]
            if a < 0:
                break
            plan[k, i] = task[a]
            v = head[a]
    return plan


@njit(cache=True, nogil=True)
def moved(arcs, source, tasks, rows, listed_ptr, listed):
    """Return the nodes (agents,) that the tasks lead to from the sources, -1 where an agent may not take its task."""
    first, head, task, _ = arcs
    out = np.full(len(source), -1, dtype=np.int64)
    for i in range(len(source)):
        r = i if rows > 1 else 0
        wanted = tasks[i] if _is_listed(listed, listed_ptr[r], listed_ptr[r + 1], tasks[i]) else -1
        for a in range(first[source[i]], first[source[i] + 1]):
            if task[a] == wanted:
                out[i] = head[a]
    return out


@njit(cache=True, nogil=True)
def soft(arcs, node_ptr, rows, source, prices, idle_price, temperature):
    """Return soft values of the sources, expected usage (T, m) of the listed tasks, and idling (T, rows)."""
    first, head, task, gain = arcs
    T, m = prices.shape
    value = np.zeros(node_ptr[-1])
    weight = np.empty(
        len(gain)
    )  # of every arc among those out of its node; the exponentials are most of the work
    for k in range(T - 1, -1, -1):
        for r in range(rows):
            idle = idle_price[k, r]
            for v in range(node_ptr[k * rows + r], node_ptr[k * rows + r + 1]):
                best = -np.inf
                for a in range(first[v], first[v + 1]):
                    j = task[a]
                    weight[a] = gain[a] + value[head[a]] - (idle if j < 0 else prices[k, j])
                    best = max(best, weight[a])
                if best == -np.inf:
                    value[v] = -np.inf
                    continue
                total = 0.0
                for a in range(first[v], first[v + 1]):
                    weight[a] = np.exp((weight[a] - best) / temperature)
                    total += weight[a]
                value[v] = best + temperature * np.log(total)
                for a in range(first[v], first[v + 1]):
                    weight[a] /= total
    usage = np.zeros((T, m))
    idling = np.zeros((T, rows))
    mass = np.zeros(node_ptr[-1])
    for i in range(len(source)):
        mass[source[i]] += 1.0
    for k in range(T):
        for r in range(rows):
            for v in range(node_ptr[k * rows + r], node_ptr[k * rows + r + 1]):
                if mass[v] < 1e-12 or value[v] == -np.inf:
                    continue
                for a in range(first[v], first[v + 1]):
                    share = mass[v] * weight[a]
                    mass[head[a]] += share
                    if task[a] < 0:
                        idling[k, r] += share
                    else:
                        usage[k, task[a]] += share
    values = np.empty(len(source))
    for i in range(len(source)):
        values[i] = value[source[i]]
    return values, usage, idling


@njit(cache=True, nogil=True)
def values_of_first(arcs, source, value, rows, listed_ptr, listed, m):
    """Return the value (agents, m) of the best way that begins with every task; its price does not count."""
    first, head, task, gain = arcs
    n = len(source)
    out = np.full((n, m), -np.inf)
    for i in range(n):
        r = i if rows > 1 else 0
        v = source[i]
        for a in range(first[v], first[v + 1]):
            if task[a] < 0:
                out[i, :] = gain[a] + value[head[a]]
                for e in range(listed_ptr[r], listed_ptr[r + 1]):
                    out[i, listed[e]] = -np.inf
        for a in range(first[v], first[v + 1]):
            if task[a] >= 0:
                out[i, task[a]] = gain[a] + value[head[a]]
    return out


@njit(cache=True, nogil=True)
def place(arcs, node_ptr, rows, source, own, listed_ptr, listed, order, closed, prices, plan):
    """Move the agents of `order` one by one to their best paths through open cells, see `PlacingOracle.place`."""
    first, head, task, gain = arcs
    T, m = prices.shape
    value = np.zeros(node_ptr[-1])
    choice = np.empty(node_ptr[-1], dtype=np.int64)
    idle_task = np.empty(T, dtype=np.int64)
    idle_price = np.empty(T)
    path = np.empty(T, dtype=np.int64)
    for i in order:
        r = i if rows > 1 else 0
        for k in range(T):
            closed[k, plan[k, i]] = prices[k, plan[k, i]]
        for k in range(T):
            begin, end = listed_ptr[k * rows + r], listed_ptr[k * rows + r + 1]
            j = own[i]
            # A task that is the agent's own and costs nothing needs no search; it is what nearly always happens.
            if closed[k, j] > 0.0 or _is_listed(listed, begin, end, j):
                j = np.int64(-1)
                for q in range(m):
                    if (j < 0 or closed[k, q] < closed[k, j]) and not _is_listed(listed, begin, end, q):
                        j = q
            idle_task[k] = max(j, 0)
            idle_price[k] = closed[k, j] if j >= 0 else np.inf
        for k in range(T - 1, -1, -1):
            for v in range(node_ptr[k * rows + r], node_ptr[k * rows + r + 1]):
                best = -np.inf
                arc = -1
                for a in range(first[v], first[v + 1]):
                    j = task[a]
                    x = gain[a] + value[head[a]] - (idle_price[k] if j < 0 else closed[k, j])
                    if x > best:
                        best = x
                        arc = a
                value[v] = best
                choice[v] = arc
        v = source[i]
        if value[v] > -np.inf:
            for k in range(T):
                a = choice[v]
                path[k] = task[a] if task[a] >= 0 else idle_task[k]
                v = head[a]
            for k in range(T):
                plan[k, i] = path[k]
        for k in range(T):
            closed[k, plan[k, i]] = np.inf
