"""Problems from tables: pandas, pyarrow, mappings, arrays and files say the same, and bad rows are named."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sapopt import SAP, Limit, SwitchingCost
from sapopt.dynamics import Battery

ROWS = {
    "step": [1, 0, 0, 1, 0],
    "agent": ["Eva", "Eva", "Ada", "Ada", "Ada"],
    "task": ["ward", "night", "ward", "night", "night"],
    "benefit": [1.5, 2.0, 0.5, 3, 0.25],
}


def forms(rows: dict[str, list[Any]], folder: Path) -> list[Any]:
    """The same rows in every kind of table."""
    frame = pd.DataFrame(rows)
    frame.to_csv(folder / "t.csv", index=False)
    parquet.write_table(pa.table(rows), folder / "t.parquet")
    return [
        rows, frame, pa.table(rows), frame.to_records(index=False), folder / "t.csv", str(folder / "t.parquet"),
        frame.convert_dtypes(), frame.astype({"agent": "category", "task": "category"}),
        frame.convert_dtypes(dtype_backend="pyarrow"),
    ]  # fmt: skip


def same(a: SAP, b: SAP) -> bool:
    """Whether two problems agree in numbers, names and times."""
    return (a.fingerprint, a.agents, a.tasks, a.times) == (b.fingerprint, b.agents, b.tasks, b.times)


def test_every_kind_of_table(tmp_path: Path) -> None:
    """Names in order of appearance, steps sorted, missing pairs worth 0, whatever holds the columns."""
    wanted = np.zeros((2, 2, 2))
    wanted[0] = [[0.0, 2.0], [0.5, 0.25]]
    wanted[1] = [[1.5, 0.0], [0.0, 3.0]]
    for table in forms(ROWS, tmp_path):
        problem = SAP.from_table(table, SwitchingCost(0.5))
        assert (problem.benefits.dense() == wanted).all()
        assert problem.agents == ("Eva", "Ada")
        assert problem.tasks == ("ward", "night")
        assert problem.times is None


class Lists:
    """A column as polars has it: no array, but a list on demand."""

    def __init__(self, values: list[Any]) -> None:
        self.values = values

    def __len__(self) -> int:
        return len(self.values)

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.array(self.values, dtype=dtype)

    def to_list(self) -> list[Any]:
        """The values."""
        return self.values


class Frame:
    """A frame as polars has it."""

    columns = tuple(ROWS)

    def __getitem__(self, name: str) -> Lists:
        return Lists(ROWS[name])


def test_a_frame_in_the_manner_of_polars() -> None:
    """Names of columns and columns by name are all that a frame needs."""
    assert same(SAP.from_table(Frame()), SAP.from_table(ROWS))


ZONE = ZoneInfo("Europe/Berlin")


@pytest.mark.parametrize(
    "stamps",
    [
        [datetime(2026, 3, 1, 6), datetime(2026, 3, 1, 7)],
        [datetime(2026, 10, 25, hour, tzinfo=UTC).astimezone(ZONE) for hour in (0, 1)],
        [datetime(2026, 3, 1, 6, tzinfo=UTC), datetime(2026, 3, 1, 6, 0, 0, 1, tzinfo=UTC)],
        [10, 20], [0.5, 1.5], ["2026-03-01T06:00+01:00", "2026-03-01T07:00+01:00"],
    ],
)  # fmt: skip
def test_times_are_kept(stamps: list[Any], tmp_path: Path) -> None:
    """Time stamps keep their zone and moment, also twice the same hour on the wall; a file brings them back."""
    rows = {**ROWS, "step": [stamps[k] for k in ROWS["step"]]}
    wanted = SAP.from_table(rows)
    assert wanted.times is not None
    for table in [rows, pd.DataFrame(rows), pa.table(rows)]:
        problem = SAP.from_table(table)
        assert same(problem, wanted)
        assert (problem.benefits.dense() == SAP.from_table(ROWS).benefits.dense()).all()
        problem.save(tmp_path / "p.npz")
        again = SAP.load(tmp_path / "p.npz")
        assert same(again, problem)
        assert [str(t) for t in again.times or ()] == [str(t) for t in problem.times or ()]


def test_one_moment_in_two_zones() -> None:
    """Rows that write one moment in two zones belong to one step."""
    clocks = ["07:00Z", "06:00Z", "07:00+01:00", "08:00+01:00", "06:00Z"]
    rows = {**ROWS, "step": [f"2026-03-01T{clock}" for clock in clocks]}
    problem = SAP.from_table(rows)
    assert problem.T == 2
    assert (problem.benefits.dense() == SAP.from_table(ROWS).benefits.dense()).all()


def test_forbidden_pairs() -> None:
    """A column of true and false, -inf, and missing pairs forbid; the benefit of a forbidden row does not matter."""
    rows = {
        **ROWS,
        "off": [False, True, False, False, False],
        "benefit": [1.5, float("nan"), 0.5, 3, -np.inf],
    }
    problem = SAP.from_table(rows, forbidden="off", idle=True)
    closed = np.isneginf(problem.benefits.dense())
    assert not closed[1].any()
    assert closed[0].tolist() == [[False, True], [False, True]]
    strict = SAP.from_table(
        {**ROWS, "task": ["ward", "night", "ward", "night", "night"]}, missing="forbidden"
    )
    assert np.isneginf(strict.benefits.dense()).sum() == 3


def test_the_rest_of_the_problem() -> None:
    """Capacities and first tasks by name, limits and idleness as ever, names in an order of one's own."""
    problem = SAP.from_table(
        ROWS, Battery(0.5), idle=True, capacity={"night": 2}, limits=[Limit.once(["night"])],
        initial_assignment={"Ada": "night", "Bo": None, "Eva": None}, agents=["Ada", "Bo", "Eva"],
    )  # fmt: skip
    assert problem.agents == ("Ada", "Bo", "Eva")
    assert problem.capacity is not None
    assert problem.capacity[0].tolist() == [1, 2]
    assert problem.initial_assignment is not None
    assert problem.initial_assignment.tolist() == [1, -1, -1]
    assert problem.rows.names


