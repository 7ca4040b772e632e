"""Results: what is read from them, and files that bring back every field."""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sapopt import SAP, Evaluation, LimitUse, Result, Status, solve
from sapopt.solvers import HAA

LIMITS = (LimitUse("once[0]", 1.0, 1.0, float("-inf")), LimitUse("work[1]", 2.5, 2.0, 0.0, 0.25))
EVALUATION = Evaluation(1.75, np.array([1.0, 1.25]), np.array([0.0, -0.5]), 3, LIMITS, 0.75)
FULL = Result(
    plan=np.array([[0, 1], [2, 0]]),
    evaluation=EVALUATION,
    status=Status.TIME_LIMIT,
    runtime=0.125,
    solver="HAAL(L=2)",
    bound=2.0,
    trace=[{"step": 0, "value": 1.0, "note": "a"}, {"step": 1, "value": float("inf"), "note": None}],
    seed=7,
    prices=np.array([[0.0, 0.5, 0.0], [0.25, 0.0, 0.0]]),
    problem=SAP(np.ones((2, 2, 3))),
    limit_prices=np.array([0.5, -0.25]),
    team_prices=np.array([0.125]),
)
WRITTEN = [field.name for field in dataclasses.fields(Result) if field.name != "problem"]


def same(a: Any, b: Any) -> bool:
    """Equality by type and value, through dataclasses and arrays."""
    if type(a) is not type(b):
        return False
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b)
    return bool(a == b)


def test_the_full_result_has_no_default() -> None:
    """The round trip below cannot miss a field: every one is set to something else than its default."""
    for field in dataclasses.fields(Result):
        value = getattr(FULL, field.name)
        if field.default is not dataclasses.MISSING:
            assert value is not None
            assert not same(value, field.default), field.name
        if field.default_factory is not dataclasses.MISSING:
            assert not same(value, field.default_factory()), field.name


@pytest.mark.parametrize("missing", ["nothing", "bound", "prices", "trace"])
def test_round_trip(tmp_path: Path, missing: str) -> None:
    """Every field comes back with its type, but for the problem, which has files of its own."""
    result = FULL
    if missing != "nothing":
        result = dataclasses.replace(FULL, **{missing: [] if missing == "trace" else None})
    result.save(tmp_path / "r.npz")
    again = Result.load(tmp_path / "r.npz")
    for name in WRITTEN:
        assert same(getattr(again, name), getattr(result, name)), name
    assert again.problem is None


def test_pickles_leave_the_problem_behind() -> None:
    """A result that crosses processes is small; everything else arrives."""
    again = pickle.loads(pickle.dumps(FULL))
    assert again.problem is None
    assert FULL.problem is not None
    for name in WRITTEN:
        assert same(getattr(again, name), getattr(FULL, name)), name


def test_report_in_one_call(tmp_path: Path) -> None:
    """A fresh result writes its page; one from a file asks for its problem, and refuses another one."""
    problem = SAP(np.random.default_rng(0).random((4, 2, 3)), 0.2)
    result = solve(problem, HAA())
    assert result.problem is problem
    page = result.report(tmp_path / "r.html", title="two nurses")
    assert "<title>two nurses" in page.read_text("utf-8")
    with pytest.raises(ValueError, match="exists already"):
        result.report(page)
    for nowhere in (tmp_path, tmp_path / "none" / "r.html"):
        with pytest.raises(ValueError, match="name a file in a folder that exists"):
            result.report(nowhere)
    with pytest.raises(ValueError, match="problem must be a SAP, got ndarray"):
        result.report(tmp_path / "other.html", np.ones((4, 2, 3)))
    result.save(tmp_path / "r.npz")
    again = Result.load(tmp_path / "r.npz")
    with pytest.raises(ValueError, match="does not hold its problem"):
        again.report(tmp_path / "again.html")
    with pytest.raises(ValueError, match="pass the problem that was solved"):
        again.report(tmp_path / "again.html", SAP(np.ones((4, 2, 3))))
    again.report(tmp_path / "again.html", problem, title="two nurses")
    assert (tmp_path / "again.html").read_bytes() == page.read_bytes()


@pytest.mark.parametrize("status", Status)
def test_every_status(tmp_path: Path, status: Status) -> None:
    """Every status is written and read, and says what it means in a sentence of its own."""
    dataclasses.replace(FULL, status=status).save(tmp_path / "r.npz")
    assert Result.load(tmp_path / "r.npz").status is status
    assert status.message.endswith(".")
    assert len({other.message for other in Status}) == len(Status)


def test_numpy_numbers_are_written(tmp_path: Path) -> None:
    """Solvers may leave numpy numbers in their traces."""
    trace = [{"step": np.int64(3), "value": np.float64(0.5), "done": np.bool_(True)}]
    dataclasses.replace(FULL, trace=trace, bound=np.float64(2.0)).save(tmp_path / "r.npz")
    assert Result.load(tmp_path / "r.npz").trace == [{"step": 3, "value": 0.5, "done": True}]


def test_what_cannot_be_written_leaves_no_file(tmp_path: Path) -> None:
    """A trace that holds objects is refused before anything is written."""
    with pytest.raises(TypeError, match="cannot be written"):
        dataclasses.replace(FULL, trace=[{"solver": object()}]).save(tmp_path / "r.npz")
    assert list(tmp_path.iterdir()) == []


def test_damaged_files(tmp_path: Path) -> None:
    """A cut file, a problem, and a header without its parts are each a ValueError."""
    path = tmp_path / "r.npz"
    FULL.save(path)
    content = path.read_bytes()
    for length in range(0, len(content), 101):
        path.write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"r\.npz"):
            Result.load(path)
    SAP(np.ones((2, 2, 2))).save(path)
    with pytest.raises(ValueError, match="sapopt-problem-1"):
        Result.load(path)
    for header in ({}, {"status": "HAPPY"}, {"status": ["FEASIBLE"]}):
        text = str({"format": "sapopt-result-1", "arrays": [], **header}).replace("'", '"')
        np.savez(path, meta=np.array(text))
        with pytest.raises(ValueError, match="damaged"):
            Result.load(path)


@pytest.mark.parametrize(
    ("bound", "value", "gap"),
    [
        (None, 1.0, None), (2.0, 1.5, 0.25), (2.0, 2.0, 0.0), (-2.0, -3.0, 0.5), (4.0, -4.0, 2.0),
        (0.0, 0.0, 0.0), (0.0, -1.0, float("inf")),
    ],
)  # fmt: skip
def test_gap(bound: float | None, value: float, gap: float | None) -> None:
    """(bound - value) / |bound|, with a bound of zero and without any."""
    result = dataclasses.replace(FULL, bound=bound, evaluation=dataclasses.replace(EVALUATION, value=value))
    assert result.gap == gap
    assert "gap" not in repr(result) if gap is None else "gap" in repr(result)


def test_with_bound_keeps_the_tighter() -> None:
    """A bound from elsewhere replaces none or a looser one."""
    bare = dataclasses.replace(FULL, bound=None)
    assert bare.with_bound(3.0).bound == 3.0
    assert FULL.with_bound(3.0).bound == 2.0
    assert FULL.with_bound(1.9).bound == 1.9
    assert FULL.bound == 2.0


def test_shortcuts() -> None:
    """Value and handovers are those of the evaluation; the text shows what matters."""
    assert (FULL.value, FULL.handovers) == (1.75, 3)
    for part in (
        "HAAL(L=2)",
        "value=1.75",
        "bound=2",
        "gap=12.5 %",
        "handovers=3",
        "time limit",
        "T=2",
        "n=2",
    ):
        assert part in repr(FULL)
