"""The command line: exit statuses, pure JSON, one clear line for each bad argument, no file lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import sapopt
from sapopt import SAP, Result, SwitchingCost
from sapopt.cli import app
from sapopt.cli.names import parse_solver, parse_solvers
from sapopt.cli.output import as_json

PNG = b"\x89PNG\r\n"


def run(*args: Any) -> Any:
    """Outcome of a command."""
    return CliRunner().invoke(app, [str(arg) for arg in args])


def error_line(*args: Any) -> str:
    """The one line on stderr of a command that must end with status 2 and print nothing else."""
    outcome = run(*args)
    assert outcome.exit_code == 2, outcome.output
    assert outcome.stdout == ""
    lines = outcome.stderr.strip().splitlines()
    assert len(lines) == 1, outcome.stderr
    assert lines[0].startswith("sapopt: ")
    return str(lines[0])


@pytest.fixture
def problem_file(tmp_path: Path) -> Path:
    """A small saved problem."""
    path = tmp_path / "small.npz"
    SAP(np.random.default_rng(1).random((5, 3, 4)), SwitchingCost(0.3)).save(path)
    return path


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


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("compare", "constelation-mid"), "did you mean 'constellation-mid'?"),
        (("compare", "Constellation-Mid"), "did you mean 'constellation-mid'?"),
        (("compare", "no/such/file.npz"), "there is no file no/such/file.npz"),
        (("compare", "missing.npz"), "there is no file missing.npz"),
        (("compare", "constellation-toy", "--solvers", "haall:3"), "did you mean 'haal'?"),
        (("compare", "constellation-toy", "--solvers", "qqqq"), "known: no-handover"),
        (
            ("compare", "constellation-toy", "--solvers", "haal:0"),
            "lookahead must be a whole number of at least 1",
        ),
        (
            ("compare", "constellation-toy", "--solvers", "haal:-1"),
            "lookahead must be a whole number of at least 1",
        ),
        (("compare", "constellation-toy", "--solvers", "haal:x"), "'x' is not a whole number"),
        (("compare", "constellation-toy", "--solvers", "haa:3"), "takes no number"),
        (("compare", "constellation-toy", "--solvers", "haal:3,HAAL:3"), "listed twice"),
        (("compare", "constellation-toy", "--solvers", ","), "no solver given"),
        (("compare", "constellation-toy", "--time-limit", "0"), "--time-limit must be a positive number"),
        (("compare", "constellation-toy", "--time-limit", "nan"), "--time-limit must be a positive number"),
        (("compare", "constellation-toy", "--seed", "-1"), "--seed"),
        (("compare", "constellation-toy", "--seed", "x"), "--seed"),
        (("compare", "constellation-toy", "--cost", "-0.5"), "--cost"),
        (("compare", "constellation-toy", "--cost", "nan"), "--cost"),
        (("compare",), "INSTANCE"),
        (("compare", "constellation-toy", "--no-such-option"), "--no-such-option"),
        (("solve", "constellation-toy", "--solver", "haa", "--lookahead", "3"), "takes no number"),
        (
            ("solve", "constellation-toy", "--solver", "haal:3", "--lookahead", "3"),
            "already names its lookahead",
        ),
        (("frobnicate",), "frobnicate"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_arguments(args: tuple[str, ...], words: str) -> None:
    """Each bad argument: status 2, one line that names it, nothing on stdout."""
    assert words in error_line(*args)


def test_agent_out_of_range(problem_file: Path) -> None:
    """The agent to draw must exist; the range is in the message."""
    outcome = run("compare", problem_file, "--agent", "3")
    assert outcome.exit_code == 2
    assert outcome.stderr.strip().splitlines()[-1] == "sapopt: --agent must lie in 0..2, got 3"


def test_cost_of_a_file(problem_file: Path) -> None:
    """A file has its own cost."""
    assert "--cost applies to built-in instances" in error_line("compare", problem_file, "--cost", "1")


@pytest.mark.parametrize("damage", ["cut", "flipped", "text", "empty", "other", "result"])
def test_damaged_files(problem_file: Path, tmp_path: Path, damage: str) -> None:
    """A file that is cut short, changed, or something else ends with status 2 and a line that names it."""
    whole = problem_file.read_bytes()
    path = tmp_path / "damaged.npz"
    if damage == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif damage == "flipped":
        middle = len(whole) // 2
        path.write_bytes(whole[:middle] + bytes([whole[middle] ^ 0xFF]) + whole[middle + 1 :])
    elif damage == "text":
        path.write_text("this is no problem", encoding="utf-8")
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "other":
        np.savez(path, x=np.arange(3))
    else:
        assert run("solve", problem_file, "--solver", "haa", "--out", tmp_path / "out").exit_code == 0
        path = tmp_path / "out" / "solve.npz"
    outcome = run("compare", path, "--solvers", "haa")
    assert outcome.exit_code == 2
    assert outcome.stdout == ""
    assert str(path) in outcome.stderr.strip().splitlines()[-1]
    assert "Traceback" not in outcome.stderr


def test_out_is_a_file(problem_file: Path) -> None:
    """`--out` must be a folder; that is said before any work is done."""
    assert "--out" in error_line("compare", problem_file, "--out", problem_file)


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


class TestProcess:
    """The installed program, as a user starts it."""

    program = Path(sys.executable).with_name("sapopt")

    def start(self, *args: Any, cwd: Path) -> subprocess.Popen[str]:
        """A running program."""
        return subprocess.Popen(
            [str(self.program), *map(str, args)],
            cwd=cwd,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def test_streams(self, problem_file: Path, tmp_path: Path) -> None:
        """stdout can be piped into a JSON reader; progress goes to stderr."""
        process = self.start("compare", problem_file, "--solvers", "haa", "--json", cwd=tmp_path)
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        assert json.loads(out)["solvers"]["haa"]["status"] == "feasible"
        assert "haa" in err

    def test_bad_argument(self, tmp_path: Path) -> None:
        """Status 2 and one line, no traceback."""
        process = self.start("compare", "constelation-mid", cwd=tmp_path)
        out, err = process.communicate(timeout=120)
        assert (process.returncode, out) == (2, "")
        assert err.strip() == "sapopt: unknown instance 'constelation-mid'; did you mean 'constellation-mid'?"

    @pytest.mark.skipif(os.name == "nt", reason="sends SIGINT to one process")
    def test_interrupt(self, tmp_path: Path) -> None:
        """Ctrl-C during a long run: the whole plan made so far is printed, and the status is 130."""
        args = ("solve", "constellation-mid", "--solver", "haal", "--lookahead", "14", "--json")
        process = self.start(*args, cwd=tmp_path)
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("haal:14"):
                break
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
        assert process.returncode == 130, err
        report = json.loads(out)
        assert report["status"] == "interrupted"
        assert np.shape(report["plan"]) == (93, 324)

    def test_reading_words_is_quick_and_light(self) -> None:
        """Asking for the version or making a typing mistake does not load the plotting library."""
        code = (
            "import sys, sapopt.cli; "
            "print(*[m for m in ('matplotlib', 'torch', 'cvxpy') if m in sys.modules])"
        )
        out = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
        assert out.split() == []


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


def test_bad_range(problem_file: Path) -> None:
    """A range that splits the satellites, or that nothing uses, is refused in one line."""
    for options in (["--range-km", "20"], []):
        outcome = run("solve", "constellation-toy", "--solver", "haal-d", *options)
        assert outcome.exit_code == 2
        last = outcome.stderr.strip().splitlines()[-1]
        assert "parts at step 0; pass a larger --range-km" in last
    outcome = run("solve", problem_file, "--solver", "cbba", "--range-km", "9")
    assert "for constellations" in outcome.stderr.strip().splitlines()[-1]
    assert "positive number of kilometres" in error_line(
        "solve", problem_file, "--solver", "cbba", "--range-km", "-1"
    )
    assert "for solvers that exchange packets" in error_line("solve", problem_file, "--range-km", "2500")
