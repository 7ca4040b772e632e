"""Standard streams that fail: progress and help never end a run."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from sapopt.running.streams import Forgiving, standard_error

FULL = Path("/dev/full")


def narrow(encoding: str) -> tuple[io.BytesIO, io.TextIOWrapper]:
    """A text stream of this encoding and what it holds."""
    held = io.BytesIO()
    return held, io.TextIOWrapper(held, encoding=encoding, write_through=True)


@pytest.mark.parametrize(("encoding", "want"), [("ascii", rb"\xfc \u2713"), ("latin-1", b"\xfc \\u2713")])
def test_characters_that_the_encoding_lacks(encoding: str, want: bytes) -> None:
    """They are written as escapes."""
    held, stream = narrow(encoding)
    assert Forgiving(stream).write("ü ✓") == 3
    assert held.getvalue() == want


def test_streams_that_are_gone() -> None:
    """Closed, missing and full streams take everything and say nothing."""
    _, closed = narrow("utf-8")
    closed.close()
    streams: list[Any] = [None, closed]
    if FULL.exists():
        streams.append(FULL.open("w", buffering=1))
    for stream in streams:
        forgiving = Forgiving(stream)
        for _ in range(3):
            forgiving.write("a line\n")
            forgiving.flush()
        assert not forgiving.isatty()
        assert forgiving.encoding
    if FULL.exists():
        with pytest.raises(OSError, match="No space left"):
            streams[-1].close()


def test_standard_error_is_wrapped_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A forgiving stream stays as it is."""
    monkeypatch.setattr(sys, "stderr", Forgiving(None))
    assert standard_error() is sys.stderr


def sapopt(*words: str, redirect: str = "", **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run the program in a shell, with this redirection and environment."""
    line = f'"{sys.executable}" -c "from sapopt.cli import main; main()" {" ".join(words)} {redirect}'
    return subprocess.run(["sh", "-c", line], capture_output=True, env=os.environ | environment, check=False)


@pytest.mark.skipif(sys.platform == "win32", reason="the shell is that of POSIX")
@pytest.mark.parametrize("encoding", ["cp437", "ascii"])
def test_help_in_narrow_encodings(encoding: str) -> None:
    """Help is printed, whatever the encoding."""
    done = sapopt("solve", "--help", PYTHONIOENCODING=encoding)
    assert done.returncode == 0, done.stderr
    assert b"--solver" in done.stdout


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("redirect", ["2>/dev/full", "2>&- >&-"])
def test_a_run_is_not_lost_to_its_progress(redirect: str, tmp_path: Path) -> None:
    """A solve with a full or closed stream, in ascii, into a folder with an umlaut, leaves all its files."""
    out = tmp_path / "größe"
    done = sapopt(
        "solve", "constellation-toy", "--solver", "haa", "--out", f"'{out}'", redirect=redirect,
        PYTHONIOENCODING="ascii", PYTHONUTF8="1",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {path.name for path in out.iterdir()} >= {"solve.json", "solve.npz"}
