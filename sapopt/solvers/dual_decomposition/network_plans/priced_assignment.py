"""Assignment by shortest augmenting paths that start from good prices.

The prices of the dual nearly solve every step's assignment problem: most agents' best priced task is uncontested and
only the others need an augmenting path. At thousands of agents this is far faster than starting from nothing.
"""

from __future__ import annotations

import numpy as np

from sapopt.kernels.jit import njit


@njit(cache=True, nogil=True)
def assign(weights, prices):  # type: ignore[no-untyped-def]
    """Return the task of each agent (n,) in an assignment of greatest weight, or an empty array if there is none.

    ``weights`` (n, m) may hold -inf. With n == m the result is optimal whatever the ``prices`` (m,); with n < m a task
    that stays free is worth its price, so that prices of zero give the optimum.
    """
    n, m = weights.shape
    price = prices.copy()
    profit = np.empty(n)
    task_of, agent_of = -np.ones(n, np.int64), -np.ones(m, np.int64)
    waiting = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        best = -1
        profit[i] = -np.inf
        for j in range(m):
            gain = weights[i, j] - price[j]
            if gain > profit[i] or (
                gain == profit[i] and best >= 0 and agent_of[best] >= 0 and agent_of[j] < 0
            ):
                profit[i], best = gain, j
        if best < 0:
            return np.empty(0, np.int64)
        if agent_of[best] < 0:
            task_of[i], agent_of[best] = best, i
        else:
            waiting[count] = i
            count += 1
    distance, source = np.empty(m), np.empty(m, np.int64)
    todo, scanned = np.empty(m, np.int64), np.empty(m, np.int64)
    for root in waiting[:count]:
        for j in range(m):
            distance[j] = np.inf
            todo[j] = j
        left, done = m, 0
        i, length, end = root, 0.0, -1
        while end < 0:
            shortest, at = np.inf, -1
            for q in range(left):
                j = todo[q]
                slack = length + profit[i] - weights[i, j] + price[j]
                if slack < distance[j]:
                    distance[j], source[j] = slack, i
                if distance[j] < shortest or (distance[j] == shortest and at >= 0 and agent_of[j] < 0):
                    shortest, at = distance[j], q
            if at < 0:
                return np.empty(0, np.int64)
            j = todo[at]
            left -= 1
            todo[at] = todo[left]
            length = shortest
            if agent_of[j] < 0:
                end = j
            else:
                scanned[done] = j
                done += 1
                i = agent_of[j]
        profit[root] -= length
        for q in range(done):
            j = scanned[q]
            profit[agent_of[j]] -= length - distance[j]
            price[j] += length - distance[j]
        j = end
        while True:
            i = source[j]
            agent_of[j] = i
            j, task_of[i] = task_of[i], j
            if i == root:
                break
    return task_of
