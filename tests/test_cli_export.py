"""`sapopt export`: every kind of file, read by the readers of others, and bad arguments in one line."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import highspy
import numpy as np
import pandas as pd
import pytest
from command_line import error_line, run
from czml3 import Document

from sapopt import SAP, Result, SwitchingCost, solve
from sapopt.solvers import HAA

READERS = {".csv": pd.read_csv, ".xlsx": pd.read_excel, ".parquet": pd.read_parquet}


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `compare --out` leaves behind about a small constellation."""
    out = tmp_path_factory.mktemp("export") / "toy"
    outcome = run("compare", "constellation-toy", "--solvers", "greedy,haa", "--time-limit", 2, "--out", out)
    assert outcome.exit_code == 0, outcome.output
    return out


@pytest.fixture
def roster(tmp_path: Path) -> tuple[Path, Path, Result]:
    """A saved result and its problem, with names and dates."""
    problem = SAP(
        np.random.default_rng(0).random((4, 2, 3)), SwitchingCost(0.2), agents=["Ada", "Bo"], tasks=["x", "y", "z"],
        times=[f"2026-03-0{day}" for day in range(1, 5)],
    )  # fmt: skip
    result = solve(problem, HAA())
    problem.save(tmp_path / "p.npz")
    result.save(tmp_path / "r.npz")
    return tmp_path / "r.npz", tmp_path / "p.npz", result


@pytest.mark.parametrize("form", ["stays", "wide", "long"])
@pytest.mark.parametrize("suffix", READERS)
def test_tables(roster: tuple[Path, Path, Result], suffix: str, form: str, tmp_path: Path) -> None:
    """pandas reads every table, and the plan comes back with the same value."""
    saved, problem, result = roster
    out = tmp_path / f"plan{suffix}"
    assert run("export", saved, problem, "--to", out, "--form", form).exit_code == 0
    again = Result.from_plan(SAP.load(problem), READERS[suffix](out))
    assert again.value == result.value
    assert "Ada" in str(READERS[suffix](out).to_dict("list"))


def test_json(roster: tuple[Path, Path, Result], tmp_path: Path) -> None:
    """JSON on disk holds the plan, JSON on stdout what was done."""
    saved, problem, result = roster
    outcome = run("export", saved, problem, "--to", tmp_path / "plan.json", "--json")
    told = json.loads(outcome.stdout)
    assert told["file"].endswith("plan.json")
    assert told["value"] == result.value
    plan = json.loads((tmp_path / "plan.json").read_text("utf-8"))
    assert plan["value"] == result.value
    assert plan["stays"][0]["start"] == "2026-03-01T00:00:00"


@pytest.mark.parametrize("suffix", [".lp", ".mps"])
def test_problems(roster: tuple[Path, Path, Result], suffix: str, tmp_path: Path) -> None:
    """HiGHS reads a problem."""
    out = tmp_path / f"p{suffix}"
    assert run("export", roster[1], "--to", out).exit_code == 0
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    assert solver.readModel(str(out)) == highspy.HighsStatus.kOk
    assert "take__Ada__x__0" in solver.getLp().col_names_


def test_maps(toy: Path, tmp_path: Path) -> None:
    """A comparison knows its instance: its best plan, or the one asked for, goes to Cesium and to a map."""
    assert run("export", toy, "--to", tmp_path / "p.czml").exit_code == 0
    packets = json.loads((tmp_path / "p.czml").read_text("utf-8"))
    assert json.loads(Document.model_validate(packets).dumps()) == packets
    assert packets[0]["name"] == "Greedy"
    assert run("export", toy, "--to", tmp_path / "p.geojson", "--solver", "haa").exit_code == 0
    kinds = {
        f["properties"]["kind"] for f in json.loads((tmp_path / "p.geojson").read_text("utf-8"))["features"]
    }
    assert kinds == {"task", "satellite"}


def test_bad_arguments(roster: tuple[Path, Path, Result], toy: Path, tmp_path: Path) -> None:
    """Each bad argument: status 2, one line, and no file."""
    saved, problem, _ = roster
    (tmp_path / "old.csv").write_text("mine")
    cases = [
        (("export", saved, problem, "--to", tmp_path / "old.csv"), "exists already; give --force"),
        (("export", saved, problem, "--to", tmp_path / "p.doc"), "a plan is written as .csv"),
        (("export", saved, "--to", tmp_path / "p.csv"), "does not say which problem it is about"),
        (("export", saved, problem, "--to", tmp_path / "p.csv", "--form", "tall"), "--form must be one of"),
        (("export", saved, problem, "--to", tmp_path / "p.czml"), "a problem from a file has no satellites"),
        (("export", problem, "--to", tmp_path / "p.lp", "--form", "wide"), "--form is about tables"),
        (("export", problem, problem, "--to", tmp_path / "p.lp"), "name it as SOURCE"),
        (("export", saved, problem, "--to", tmp_path / "no" / "p.csv"), "there is no folder"),
        (("export", tmp_path / "none.npz", problem, "--to", tmp_path / "p.csv"), "there is no file"),
        (("export", saved, problem), "--to"),
    ]
    for args, words in cases:
        assert words in error_line(*args)
    late: list[
        tuple[tuple[object, ...], str]
    ] = [  # found when the files were read, behind the progress of that
        (("export", toy, "--to", tmp_path / "p.csv", "--solver", "haal"), "there are greedy, haa"),
        (("export", toy, "--to", tmp_path / "p.csv", "--seed", 5), "is about another problem"),
        (("export", problem, problem, "--to", tmp_path / "p.csv"), "expected 'sapopt-result-1'"),
    ]
    for args, words in late:
        outcome = run(*args)
        assert outcome.exit_code == 2
        assert words in outcome.stderr.splitlines()[-1]
    assert (tmp_path / "old.csv").read_text() == "mine"
    assert not list(tmp_path.glob("p.*[!z]"))
    assert run("export", saved, problem, "--to", tmp_path / "old.csv", "--force").exit_code == 0
    assert (tmp_path / "old.csv").read_text().startswith("agent,task")


@pytest.mark.parametrize(
    ("suffix", "package"), [(".xlsx", "openpyxl"), (".parquet", "pyarrow"), (".czml", "czml3")]
)
def test_a_missing_extra(
    roster: tuple[Path, Path, Result],
    suffix: str,
    package: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One line says what to install, before any work."""
    monkeypatch.setitem(sys.modules, package, None)
    line = error_line("export", roster[0], roster[1], "--to", tmp_path / f"p{suffix}")
    assert f"needs {package}: pip install 'sapopt[" in line