@given(st.integers(0, 2**32 - 1))
def test_random_problems_survive(seed: int) -> None:
    """Any benefits, written as rows in any order, come back as the same problem, held sparse where it is."""
    rng = np.random.default_rng(seed)
    T, n, m = (int(x) for x in rng.integers(1, 5, 3))
    values = np.where(rng.random((T, n, m)) < 0.4, 0.0, rng.normal(size=(T, n, m)))
    cells = rng.permutation(T * n * m)
    step, agent, task = np.unravel_index(cells, (T, n, m))
    rows = {"k": step, "who": [f"a{i}" for i in agent], "what": task, "worth": values.ravel()[cells]}
    problem = SAP.from_table(
        pd.DataFrame(rows), 0.5, step="k", agent="who", task="what", benefit="worth", idle=True,
        agents=[f"a{i}" for i in range(n)], tasks=[str(j) for j in range(m)],
    )  # fmt: skip
    straight = SAP(values, 0.5, idle=True)
    assert problem.fingerprint == straight.fingerprint
    assert problem.benefits.is_sparse == straight.benefits.is_sparse


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        ({"benefit": [1, 2, np.nan, 4, 5]}, {}, "benefit: row 2 .* has no value"),
        ({"benefit": [1, 2, None, 4, 5]}, {}, "benefit: row 2 .* has no value"),
        ({"benefit": [1, 2, np.inf, 4, 5]}, {}, "benefit: row 2 .* is infinite"),
        ({"benefit": [1, 2, "much", 4, 5]}, {}, "benefit: row 2 .* holds 'much', no number"),
        ({"task": ["ward", "night", "ward", "night", "ward"]}, {}, "rows 2 and 4 .* 'Ada' gains from 'ward' at step 0"),
        ({"agent": ["Eva", None, "Ada", "Ada", "Ada"]}, {}, "agent: row 1 .* has no value"),
        ({"step": ["Mon", "Tue", "Mon", "Mon", "Tue"]}, {}, "step: row 0 .*: 'Mon' is neither a number nor a time"),
        ({"step": [0, datetime(2026, 1, 1), 0, 0, 0]}, {}, "step: 0 is a number, 2026-01-01 .* use one kind"),
        ({}, {"step": "time"}, "there is no column 'time'"),
        ({}, {"benefit": "benefits"}, "did you mean 'benefit'?"),
        ({}, {"missing": "worthless"}, "missing must be 'zero' or 'forbidden'"),
        ({}, {"agents": ["Ada"]}, "agents: row 0 .* names 'Eva', which is not among them"),
        ({}, {"tasks": ["ward", "night", "ward"]}, "tasks: a name is listed twice"),
        ({}, {"forbidden": "benefit"}, "benefit: row 0 .* is neither true nor false"),
        ({}, {"times": [1, 2]}, "times: a table brings its own"),
        ({}, {"capacity": {"lab": 2}}, "capacity: there is none called 'lab'"),
        ({}, {"initial_assignment": {"Ada": "ward"}}, "initial_assignment: 'Eva' is not in it"),
        ({}, {"initial_assignment": {"Ada": "ward", "Eva": "lab"}}, "initial_assignment: there is no task 'lab'"),
        ({"step": [], "agent": [], "task": [], "benefit": []}, {}, "it has no rows"),
    ],
)  # fmt: skip
def test_bad_rows(change: dict[str, Any], options: dict[str, Any], words: str) -> None:
    """Each bad row or argument ends in one line that names it, in every kind of table that can hold it."""
    rows = {**ROWS, **change}
    for table in (rows, pd.DataFrame(rows)):
        with pytest.raises(ValueError, match=words):
            SAP.from_table(table, **options)


