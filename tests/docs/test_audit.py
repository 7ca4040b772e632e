"""The audit of the thesis names things that exist: files, tests, instances, classes and their methods."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from sapopt.domains.instances import instances

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "audit.md").read_text(encoding="utf-8")
NAMES = sorted(set(re.findall(r"`([^`]+)`", PAGE)))
SOURCE = "\n".join(
    path.read_text(encoding="utf-8")
    for folder in ("sapopt", "tests")
    for path in sorted((ROOT / folder).rglob("*.py"))
)


def exists(name: str) -> bool:
    """Whether a name in the page stands for a file, an instance, a module, or something that the source defines."""
    if any(
        (ROOT / folder / name).exists()
        for folder in ("", "sapopt", "experiments", "sapopt/domains/constellation")
    ):
        return True
    if name in {entry.name for entry in instances()} | {"power-failing", "power-cloudy"}:
        return True
    if name.startswith("sapopt.") and (ROOT / (name.replace(".", "/") + ".py")).exists():
        return True
    call = re.fullmatch(r"([\w.]+)(?:=\w+)?(?:\((.*)\))?", name)
    if call is None:
        return False
    parts = call[1].split(".") + re.findall(r"(\w+)(?==)", call[2] or "")
    return all(
        re.search(rf"(class|def) {part}\b|^\s*{part}(:| =)|\b{part}[:=]", SOURCE, re.MULTILINE)
        for part in parts
    )


@pytest.mark.parametrize("name", NAMES)
def test_named_things_exist(name: str) -> None:
    """A row that names what has been renamed or was never there says nothing."""
    assert exists(name), name


def test_every_row_says_its_state() -> None:
    """No row of the tables on chapters 1 to 7 leaves its last column empty."""
    rows = [line for line in PAGE.split("## Slips")[0].splitlines() if line.startswith("|")]
    assert len(rows) > 60
    for row in rows:
        assert row.rstrip("|").split("|")[-1].strip(), row
