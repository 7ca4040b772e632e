"""The peers of the benchmark: other programs that solve the same problems.

One assignment problem: scipy dense and sparse, OR-Tools' SimpleMinCostFlow, HiGHS, against our kernel. Algorithm 2: the
plain one. The whole horizon, tiny: OR-Tools CP-SAT and HiGHS on the time-expanded network, against `Exact`. OR-Tools
and HiGHS do not get along in one process, so a process runs one of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from experiments.benchmarks.plain import plain_step
from sapopt import SAP, solve
from sapopt.data.assignment import assign
from sapopt.data.windows import WindowSums
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.solvers import HAA, Exact

SCALE = 10**6
"""OR-Tools knows whole numbers only."""

Row = dict[str, Any]


def gains(problem: SAP) -> tuple[Any, Any]:
    """alpha(beta_hat) of a middle step, entered from HAA's assignment: our form, and a sparse matrix of positive gains.

    The gains are those over idling: benefit, and the cost on the task that is held.
    """
    k = problem.T // 2
    held = solve(SAP(problem.benefits.slice(0, k), problem.dynamics), HAA()).plan[-1]
    matrix = SwitchingCost(float(problem.dynamics.cost)).interval(
        WindowSums(problem.benefits), k, k + 1, held
    )
    sparse = problem.benefits.step(k).tolil(copy=True)
    for i, j in enumerate(held):
        sparse[i, j] = sparse[i, j] + problem.dynamics.cost
    return matrix, sparse.tocsr()


def by_kernel(matrix: Any, sparse: Any) -> float:
    """Ours; parking included."""
    return matrix.value(assign(matrix)) - matrix.rest * matrix.shape[0]


def by_scipy_dense(dense: Any, sparse: Any) -> float:
    """`linear_sum_assignment`, on an array that is there already."""
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(dense, maximize=True)
    return float(dense[rows, columns].sum())


def by_scipy_sparse(weights: Any, sparse: Any) -> float:
    """`min_weight_full_bipartite_matching` with a private idle column for every agent."""
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    rows, columns = min_weight_full_bipartite_matching(weights, maximize=True)
    return float(weights[rows, columns].sum()) - weights.shape[0]


def by_flow(arcs: Any, sparse: Any) -> float:
    """OR-Tools' SimpleMinCostFlow: a source, the agents, the tasks, an idle arc for every agent, a sink."""
    from ortools.graph.python import min_cost_flow

    n, m, row, column, worth = arcs
    source, sink = n + m, n + m + 1
    tail = np.concatenate([np.full(n, source), row, np.arange(n), n + np.arange(m)])
    head = np.concatenate([np.arange(n), n + column, np.full(n, sink), np.full(m, sink)])
    cost = np.concatenate([np.zeros(n, np.int64), -worth, np.zeros(n + m, np.int64)])
    flow = min_cost_flow.SimpleMinCostFlow()
    flow.add_arcs_with_capacity_and_unit_cost(tail, head, np.ones(len(tail), np.int64), cost)
    flow.set_node_supply(source, n)
    flow.set_node_supply(sink, -n)
    if flow.solve() != flow.OPTIMAL:
        raise RuntimeError("SimpleMinCostFlow found no optimum")
    return -flow.optimal_cost() / SCALE


def by_highs(programme: Any, sparse: Any) -> float:
    """HiGHS on the linear programme, whose vertices are assignments."""
    from scipy.optimize import linprog

    cost, rows = programme
    answer = linprog(cost, A_ub=rows, b_ub=np.ones(rows.shape[0]), method="highs")
    return float(-answer.fun)


def _idle_columns(sparse: Any) -> Any:
    import scipy.sparse as sp

    n = sparse.shape[0]
    lifted = sparse.copy()
    lifted.data = (
        lifted.data + 1.0
    )  # a weight of zero would be no arc; every agent has exactly one, so nothing changes
    return sp.csr_array(sp.hstack([lifted, sp.eye_array(n)]))


