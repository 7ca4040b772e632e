"""Convex relaxations as upper bounds, through cvxpy and Clarabel.

- `linear_bound`: the linear relaxation of the MILP; equal to the best Lagrangian bound.
- `semidefinite_bound`: the lifted matrix of the QAP, for some dozens of allowed pairs; the strongest.
- `convex_bound`: the QAP's quadratic form, shifted until it is concave, which 0/1 points do not feel; weak.

Clarabel is an interior-point method in floating point: its answer is padded by its own tolerance, and is not a
rigorous proof as the Lagrangian bound of `sapopt.bound` is.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations import milp, qap
from sapopt.formulations.highs import SolverError
from sapopt.problem.sap import SAP
from sapopt.proofs.certificate import Bound

_PADDING = 1e-5
_OPTIONS = {"tol_gap_abs": 1e-7, "tol_gap_rel": 1e-7, "tol_feas": 1e-8}
_MOST = 150
"""Pairs (facility, location) up to which the semidefinite relaxation is sensible: its matrix has this size squared."""


def linear_bound(problem: SAP) -> Bound:
    """Value of the linear relaxation; for agent-local dynamics.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local.
    """
    return _bound(milp.formulate(problem, relaxed=True).problem, "linear relaxation (Clarabel)")


def convex_bound(problem: SAP) -> Bound:
    """Value of the QAP with its quadratic form made concave: on 0/1 points ``x' Q x = x' (Q - s I) x + s sum x``."""
    import cvxpy as cp

    quadratic, linear, facility, place = _pairs(qap.formulate(problem))
    x, rules = _assignment(cp, facility, place)
    values, vectors = np.linalg.eigh(quadratic)
    shift = max(float(values[-1]), 0.0)
    root = np.sqrt(np.maximum(shift - values, 0.0))[:, None] * vectors.T
    objective = (linear + shift) @ x - cp.sum_squares(root @ x)
    return _bound(cp.Problem(cp.Maximize(objective), rules), "convex quadratic relaxation (Clarabel)")


def semidefinite_bound(problem: SAP) -> Bound:
    """Value of the semidefinite relaxation of the QAP: Y >= x x' and Y >= 0 for Y = x x', all rules lifted.

    Raises
    ------
    ValueError
        If the dynamics is not a `SwitchingCost`, or the problem has more than 150 pairs (T n m).
    """
    import cvxpy as cp

    quadratic, linear, facility, place = _pairs(qap.formulate(problem))
    count = len(linear)
    if count > _MOST:
        raise ValueError(
            f"problem: {count} pairs are too many for the semidefinite relaxation (at most {_MOST})"
        )
    x, rules = _assignment(cp, facility, place)
    lifted = cp.Variable((count + 1, count + 1), PSD=True)
    products = lifted[1:, 1:]
    same = (facility[:, None] == facility) | (place[:, None] == place)
    np.fill_diagonal(same, False)
    home = _members(facility).T
    rules += [
        lifted[0, 0] == 1,
        lifted[0, 1:] == x,
        cp.diag(products) == x,
        products >= 0,
        cp.multiply(same.astype(float), products) == 0,
        products @ home == cp.reshape(x, (count, 1), order="C") @ np.ones((1, home.shape[1])),
    ]
    objective = cp.sum(cp.multiply(quadratic, products)) + linear @ x
    return _bound(cp.Problem(cp.Maximize(objective), rules), "semidefinite relaxation (Clarabel)")


def _pairs(form: qap.QAP) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Symmetric quadratic form and linear gains over the allowed pairs, with the facility and the place of each.

    A place is a task at a step: where a task has a charged and a free location, both are one place, and the
    punishment for using both, which would spoil the relaxations, is left out.
    """
    facility, location = np.nonzero(np.isfinite(form.c))
    full = form.a[np.ix_(facility, facility)] * form.b[np.ix_(location, location)]
    _, n, m = form.shape
    place = facility // n * m + form.task[location]
    full[place[:, None] == place] = 0.0
    return (full + full.T) / 2, form.c[facility, location], facility, place


def _members(label: IntArray) -> FloatArray:
    """0/1 matrix of the pairs that bear each label."""
    return (np.unique(label)[:, None] == label).astype(np.float64)


def _assignment(cp: Any, facility: IntArray, place: IntArray) -> tuple[Any, list[Any]]:
    x = cp.Variable(len(facility), nonneg=True)
    return x, [_members(facility) @ x == 1, _members(place) @ x <= 1]


def _bound(problem: Any, method: str) -> Bound:
    import cvxpy as cp

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the status below says it
            problem.solve(solver=cp.CLARABEL, **_OPTIONS)
    except cp.error.SolverError as error:
        raise SolverError(f"Clarabel failed: {error}") from None
    if problem.status != "optimal":
        raise SolverError(f"Clarabel ended with {problem.status!r} on the {method}")
    value = float(problem.value)
    return Bound(value + _PADDING * max(1.0, abs(value)), None, method)
