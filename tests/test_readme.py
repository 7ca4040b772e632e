"""The README: its example runs, its pictures exist, and its commands are commands."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from sapopt.cli.app import app
from sapopt.solvers.names import METHODS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """The code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize("code", blocks("python"), ids=lambda code: code.splitlines()[0])
def test_example_runs(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Every Python block runs as it stands and prints something."""
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out.strip()


def test_set_up_commands() -> None:
    """The two set-up commands are there, each complete: environment, installation, job."""
    lines = [line for block in blocks("bash") for line in block.splitlines() if "&&" in line]
    ends = [line.split(" && ")[-1] for line in lines]
    assert ends == [".venv/bin/sapopt compare constellation-mid", ".venv/bin/python -m pytest"]
    for line in lines:
        assert line.startswith("python3 -m venv .venv && .venv/bin/pip install -c constraints.txt ")


def test_commands_exist() -> None:
    """Every `sapopt ...` line names a command of the program."""
    known = {command.name for command in app.registered_commands}
    lines = [line for block in blocks("bash") for line in block.splitlines() if line.startswith("sapopt ")]
    assert lines
    for line in lines:
        assert shlex.split(line, comments=True)[1] in known


def test_files_exist() -> None:
    """Pictures, linked files and files named in code font are in the tree."""
    targets = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    targets += re.findall(r"`([A-Z][A-Za-z]*\.(?:md|cff)|experiments/[\w/]+)`", README)
    assert targets
    for target in targets:
        assert (ROOT / target).exists(), target


def test_methods_table() -> None:
    """Every solver that the command line offers has a row in the table of methods, with its class."""
    rows = dict(re.findall(r"^\| `([a-z-]+)(?::[A-Z])?` \| `(\w+)", README, flags=re.MULTILINE))
    assert {method.name: method.class_name for method in METHODS}.items() <= rows.items()
