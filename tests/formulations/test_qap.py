"""The Koopmans-Beckmann form of eq. 1.4, its files, and its relaxations."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from local_dynamics import Tiring

from sapopt import SAP, SwitchingCost, solve
from sapopt.formulations import qap, relaxation
from sapopt.formulations.highs import maximise
from sapopt.solvers.exact import Exact


def problems() -> list[SAP]:
    """Every cost rule with and without an initial assignment."""
    out = []
    for seed, (matrix, free, initial) in enumerate(
        itertools.product((False, True), (False, True), (None, (1, 0)))
    ):
        rng = np.random.default_rng(seed)
        benefits = rng.random((3, 2, 3)) * (rng.random((3, 2, 3)) < 0.6)
        cost: Any = rng.random((3, 3)) * (1 - np.eye(3)) if matrix else 0.4
        out.append(SAP(benefits, SwitchingCost(cost, idle_is_free=free), initial))
    return out


@pytest.mark.parametrize("problem", problems(), ids=repr)
def test_value_of_every_plan(problem: SAP) -> None:
    """The quadratic objective is the value of the plan, for all plans; plans come back unchanged."""
    form = qap.formulate(problem)
    assert form.a.shape == (6, 6)
    assert form.b.shape[0] == form.c.shape[1] >= 9
    rows = list(itertools.permutations(range(3), 2))
    for choice in itertools.product(rows, repeat=3):
        plan = np.array(choice)
        places = form.locations(plan)
        assert form.value(places) == pytest.approx(problem.evaluate(plan).value, abs=1e-12)
        assert np.array_equal(form.plan(places), plan)


def test_block_diagonal() -> None:
    """A facility may only go to a location of its own step, and `a` joins successive steps of one agent."""
    problem = SAP(np.random.default_rng(0).random((3, 2, 4)), SwitchingCost(0.5))
    form = qap.formulate(problem)
    blocks = np.kron(np.eye(3), np.ones((2, 4)))
    assert np.array_equal(np.isfinite(form.c), blocks > 0)
    assert np.array_equal(form.a, np.eye(6, k=2))


@pytest.mark.parametrize("problem", problems()[:4], ids=repr)
def test_qaplib_round_trip(problem: SAP, tmp_path: Path) -> None:
    """A written file is square and finite, reads back exactly, and has the same optimum with its sign turned."""
    form = qap.formulate(problem)
    path = tmp_path / "problem.dat"
    form.write_qaplib(path)
    again = qap.read_qaplib(path)
    size = len(form.b)
    assert again.a.shape == again.b.shape == again.c.shape == (size, size)
    assert np.array_equal(again.b, form.b)
    assert np.array_equal(again.a[: len(form.a), : len(form.a)], form.a)
    finite = np.isfinite(form.c)
    assert np.array_equal(again.c[: len(form.a)][finite], form.c[finite])
    again.write_qaplib(tmp_path / "again.dat")
    third = qap.read_qaplib(tmp_path / "again.dat")
    assert all(np.array_equal(getattr(third, name), getattr(again, name)) for name in "abc")
    answer = maximise(again.programme())
    assert answer.value == pytest.approx(solve(problem, Exact("dp")).value, abs=1e-6)


def test_small_qaplib_instance(tmp_path: Path) -> None:
    """A file without a linear part is a plain QAP; its optimum is that of all permutations."""
    rng = np.random.default_rng(7)
    a, b = rng.integers(0, 9, (2, 4, 4))
    path = tmp_path / "small.dat"
    path.write_text("4\n\n" + "\n\n".join("\n".join(" ".join(map(str, row)) for row in x) for x in (a, b)))
    form = qap.read_qaplib(path)
    orders = [np.array(order) for order in itertools.permutations(range(4))]
    least = min((a * b[np.ix_(order, order)]).sum() for order in orders)
    answer = maximise(form.programme())
    assert answer.x is not None
    assert -answer.value == pytest.approx(least)
    assert form.value(qap.locations_of(form, answer.x)) == pytest.approx(-least)


def test_headers_marks_and_commas(tmp_path: Path) -> None:
    """``n value`` as header, a byte order mark, commas, and lines broken anywhere are read as the plain file is."""
    rng = np.random.default_rng(3)
    numbers = rng.integers(0, 9, (2, 4, 4))
    path = tmp_path / "x.dat"

    def read(text: str, encoding: str = "utf-8") -> qap.QAP:
        path.write_text(text, encoding=encoding)
        return qap.read_qaplib(path)

    words = [str(v) for v in numbers.ravel()]
    plain = read("4\n" + "\n".join(words))
    assert np.array_equal(plain.a, numbers[0])
    for other in (
        read("4 123\n\n" + " ".join(words)), read("\n 4  -12.5\r\n" + "\r\n".join(words)),
        read("4\n" + ",".join(words), "utf-8-sig"), read("4 99\n" + " ".join(words), "utf-16"),
        read("4 " + " ".join(words)),
    ):  # fmt: skip
        assert np.array_equal(other.a, plain.a)
        assert np.array_equal(other.b, plain.b)
    one = read("1 6\n2\n3\n")
    assert (one.a.item(), one.b.item()) == (2.0, -3.0)


@pytest.mark.parametrize("word", ["nan", "inf", "-inf", "1_0", "1e999", "\u0661", "0x1"])
def test_what_is_no_number_is_told_by_line(word: str, tmp_path: Path) -> None:
    """Words that float() would take are refused too, with the line."""
    path = tmp_path / "x.dat"
    path.write_text(f"2\n1 2 3 4\n5 6 {word} 8\n")
    with pytest.raises(ValueError, match=r"x\.dat, line 3: not a QAPLIB file"):
        qap.read_qaplib(path)


def test_solution_file(tmp_path: Path) -> None:
    """A written solution is read back from 0, with its cost; what is no permutation is refused."""
    path = tmp_path / "x.sln"
    for text in ("3 7\n2 3 1\n", "3\n7\n2,3,1", "  3   7 2 3\n1"):
        path.write_text(text)
        cost, locations = qap.read_qaplib_solution(path)
        assert cost == 7.0
        assert locations.tolist() == [1, 2, 0]
    for text in ("", "3 7\n2 2 1", "3 7\n2 3", "3 7\n0 1 2", "3 nan\n2 3 1", "2.5 1\n1 2", "three"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"x\.sln.*not a QAPLIB"):
            qap.read_qaplib_solution(path)


def test_assignment_file(tmp_path: Path) -> None:
    """An OR-Library file of one cost matrix is a problem of one step, whose optimum is the least cost."""
    path = tmp_path / "assign3.txt"
    path.write_text("3\n 4 1 3\n 2 0 5\n 3 2\n 2\n")
    costs = qap.read_assignment(path)
    assert costs.tolist() == [[4, 1, 3], [2, 0, 5], [3, 2, 2]]
    assert solve(SAP(-costs[None]), Exact("dp")).value == -5.0
    for text in ("", "3 1 2", "2 1 2 3 4 5", "1 nan", "1.5 2", "0", "2 1 2 3 x"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"assign3\.txt.*not a"):
            qap.read_assignment(path)


@pytest.mark.parametrize("text", ["", "x", "3 1 2", "2 1 2 3 4 5 6 7", "-1 2", "2 1 2 3 4 5 6 7 nine"])
def test_damaged_file(text: str, tmp_path: Path) -> None:
    """A file of another kind gives one clear line."""
    path = tmp_path / "bad.dat"
    path.write_text(text)
    with pytest.raises(ValueError, match="not a QAPLIB file"):
        qap.read_qaplib(path)


def test_other_dynamics_is_refused() -> None:
    """Only costs between successive tasks have this form."""
    with pytest.raises(ValueError, match=r"eq\. 1\.4"):
        qap.formulate(SAP(np.ones((2, 2, 3)), Tiring()))


@pytest.mark.parametrize("problem", problems()[:6], ids=repr)
def test_relaxations_bound_the_optimum(problem: SAP) -> None:
    """Convex and semidefinite bounds hold; the semidefinite one is the better one."""
    best = solve(problem, Exact("dp")).value
    linear, convex, semidefinite = (
        bound(problem).value
        for bound in (relaxation.linear_bound, relaxation.convex_bound, relaxation.semidefinite_bound)
    )
    assert min(linear, convex, semidefinite) >= best
    assert semidefinite <= convex + 1e-4


def test_semidefinite_size() -> None:
    """The semidefinite relaxation refuses what would never end."""
    with pytest.raises(ValueError, match="too many"):
        relaxation.semidefinite_bound(SAP(np.ones((5, 6, 6)), SwitchingCost(1.0)))