def _arcs(sparse: Any) -> Any:
    coo = sparse.tocoo()
    return (
        *sparse.shape,
        coo.row.astype(np.int64),
        coo.col.astype(np.int64),
        np.rint(coo.data * SCALE).astype(np.int64),
    )


def _programme(sparse: Any) -> Any:
    import scipy.sparse as sp

    coo = sparse.tocoo()
    n, m = sparse.shape
    count = len(coo.data)
    rows = sp.csr_array(
        (np.ones(2 * count), (np.concatenate([coo.row, n + coo.col]), np.tile(np.arange(count), 2))),
        shape=(n + m, count),
    )
    return -coo.data, rows


ASSIGNERS: dict[str, tuple[Callable[[Any, Any], Any], Callable[[Any, Any], float]]] = {
    "assign-sapopt": (lambda matrix, sparse: matrix, by_kernel),
    "assign-scipy-dense": (lambda matrix, sparse: sparse.toarray(), by_scipy_dense),
    "assign-scipy-sparse": (lambda matrix, sparse: _idle_columns(sparse), by_scipy_sparse),
    "assign-ortools-flow": (lambda matrix, sparse: _arcs(sparse), by_flow),
    "assign-highs": (lambda matrix, sparse: _programme(sparse), by_highs),
}
"""Name -> what is prepared outside the clock, and the solver."""


def assignments(name: str, problem: SAP, cap: float) -> Row:
    """One assignment problem: the fastest of some runs."""
    matrix, sparse = gains(problem)
    prepare, run = ASSIGNERS[name]
    prepared = prepare(matrix, sparse)
    times: list[float] = []
    began = time.perf_counter()
    while len(times) < 7 and (not times or time.perf_counter() - began < cap / 4):
        start = time.process_time()
        value = run(prepared, sparse)
        times.append(time.process_time() - start)
    return {"value": value, "bound": None, "status": "optimal", "seconds": min(times), "per_step": min(times)}


def plain(problem: SAP, lookahead: int) -> Row:
    """Plain Algorithm 2: all sequences of intervals from scratch, dense; one step from the middle."""
    k = problem.T // 2
    held = solve(SAP(problem.benefits.slice(0, k), problem.dynamics), HAA()).plan[-1]
    window = problem.benefits.slice(k, min(k + lookahead, problem.T)).dense()
    began = time.process_time()
    plain_step(window, float(problem.dynamics.cost), 0, lookahead, held)
    seconds = time.process_time() - began
    return {"value": None, "bound": None, "status": "feasible", "seconds": seconds, "per_step": seconds}


def exact(problem: SAP, cap: float) -> Row:
    """`Exact()`."""
    result = solve(problem, Exact(), time_limit=cap)
    return {"value": result.value, "bound": result.bound, "status": result.status.value, "seconds": result.runtime,
            "per_step": result.runtime / problem.T}  # fmt: skip


def whole_highs(problem: SAP, cap: float) -> Row:
    """HiGHS' MILP solver on the whole time-expanded network."""
    from experiments.benchmarks.exact import plain as plain_highs

    row = plain_highs(problem, cap)
    return row | {"per_step": row["seconds"] / problem.T}


def whole_cp_sat(problem: SAP, cap: float) -> Row:
    """OR-Tools CP-SAT on who holds what and who kept it."""
    from experiments.benchmarks.exact import run_cp_sat

    row = run_cp_sat(problem.benefits.dense(), float(problem.dynamics.cost), cap)
    if "plan" not in row:
        return {
            "value": None,
            "bound": None,
            "status": row["status"],
            "seconds": cap,
            "per_step": cap / problem.T,
        }
    row["value"] = problem.evaluate(np.array(row.pop("plan"))).value
    return row | {"per_step": row["seconds"] / problem.T}


WHOLE: dict[str, Callable[[SAP, float], Row]] = {
    "exact": exact,
    "whole-highs": whole_highs,
    "whole-cp-sat": whole_cp_sat,
}
