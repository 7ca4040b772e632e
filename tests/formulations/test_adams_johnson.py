"""The linearisation against one that is written here variable by variable, as the paper states it."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

from sapopt import SAP, SwitchingCost
from sapopt.formulations import qap
from sapopt.formulations.adams_johnson import adams_johnson
from sapopt.formulations.highs import maximise


def textbook(a: Any, b: Any, c: Any) -> float:
    """Value of the relaxation with every product of two allowed pairs, none of them left out or shared.

    Rows: y[p, q, r, s] = y[r, s, p, q]; sum_q y = x[r, s]; sum_p y = x[r, s], or at most that if places are left.
    """
    facilities, locations = c.shape
    pairs = [(p, q) for p in range(facilities) for q in range(locations) if np.isfinite(c[p, q])]
    x = {pair: i for i, pair in enumerate(pairs)}
    y = {
        (u, v): len(pairs) + i
        for i, (u, v) in enumerate((u, v) for u in pairs for v in pairs if u[0] != v[0] and u[1] != v[1])
    }
    gain = np.zeros(len(x) + len(y))
    for (p, q), i in x.items():
        gain[i] = c[p, q] + a[p, p] * b[q, q]
    for ((p, q), (r, s)), i in y.items():
        gain[i] = a[p, r] * b[q, s]
    equal: list[tuple[dict[int, float], float]] = []
    most: list[tuple[dict[int, float], float]] = []
    for p in range(facilities):
        equal.append(({x[p, q]: 1.0 for q in range(locations) if (p, q) in x}, 1.0))
    places = equal if facilities == locations else most
    for q in range(locations):
        places.append(({x[p, q]: 1.0 for p in range(facilities) if (p, q) in x}, 1.0))
    for u, v in y:
        equal.append(({y[u, v]: 1.0, y[v, u]: -1.0}, 0.0))
    for v in pairs:
        for p in range(facilities):
            if p != v[0]:
                row = {y[(p, q), v]: 1.0 for q in range(locations) if ((p, q), v) in y}
                equal.append((row | {x[v]: -1.0}, 0.0))
        for q in range(locations):
            if q != v[1]:
                row = {y[(p, q), v]: 1.0 for p in range(facilities) if ((p, q), v) in y}
                places.append((row | {x[v]: -1.0}, 0.0))

    def matrix(rows: list[tuple[dict[int, float], float]]) -> dict[str, Any]:
        entries = [(i, j, value) for i, (row, _) in enumerate(rows) for j, value in row.items()]
        i, j, value = zip(*entries, strict=True)
        return {
            "A": sp.csr_array((value, (i, j)), shape=(len(rows), len(gain))),
            "b": [right for _, right in rows],
        }

    same = matrix([row for row in equal if row[0]])
    below = matrix(most) if most else {"A": None, "b": None}
    answer = linprog(-gain, A_eq=same["A"], b_eq=same["b"], A_ub=below["A"], b_ub=below["b"], bounds=(0, 1))
    assert answer.status == 0
    return float(-answer.fun)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("facilities", "locations"), [(4, 4), (3, 4)])
def test_plain_problem(seed: int, facilities: int, locations: int) -> None:
    """The relaxation is the textbook's; with integrality it is the best of all assignments."""
    rng = np.random.default_rng(seed)
    a, b = rng.integers(-2, 9, (facilities,) * 2), rng.integers(0, 9, (locations,) * 2)
    c = rng.integers(0, 9, (facilities, locations)).astype(float)
    if seed % 2:
        c[0, 0] = c[1, 2] = -np.inf
    programme = adams_johnson(a.astype(float), -b.astype(float), c)
    relaxed = maximise(programme, relaxed=True)
    assert relaxed.value == pytest.approx(textbook(a, -b, c), abs=1e-6)
    form = qap.QAP(a.astype(float), -b.astype(float), c, (1, facilities, locations), np.arange(locations))
    best = max(form.value(np.array(order)) for order in itertools.permutations(range(locations), facilities))
    assert relaxed.value >= best - 1e-6
    assert maximise(programme).value == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize("free", [False, True])
def test_products_that_are_left_out_change_nothing(free: bool) -> None:
    """Steps that are no neighbours have no products; the relaxation has the value of the one with all of them."""
    rng = np.random.default_rng(5)
    benefits = rng.integers(0, 5, (3, 2, 2)) * (rng.random((3, 2, 2)) < 0.7)
    form = qap.formulate(SAP(benefits.astype(float), SwitchingCost(1.5, idle_is_free=free), [0, 1]))
    assert maximise(form.programme(), relaxed=True).value == pytest.approx(
        textbook(form.a, form.b, form.c), abs=1e-6
    )


def test_two_grids() -> None:
    """Flows on a line of five and distances on a ring: the relaxation finds the optimum, where 0 was claimed before."""
    at = np.arange(5)
    flow = (np.abs(at[:, None] - at) == 1).astype(float)
    apart = np.abs(at[:, None] - at)
    distance = np.minimum(apart, 5 - apart).astype(float)
    assert maximise(adams_johnson(flow, -distance, np.zeros((5, 5))), relaxed=True).value == pytest.approx(
        -8.0
    )


def test_nug5(tmp_path: Path) -> None:
    """The smallest problem of Nugent and others: the relaxation is as large as the optimum, 50."""
    path = tmp_path / "nug5.dat"
    path.write_text(
        "5 50\n0 1 1 2 3\n1 0 2 1 2\n1 2 0 1 2\n2 1 1 0 1\n3 2 2 1 0\n"
        "0 5 2 4 1\n5 0 3 0 2\n2 3 0 0 0\n4 0 0 0 5\n1 2 0 5 0\n"
    )
    read = qap.read_qaplib(path)
    assert max(read.value(np.array(x)) for x in itertools.permutations(range(5))) == -50.0
    assert maximise(read.programme(), relaxed=True).value == pytest.approx(-50.0)
