"""What earlier sweeps left in a folder: damaged and foreign results, marks of the dead, parts of files."""

from __future__ import annotations

import json
import logging
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from sapopt.sweeps.engine import Job, _known, _mark, _write

JOB = Job("x 1", {"x": 1})
GOOD = {"label": JOB.label, "job": {"x": 1}, "seconds": 0.5, "record": {"square": 1}}


@pytest.mark.parametrize(
    "content",
    [
        "[" * 100_000, "{", "", "null", "[]", "\x00", json.dumps(GOOD | {"job": {"x": 2}}),
        json.dumps(GOOD | {"record": 3}),
        json.dumps(GOOD | {"seconds": "x"}), json.dumps(GOOD | {"seconds": 10**400}), json.dumps({"job": {"x": 1}}),
    ],
    ids=["nested", "cut", "empty", "null", "list", "NUL", "another job", "no record", "text", "huge", "half"],
)  # fmt: skip
def test_damaged_results_are_set_aside(
    content: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The job is done again, the file is kept under another name, and a warning says so."""
    path = tmp_path / f"{JOB.key}.json"
    path.write_text(content)
    with caplog.at_level(logging.WARNING):
        assert _known(tmp_path, JOB) is None
    assert [file.name for file in tmp_path.iterdir()] == [f"{JOB.key}.damaged"]
    assert path.with_suffix(".damaged").read_text() == content
    assert "set aside" in caplog.text
    _write(tmp_path, JOB, {"square": 1}, 0.5)
    known = _known(tmp_path, JOB)
    assert known is not None
    assert (known.record, known.fresh) == ({"square": 1}, False)


def mark(folder: Path, name: str, owner: Any) -> Path:
    """A mark of another sweep."""
    path = folder / f".sweep-{name}"
    path.write_text(owner if isinstance(owner, str) else json.dumps(owner))
    return path


def test_marks_of_the_dead_are_removed(tmp_path: Path) -> None:
    """A killed sweep leaves its mark and part of a file; the next one clears them away, and nothing of the living."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    here = socket.gethostname()
    dead = mark(tmp_path, "dead", {"host": here, "pid": process.pid})
    alive = mark(tmp_path, "alive", {"host": here, "pid": os.getpid()})
    elsewhere = mark(tmp_path, "elsewhere", {"host": here + "x", "pid": process.pid})
    unreadable = mark(tmp_path, "unreadable", "{")
    old, new = tmp_path / ".sapopt-00.part", tmp_path / ".sapopt-11.part"
    old.write_text("x")
    new.write_text("x")
    os.utime(old, (time.time() - 10**6,) * 2)
    with _mark(tmp_path) as mine:
        assert mine.exists()
        assert not dead.exists()
        assert not old.exists()
        assert all(path.exists() for path in (alive, elsewhere, unreadable, new))
    assert not mine.exists()
