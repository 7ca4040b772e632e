"""The command line: exit statuses, pure JSON, one clear line for each bad argument, no file lost."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import error_line, run

import sapopt
from sapopt import SAP, Result
from sapopt.cli.output import as_json
from sapopt.solvers.names import parse_solver, parse_solvers

PNG = b"\x89PNG\r\n"


def test_version() -> None:
    """`--version` prints the version and nothing else."""
    assert run("--version").stdout.strip() == sapopt.__version__


def test_help_needs_no_arguments() -> None:
    """Without a command the help is shown; every command has one."""
    assert "compare" in run().output
    for command in ("compare", "solve", "bound", "certify", "verify", "report", "instances"):
        outcome = run(command, "--help")
        assert outcome.exit_code == 0
        assert "--json" in outcome.stdout


def test_instances() -> None:
    """The list for people and the list for machines name the same instances."""
    known = json.loads(run("instances", "--json").stdout)
    table = run("instances").stdout
    assert "constellation-mid" in {entry["name"] for entry in known}
    assert all(entry["name"] in table and entry["agents"] > 0 for entry in known)


def test_compare_json(problem_file: Path) -> None:
    """JSON alone on stdout, progress on stderr; values are those of the problem's own evaluation."""
    outcome = run("compare", problem_file, "--solvers", "greedy,haa,HAAL:3", "--json")
    assert outcome.exit_code == 0
    report = json.loads(outcome.stdout)
    assert list(report["solvers"]) == ["greedy", "haa", "haal:3"]
    assert report["agents"] == 3
    assert report["interrupted"] is False
    for entry in report["solvers"].values():
        assert entry["value"] <= report["bound"] + 1e-9
        assert entry["share"] == pytest.approx(entry["value"] / report["bound"])
        assert entry["gap"] == pytest.approx(1 - entry["share"])
        assert entry["value"] == pytest.approx(entry["benefit"] + entry["handover"])
    assert "compiling kernels" in outcome.stderr
    assert "haal:3" in outcome.stderr


def test_compare_table(problem_file: Path) -> None:
    """The table has a row for each solver and names the bound."""
    outcome = run("compare", problem_file, "--solvers", "greedy,haa")
    assert outcome.exit_code == 0
    for word in (
        "solver",
        "share of bound",
        "handovers",
        "s/step",
        "gap",
        "greedy",
        "haa",
        "proven upper bound",
    ):
        assert word in outcome.stdout


def test_compare_files(problem_file: Path, tmp_path: Path) -> None:
    """`--out` leaves JSON, plans and pictures; a second run keeps them unless it is forced."""
    out = tmp_path / "new" / "folder"
    args = ("compare", problem_file, "--solvers", "greedy,haa", "--agent", "2", "--out", out)
    assert run(*args).exit_code == 0
    report = json.loads((out / "compare.json").read_text(encoding="utf-8"))
    problem = SAP.load(problem_file)
    assert report["fingerprint"] == problem.fingerprint
    with np.load(out / "compare.npz") as plans:
        for name in ("greedy", "haa"):
            assert problem.evaluate(plans[name]).value == pytest.approx(report["solvers"][name]["value"])
    for name in ("compare.png", "history.png"):
        assert (out / name).read_bytes().startswith(PNG)

    (out / "compare.json").write_text("mine", encoding="utf-8")
    assert "--force" in error_line(*args)
    assert (out / "compare.json").read_text(encoding="utf-8") == "mine"
    assert run(*args, "--force").exit_code == 0
    assert json.loads((out / "compare.json").read_text(encoding="utf-8"))["agents"] == 3


