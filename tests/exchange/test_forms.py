"""Plans that go out as tables and files, and come back: the same plan, the same score, in every form."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import openpyxl
import pandas as pd
import pyarrow.parquet as parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st
from limited_problems import tiny

from sapopt import SAP, Result, SwitchingCost
from sapopt.exchange import write_csv, write_excel, write_json, write_parquet
from sapopt.exchange.forms import FORMS

BERLIN = ZoneInfo("Europe/Berlin")
TIMES: dict[str, Callable[[int], list[Any] | None]] = {
    "none": lambda T: None,
    "numbers": lambda T: [10 + 5 * k for k in range(T)],
    "naive": lambda T: [datetime(2026, 3, 1, 6) + timedelta(minutes=k) for k in range(T)],
    "utc": lambda T: [datetime(2026, 3, 1, 6, tzinfo=UTC) + timedelta(hours=k) for k in range(T)],
    # through the hour that the wall clock shows twice
    "autumn": lambda T: [
        (datetime(2026, 10, 24, 23, tzinfo=UTC) + timedelta(hours=k)).astimezone(BERLIN) for k in range(T)
    ],
}


def roster(times: str = "none", named: bool = True, seed: int = 0) -> Result:
    """A plan for three nurses, some of whom rest."""
    rng = np.random.default_rng(seed)
    T, n, m = 6, 3, 4
    problem = SAP(
        rng.random((T, n, m)).round(3), SwitchingCost(0.25), idle=True, times=TIMES[times](T),
        agents=["Åsa", "=2+3", "O'Neil, Bo"] if named else None,
        tasks=["ward", "-1", "night shift", "3"] if named else None,
    )  # fmt: skip
    plan = np.array([rng.permutation([-1, -1, 0, 1, 2, 3])[:n] for _ in range(T)])
    return Result.from_plan(problem, np.repeat(plan[::2], 2, axis=0))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("times", TIMES)
def test_every_form_comes_back(times: str, named: bool, form: Any, tmp_path: Path) -> None:
    """A plan that goes out as a frame, CSV, Parquet, Excel or JSON and comes back is the same plan."""
    result = roster(times, named)
    problem = result.problem
    assert problem is not None
    write_csv(result, tmp_path / "p.csv", form)
    write_parquet(result, tmp_path / "p.parquet", form)
    write_json(result, tmp_path / "p.json", form)
    told = json.loads((tmp_path / "p.json").read_text("utf-8"))
    back: list[Any] = [
        result.to_pandas(form), tmp_path / "p.csv", tmp_path / "p.parquet",
        pd.read_csv(tmp_path / "p.csv"), pd.read_parquet(tmp_path / "p.parquet"),
        parquet.read_table(tmp_path / "p.parquet"),
        {key: [row[key] for row in told[form]] for key in told[form][0]},
    ]  # fmt: skip
    if times != "autumn":  # Excel knows no zones
        write_excel(result, tmp_path / "p.xlsx", form)
        back.append(pd.read_excel(tmp_path / "p.xlsx"))
    for table in back:
        again = Result.from_plan(problem, table)
        assert (again.plan == result.plan).all()
        assert again.value == result.value


@given(st.integers(0, 2**32 - 1), st.sampled_from(FORMS))
def test_stays_make_up_the_plan(seed: int, form: Any) -> None:
    """Stays and tables of random plans with capacities and idleness come back as the same plan, with the same score."""
    rng = np.random.default_rng(seed)
    made = tiny(rng)
    if made is None:
        return
    rows = list(made.plans())
    plan = rows[int(rng.integers(len(rows)))]
    if made.value(plan) is None:
        return
    result = Result.from_plan(made.problem, plan)
    for table in (result.stays(), result.to_pandas(form)):
        if made.problem.idle or len(table):
            assert (Result.from_plan(made.problem, table).plan == np.array(plan)).all()
    for stay in result.stays():
        held = result.plan[stay.start : stay.stop, stay.agent]  # type: ignore[misc]
        assert (held == stay.task).all()
        assert stay.start == 0 or result.plan[int(stay.start) - 1, stay.agent] != stay.task  # type: ignore[arg-type,call-overload]


@given(st.integers(0, 2**32 - 1))
def test_stays_add_up(seed: int) -> None:
    """Benefits and handovers of the stays, with the rewards and penalties beside them, are the value."""
    rng = np.random.default_rng(seed)
    made = tiny(rng)
    if made is None:
        return
    rows = list(made.plans())
    plan = rows[int(rng.integers(len(rows)))]
    if made.value(plan) is None:
        return
    result = Result.from_plan(made.problem, plan)
    total = sum(stay.benefit + stay.handover for stay in result.stays()) + result.evaluation.teams
    assert total - sum(use.cost for use in result.evaluation.limits) == pytest.approx(result.value, abs=1e-9)


def test_stay_in_words() -> None:
    """Names, times by the clock of the zone, an exclusive end, and what it earned."""
    result = roster("autumn")
    first = result.stays()[0]
    assert first.agent == "Åsa"
    assert first.start.tzinfo is BERLIN  # type: ignore[union-attr]
    table = result.to_pandas()
    assert list(table.columns) == ["agent", "task", "start", "stop", "benefit", "handover"]
    assert str(table["start"].dtype) == "datetime64[us, Europe/Berlin]"
    hours = (table["stop"] - table["start"]).dt.total_seconds() / 3600
    assert hours.sum() == (result.plan >= 0).sum()
    assert result.to_pandas("wide").index.name == "step"


def test_the_fold_is_told_apart_or_refused(tmp_path: Path) -> None:
    """Where the wall clock shows an hour twice, a table without zones is refused in one line."""
    result = roster("autumn")
    assert result.problem is not None
    write_excel(result, tmp_path / "p.xlsx", "long")
    with pytest.raises(
        ValueError, match=r"row 3 .* two steps of the problem begin or end at 2026-10-25T02:00:00"
    ):
        Result.from_plan(result.problem, pd.read_excel(tmp_path / "p.xlsx"))


def test_excel_holds_names_as_text(tmp_path: Path) -> None:
    """A name that begins with = is no formula, times are dates, and the head names the zone."""
    write_excel(roster("utc"), tmp_path / "p.xlsx")
    sheet = openpyxl.load_workbook(tmp_path / "p.xlsx").active
    cells = [[cell.value for cell in row] for row in sheet.rows]
    assert cells[0] == ["agent", "task", "start (UTC)", "stop (UTC)", "benefit", "handover"]
    kinds = {cell.value: cell.data_type for cell in sheet["A"]}
    assert kinds["=2+3"] == "s"
    assert isinstance(cells[1][2], datetime)


def test_excel_refuses_what_no_sheet_holds(tmp_path: Path) -> None:
    """Control characters and too many columns end in one line, and leave no file."""
    problem = SAP(np.ones((1, 1, 1)), tasks=["a\x07b"])
    with pytest.raises(ValueError, match="no cell of Excel can hold"):
        write_excel(Result.from_plan(problem, [[0]]), tmp_path / "p.xlsx")
    wide = SAP([np.zeros((17_000, 1))], idle=True)
    with pytest.raises(ValueError, match="more than a sheet of Excel holds"):
        write_excel(Result.from_plan(wide, np.full((1, 17_000), -1)), tmp_path / "p.xlsx", "wide")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"agent": ["Åsa"], "task": ["ward"]}, "must have the columns agent, task, start and stop, or step"),
        ({"step": [0], "agent": ["Eva"], "task": ["ward"]}, "row 0 .*: there is no agent 'Eva'; the first .* 'Åsa'"),
        ({"step": [0], "agent": ["Åsa"], "task": ["lab"]}, "there is no task 'lab'"),
        ({"step": [6], "agent": ["Åsa"], "task": ["ward"]}, "6 is no step from 0 to 5"),
        ({"step": ["x"], "agent": ["Åsa"], "task": ["ward"]}, "'x' is no step"),
        ({"step": [0, 0], "agent": ["Åsa"] * 2, "task": ["ward", None]}, "row 1 .* again what 'Åsa' does at step 0"),
        ({"step": [0], "Eva": ["ward"]}, "there is no agent 'Eva'"),
        ({"step": [0, 0], "agent": ["Åsa", "=2+3"], "task": ["ward"] * 2}, "given to agents"),
        ({"agent": ["Åsa"], "task": ["ward"], "start": [2], "stop": [2]}, "row 0 .* stops before it starts"),
        ({"agent": ["Åsa"], "task": ["ward"], "start": [2], "stop": [7]}, "7 is no step from 1 to 6"),
        (7, "table must have columns"),
    ],
)  # fmt: skip
def test_bad_tables(table: Any, words: str) -> None:
    """What is wrong is told with the row and the name."""
    problem = roster().problem
    assert problem is not None
    with pytest.raises(ValueError, match=words):
        Result.from_plan(problem, table)


def test_everybody_must_work_where_nobody_may_idle() -> None:
    """A table that leaves an agent out is refused with its name."""
    problem = SAP(np.ones((2, 2, 2)), agents=["Ada", "Bo"])
    with pytest.raises(ValueError, match="'Bo' has no task at step 1"):
        Result.from_plan(problem, {"step": [0, 1], "Ada": [0, 1], "Bo": [1, None]})


def test_a_result_from_a_file_asks_for_its_problem(tmp_path: Path) -> None:
    """Without the problem nobody knows names and benefits; a problem of another size is refused."""
    result = roster()
    result.save(tmp_path / "r.npz")
    again = Result.load(tmp_path / "r.npz")
    with pytest.raises(ValueError, match="does not hold its problem"):
        again.stays()
    assert again.stays(result.problem) == result.stays()
    again.to_csv(tmp_path / "p.csv", problem=result.problem)
    with pytest.raises(ValueError, match="plan must have shape"):
        again.to_pandas("wide", SAP(np.ones((2, 2, 2))))
    with pytest.raises(ValueError, match="form must be one of 'stays', 'wide', 'long', got 'tall'"):
        result.to_pandas("tall")  # type: ignore[arg-type]


def test_many_columns() -> None:
    """A wide table of more agents than pandas likes to insert one by one comes back without a warning."""
    problem = SAP(np.ones((2, 150, 150)), agents=[f"a{i}" for i in range(150)])
    result = Result.from_plan(problem, np.tile(np.arange(150), (2, 1)))
    assert (Result.from_plan(problem, result.to_pandas("wide")).plan == result.plan).all()


def test_names_that_are_not_unique() -> None:
    """Two agents of one name have no columns of their own, and cannot be told apart in a table."""
    problem = SAP(np.ones((2, 2, 2)), agents=["Ada", "Ada"])
    result = Result.from_plan(problem, [[0, 1], [0, 1]])
    with pytest.raises(ValueError, match="each needs a name of its own"):
        result.to_pandas("wide")
    with pytest.raises(ValueError, match="two have one name"):
        Result.from_plan(problem, result.to_pandas("long"))


@pytest.mark.parametrize("module", ["pandas", "openpyxl", "pyarrow"])
def test_a_missing_package_is_named(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the extra, one line says what to install; CSV and JSON need nothing."""
    monkeypatch.setitem(__import__("sys").modules, module, None)
    result = roster()
    way: dict[str, Callable[[], Any]] = {
        "pandas": result.to_pandas,
        "openpyxl": lambda: write_excel(result, tmp_path / "p.xlsx"),
        "pyarrow": lambda: write_parquet(result, tmp_path / "p.parquet"),
    }
    with pytest.raises(ImportError, match=rf"needs {module}: pip install 'sapopt\[tables\]'"):
        way[module]()
    result.to_csv(tmp_path / "p.csv")
    write_json(result, tmp_path / "p.json")
