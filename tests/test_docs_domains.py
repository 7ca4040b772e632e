"""The code in the pages about domains and about problems of one's own runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"
BLOCKS = [
    pytest.param(page, code, id=f"{page}-{number}")
    for page in ("own_problem.md", "domains.md")
    for number, code in enumerate(
        re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    )
]


@pytest.mark.parametrize(("page", "code"), BLOCKS)
def test_example_runs(page: str, code: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(code, page, "exec", dont_inherit=True), {"__name__": "__main__"})
    assert capsys.readouterr().out.strip()


def test_size_of_a_dynamics() -> None:
    """The promise of the page: a dynamics of one's own is about 20 lines, and the rule even fewer."""
    codes = [param.values[1] for param in BLOCKS if param.values[0] == "own_problem.md"]
    bodies = [re.search(r"^class .*?(?=^\S)", code, flags=re.DOTALL | re.MULTILINE) for code in codes]
    lengths = [len([line for line in body.group().splitlines() if line.strip()]) for body in bodies if body]
    assert len(lengths) == 2
    assert max(lengths) <= 20
