"""What a benchmark leaves behind."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments.benchmarks.output import finish


def test_the_folder_of_a_result_is_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Hours of figures are not lost for a folder that is not there; they are printed too."""
    path = tmp_path / "new" / "folder" / "figures.json"
    finish({"rows": [1, 2]}, str(path))
    assert json.loads(path.read_text())["rows"] == [1, 2]
    assert json.loads(capsys.readouterr().out)["rows"] == [1, 2]