def test_report(problem_file: Path, tmp_path: Path) -> None:
    """The files of compare and of solve become a page, without naming the problem again; nothing is overwritten."""
    many, one = tmp_path / "many", tmp_path / "one"
    assert run("compare", problem_file, "--solvers", "greedy,haa", "--out", many).exit_code == 0
    assert run("solve", problem_file, "--solver", "haa", "--out", one).exit_code == 0
    page = tmp_path / "page.html"
    outcome = run("report", many, "--out", page, "--json")
    assert outcome.exit_code == 0, outcome.stderr
    told = json.loads(outcome.stdout)
    assert set(told["solvers"]) == {"greedy", "haa"}
    assert told["bytes"] == page.stat().st_size
    assert told["bound"] >= told["solvers"]["haa"]["value"]
    assert "<title>small - sapopt report</title>" in page.read_text(encoding="utf-8")
    assert "--force" in error_line("report", many, "--out", page)
    assert run("report", one / "solve.npz", "--out", page, "--force").exit_code == 0
    assert '"name":"HAA"' in page.read_text(encoding="utf-8")


def test_report_bad_arguments(problem_file: Path, tmp_path: Path) -> None:
    """What is no result, belongs to another problem, or does not say what it is about gets one line."""
    page = ("--out", tmp_path / "page.html")
    assert "neither compare.json nor solve.json" in error_line("report", tmp_path, *page)
    assert "there is no file or folder" in error_line("report", tmp_path / "none.npz", *page)
    out = tmp_path / "one"
    assert run("solve", problem_file, "--solver", "haa", "--no-bound", "--out", out).exit_code == 0
    outcome = run("report", out, "constellation-toy", *page)  # building it is told before
    assert outcome.exit_code == 2
    assert "another problem than constellation-toy" in outcome.stderr.strip().splitlines()[-1]
    (out / "solve.json").unlink()
    assert "name it: sapopt report RESULT INSTANCE" in error_line("report", out / "solve.npz", *page)
    (out / "solve.json").write_text("{", encoding="utf-8")
    assert "damaged" in error_line("report", out, *page)
    (out / "solve.json").unlink()
    assert run("report", out / "solve.npz", problem_file, *page).exit_code == 0


def test_solve(problem_file: Path, tmp_path: Path) -> None:
    """A result in JSON is feasible and worth what it says; the file written is a result of the library."""
    args = (
        "solve",
        problem_file,
        "--solver",
        "haal",
        "--lookahead",
        "4",
        "--out",
        tmp_path / "out",
        "--json",
    )
    outcome = run(*args)
    assert outcome.exit_code == 0
    report = json.loads(outcome.stdout)
    problem = SAP.load(problem_file)
    assert problem.evaluate(report["plan"]).value == pytest.approx(report["value"])
    assert report["bound"] >= report["value"]
    result = Result.load(tmp_path / "out" / "solve.npz")
    np.testing.assert_array_equal(result.plan, report["plan"])
    assert (tmp_path / "out" / "timeline.png").read_bytes().startswith(PNG)


def test_solve_without_bound(problem_file: Path) -> None:
    """`--no-bound` leaves the bound out, and the JSON says null."""
    report = json.loads(run("solve", problem_file, "--solver", "haa", "--no-bound", "--json").stdout)
    assert report["bound"] is None
    assert report["gap"] is None


def test_bound(problem_file: Path, tmp_path: Path) -> None:
    """The bound in JSON is that of the library."""
    report = json.loads(run("bound", problem_file, "--json", "--out", tmp_path / "out").stdout)
    assert report["bound"] == pytest.approx(sapopt.bound(SAP.load(problem_file)).value, rel=1e-3)
    assert json.loads((tmp_path / "out" / "bound.json").read_text(encoding="utf-8")) == report


def test_certify_and_verify(problem_file: Path, tmp_path: Path) -> None:
    """A certificate is written and holds; for another problem it is refused, and it is not overwritten."""
    path = tmp_path / "c.npz"
    args = ("certify", problem_file, "--solver", "haal:3", "--out", path)
    written = run(*args, "--json")
    assert written.exit_code == 0
    assert "holds" in run("verify", path, problem_file).stdout
    claim, proven = (
        json.loads(outcome.stdout) for outcome in (written, run("verify", path, problem_file, "--json"))
    )
    assert proven == claim
    assert claim["value"] <= claim["bound"]
    assert "--force" in error_line(*args)
    assert run(*args, "--force").exit_code == 0
    other = run("verify", path, "constellation-toy")
    assert other.exit_code == 2
    assert "belongs to another problem" in other.stderr


