"""Every built-in method in forked children, in many threads at once, on a Dask worker, and what that loads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "surroundings.py"
SECONDS = 900.0
"""Far more than everything takes: what is not done by then hangs."""


@cache
def played(how: str) -> dict[str, Any]:
    """What `tests/surroundings.py` prints, with threads, and numba left with the layer that knows no concurrency."""
    environment = os.environ | {"SAPOPT_NUM_THREADS": "3", "NUMBA_THREADING_LAYER": "workqueue"}
    done = subprocess.run(
        [sys.executable, str(SCRIPT), how], env=environment, capture_output=True, text=True, timeout=SECONDS
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_forked_children() -> None:
    """After a solve, forked children solve with every method, to the same values, and none hangs."""
    assert all(value > 0 for value in played("fork")["values"].values())


def test_threads() -> None:
    """Eight threads at once, and a daemon thread, find the same values with every method."""
    assert all(value > 0 for value in played("threads")["values"].values())


def test_dask_worker() -> None:
    """The threads of a Dask worker solve with every method."""
    pytest.importorskip("distributed")
    assert played("dask")["values"] == pytest.approx(played("threads")["values"], abs=1e-12)


def test_no_threading_layer() -> None:
    """No method brings a threading layer of numba, and with it OpenMP, into the process."""
    found = played("threads")
    assert not found["initialised"]
    assert found["layers"] == []


def test_one_signature() -> None:
    """No kernel is compiled twice: every one is called with the same types of arguments by all methods."""
    assert played("threads")["several"] == []