def test_files_that_are_no_tables(tmp_path: Path) -> None:
    """A wrong suffix, a missing file and a row that is too long are told."""
    with pytest.raises(ValueError, match=r"only \.csv and \.parquet"):
        SAP.from_table(tmp_path / "t.xlsx")
    with pytest.raises(FileNotFoundError):
        SAP.from_table(tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("step,agent,task,benefit\n0,a,b,1\n0,a,c,1,5\n")
    with pytest.raises(ValueError, match="line 3: 5 fields, the first line has 4"):
        SAP.from_table(tmp_path / "t.csv")
    with pytest.raises(ValueError, match="table must have columns"):
        SAP.from_table(3)


def test_a_csv_keeps_labels_such_as_007(tmp_path: Path) -> None:
    """A column of digits with leading zeros holds names, not numbers."""
    (tmp_path / "t.csv").write_text(
        "step,agent,task,benefit\n0,007,1,0.5\n1,008,2,-inf\n", encoding="utf-8-sig"
    )
    problem = SAP.from_table(tmp_path / "t.csv", idle=True)
    assert problem.agents == ("007", "008")
    assert problem.tasks == ("1", "2")


def test_times_need_their_order() -> None:
    """Times are one for each step, of one kind, ascending; without a table as well."""
    cube = np.ones((2, 1, 1))
    day = datetime(2026, 3, 29, tzinfo=ZONE)
    assert SAP(cube, times=[day, day + timedelta(hours=1)]).times is not None
    assert SAP(cube, times=np.array(["2026-03-01", "2026-03-02"], dtype="datetime64[D]")).times == (
        datetime(2026, 3, 1), datetime(2026, 3, 2),
    )  # fmt: skip
    for times, words in (
        ([1], "1 times for 2 steps"), ([2, 1], "step 1 begins at 1, not after step 0"), ([day, day], "not after"),
        ("ab", "must be a list of 2"), ([1, "x"], "step 1: 'x' is neither"), ([1, True], "neither a number nor a time"),
        ([0, np.nan], "step 1: nan is not finite"), ([day, datetime(2027, 1, 1)], "use one kind"),
        (np.array([0, 1], dtype="datetime64[ns]"), "step 1: .* no time in whole microseconds"),
        ([pd.Timestamp(0), pd.Timestamp(1)], "step 1: .* no time in whole microseconds"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            SAP(cube, times=times)
