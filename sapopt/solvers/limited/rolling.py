"""Plans from prices: one assignment a step, with the future valued by the agents' best priced paths."""

from __future__ import annotations

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.transport import transported
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.limited.dual import Prices
from sapopt.formulations.limited.graph import PathGraph
from sapopt.running.steps import Ledger


def rolling_plan(graph: PathGraph, prices: Prices) -> IntArray | None:
    """A plan (T, n) within the capacities, and within the limits wherever a step can keep them.

    What a pair is worth at a step is the value of the agent's best priced path that begins with it; the price of the
    step itself does not count, for the assignment settles who goes where. None if the agents run into a dead end.
    """
    problem, rows = graph.problem, graph.problem.rows
    T, n, m = problem.T, problem.n, problem.m
    assert problem.capacity is not None
    effective = prices.effective(rows)
    weight = graph.priced(effective, prices.limits)
    onward, _ = graph.onward(weight)
    ledger = Ledger(problem, strict=False)
    node = graph.node_ptr[:-1].copy()
    plan = np.empty((T, n), dtype=np.int64)
    for k in range(T):
        values, arcs = first_values(graph, node, weight, onward, k)
        matrix = values + effective[k]
        try:
            tasks = ledger.rules(k).assign(matrix, k, k + 1, priced=True)
        except InfeasibleError:
            try:
                tasks = transported(matrix, problem.capacity[k])
            except InfeasibleError:
                return None
        plan[k] = tasks
        ledger.enter(k, tasks)
        node = graph.head[arcs[np.arange(n), tasks]]
        if m == 0 or (arcs[np.arange(n), tasks] < 0).any():
            return None
    return plan


def first_values(
    graph: PathGraph, node: IntArray, weight: FloatArray, onward: FloatArray, k: int
) -> tuple[FloatArray, IntArray]:
    """Value (n, m) of every agent's best path from its node that begins with a task, and the arc that holds it."""
    n, m = graph.problem.n, graph.problem.m
    values, arcs = np.full((n, m), -np.inf), np.full((n, m), -1, dtype=np.int64)
    for i in range(n):
        todo = [(int(node[i]), 0.0)]
        while todo:
            at, before = todo.pop()
            span = np.arange(graph.arc_ptr[at], graph.arc_ptr[at + 1])
            on_the_way = span[graph.cell[span] < 0]
            todo += [(int(graph.head[a]), before + float(weight[a])) for a in on_the_way]
            held = span[graph.cell[span] >= 0]
            task = graph.cell[held] - k * m
            total = before + weight[held] + onward[graph.head[held]]
            better = total > values[i, task]
            values[i, task[better]] = total[better]
            arcs[i, task[better]] = held[better]
    return values, arcs
