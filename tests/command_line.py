"""Commands run inside the test process."""

from __future__ import annotations

from typing import Any

from typer.testing import CliRunner

from sapopt.cli import app


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
