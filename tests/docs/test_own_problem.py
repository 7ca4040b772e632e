"""What the page about problems of one's own promises: a dynamics of about 20 lines, and by a rule of even fewer."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "own_problem.md").read_text(encoding="utf-8")


def test_size_of_a_dynamics() -> None:
    """The first class of each block has at most 20 lines of code; that they run is tested with all other blocks."""
    codes = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    bodies = [re.search(r"^class .*?(?=^\S)", code, flags=re.DOTALL | re.MULTILINE) for code in codes]
    lengths = [len([line for line in body.group().splitlines() if line.strip()]) for body in bodies if body]
    assert len(lengths) == 6
    assert max(lengths) <= 20