def test_verify_finds_the_built_in_instance(tmp_path: Path) -> None:
    """Without a name the built-in instances of the certificate's size are tried."""
    path = tmp_path / "c.npz"
    assert (
        run("certify", "constellation-toy", "--solver", "haa", "--cost", "0.2", "--out", path).exit_code == 0
    )
    assert run("verify", path, "--cost", "0.2").stdout.startswith("constellation-toy: ")
    assert run("verify", path).exit_code == 2


def test_verify_refuses_what_is_no_certificate(problem_file: Path, tmp_path: Path) -> None:
    """A missing file, a problem, and a certificate of no built-in instance each get one line."""
    assert "there is no file" in error_line("verify", tmp_path / "no.npz")
    assert "small.npz" in error_line("verify", problem_file)
    path = tmp_path / "c.npz"
    run("certify", problem_file, "--solver", "haa", "--out", path)
    assert "fits no built-in instance" in error_line("verify", path)


def test_certify_needs_a_folder_to_write_to(problem_file: Path, tmp_path: Path) -> None:
    """The place of the certificate is checked before any work is done."""
    assert "there is no folder" in error_line("certify", problem_file, "--out", tmp_path / "none" / "c.npz")
    assert "is a folder" in error_line("certify", problem_file, "--out", tmp_path)


def test_built_in_instance() -> None:
    """A built-in name works; its seed and cost are passed on."""
    one, other, dear = (
        json.loads(run("compare", "constellation-toy", "--solvers", "haa", *options, "--json").stdout)
        for options in ((), ("--seed", "1"), ("--cost", "2"))
    )
    assert one["fingerprint"] != other["fingerprint"]
    assert "2.0" in dear["dynamics"]
    assert dear["solvers"]["haa"]["handovers"] < one["solvers"]["haa"]["handovers"]


def test_solver_names() -> None:
    """Case, hyphens and underscores do not matter, and the table's name is the same."""
    assert parse_solver("HAAL:6").name == parse_solver("haal", 6).name == "haal:6"
    assert parse_solver("No_Handover").name == "no-handover"
    assert [named.name for named in parse_solvers(" haa , haal ,")] == ["haa", "haal:3"]


def test_json_is_strict() -> None:
    """Numbers that JSON does not have become null, arrays become lists."""
    value = {"a": np.array([1.0, np.nan]), "b": float("inf"), "c": np.int64(3), "d": (True, None)}
    assert json.loads(as_json(value)) == {"a": [1.0, None], "b": None, "c": 3, "d": [True, None]}


def test_interrupted_compare_keeps_what_is_there(problem_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while the bound is proven: the solvers' results are shown, and the status says interrupted."""

    def stop(*args: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("sapopt.cli.work.prove_bound", stop)
    outcome = run("compare", problem_file, "--solvers", "greedy,haa", "--json")
    assert outcome.exit_code == 130
    report = json.loads(outcome.stdout)
    assert report["interrupted"] is True
    assert report["bound"] is None
    assert list(report["solvers"]) == ["greedy", "haa"]


def test_distributed_solvers_hear_the_satellites_in_range(tmp_path: Path) -> None:
    """The links of a constellation are used, and the trace tells what every step cost."""
    traffic = {}
    for reach in ("8000", "inf"):
        out = tmp_path / reach
        args = ("solve", "constellation-toy", "--solver", "haal-d", "-L", "2", "--no-bound", "--out", out)
        outcome = run(*args, "--range-km", reach)
        assert outcome.exit_code == 0, outcome.stderr
        traffic[reach] = json.loads((out / "solve.json").read_text(encoding="utf-8"))["trace"]
        assert len({tuple(step) for step in traffic[reach]}) == 1
    assert all(step["rounds"] > 0 and step["bytes"] > 0 for step in traffic["8000"])
    # Everyone in one hop: fewer rounds, and no packet is passed on.
    near, far = (sum(step["rounds"] for step in traffic[reach]) for reach in ("inf", "8000"))
    assert near < far
