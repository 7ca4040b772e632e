"""Every Python block of the documentation runs: those of a page in order, in one namespace, away from the checkout."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SLOW: frozenset[str] = frozenset()
"""Pages whose blocks run for more than about ten seconds; `pytest -m slow` runs them."""


def blocks(page: Path) -> list[tuple[int, str]]:
    """Line and text of every block that is marked as Python."""
    text = page.read_text(encoding="utf-8")
    return [
        (text[: found.start()].count("\n") + 2, found.group(1))
        for found in re.finditer(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    ]


# The README has tests of its own (tests/test_readme.py).
PAGES = [page for page in sorted((ROOT / "docs").glob("*.md")) if blocks(page)]


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=pytest.mark.slow if p.name in SLOW else (), id=p.name) for p in PAGES],
)
def test_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No block raises; files are written to where the reader is, here an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    namespace: dict[str, object] = {"__name__": "docs"}
    for line, code in blocks(page):
        # Empty lines put the block where it stands in the page, so that a traceback names the right line.
        exec(compile("\n" * (line - 1) + code, str(page), "exec", dont_inherit=True), namespace)


def test_pages_are_found() -> None:
    """The pages that a newcomer reads have blocks to run."""
    assert {"getting_started.md", "model.md", "methods.md", "certificates.md"} <= {p.name for p in PAGES}


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda page: page.name)
def test_files_named_exist(page: Path) -> None:
    """Pictures and scripts that a page names are in the tree."""
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"!\[[^\]]*\]\((?!http)([^)#]+)\)", text):
        assert (page.parent / target).exists(), target
    for script in re.findall(r"(?<![\w/])(?:experiments|tools)/[\w/]+\.py", text):
        assert (ROOT / script).exists(), script
    for module in re.findall(r"python -m (experiments[\w.]*)", text):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), module
    for script in re.findall(r"`(\w+\.py)`", text) if page.name == "experiments.md" else []:
        assert (ROOT / "experiments" / script).exists(), script
