"""The command line and bad input: status 2, one clear line that names the argument, nothing on stdout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import error_line, run


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
