"""The installed program, as a user starts it: streams, exit statuses, Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest


class TestProcess:
    """The installed program, as a user starts it."""

    program = Path(sys.executable).with_name("sapopt")

    def start(self, *args: Any, cwd: Path) -> subprocess.Popen[str]:
        """A running program."""
        return subprocess.Popen(
            [str(self.program), *map(str, args)],
            cwd=cwd,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def test_streams(self, problem_file: Path, tmp_path: Path) -> None:
        """stdout can be piped into a JSON reader; progress goes to stderr."""
        process = self.start("compare", problem_file, "--solvers", "haa", "--json", cwd=tmp_path)
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        assert json.loads(out)["solvers"]["haa"]["status"] == "feasible"
        assert "haa" in err

    def test_bad_argument(self, tmp_path: Path) -> None:
        """Status 2 and one line, no traceback."""
        process = self.start("compare", "constelation-mid", cwd=tmp_path)
        out, err = process.communicate(timeout=120)
        assert (process.returncode, out) == (2, "")
        assert err.strip() == "sapopt: unknown instance 'constelation-mid'; did you mean 'constellation-mid'?"

    @pytest.mark.skipif(os.name == "nt", reason="sends SIGINT to one process")
    def test_interrupt(self, tmp_path: Path) -> None:
        """Ctrl-C during a long run: the whole plan made so far is printed, and the status is 130."""
        args = ("solve", "constellation-mid", "--solver", "haal", "--lookahead", "14", "--json")
        process = self.start(*args, cwd=tmp_path)
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("haal:14"):
                break
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
        assert process.returncode == 130, err
        report = json.loads(out)
        assert report["status"] == "interrupted"
        assert np.shape(report["plan"]) == (93, 324)

    def test_reading_words_is_quick_and_light(self) -> None:
        """Asking for the version or making a typing mistake does not load the plotting library."""
        code = (
            "import sys, sapopt.cli; "
            "print(*[m for m in ('matplotlib', 'torch', 'cvxpy') if m in sys.modules])"
        )
        out = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
        assert out.split() == []
